import math

import pytest
import torch

from omnisyn_cli.networks.depth import DepthPrediction
from omnisyn_cli.training.losses import depth_loss, depth_scores, polar_weights


@pytest.fixture
def target():
    generator = torch.Generator().manual_seed(0)
    root = 0.2 + torch.rand(2, 1, 16, 32, generator=generator)
    root[..., 16:] = 0.0  # sky
    return root


def prediction(root, logit=0.0):
    coarse = root[..., 1::2, 1::2]
    return DepthPrediction((coarse, root), torch.full_like(root, logit))


def test_weights_are_solid_angles_with_mean_one():
    weights = polar_weights(torch.zeros(16, 32))
    assert weights.mean() == pytest.approx(1.0)
    assert weights[8, 0] / weights[0, 0] == pytest.approx(math.sin(8.5 / 16 * math.pi) / math.sin(0.5 / 16 * math.pi))


def test_the_truth_costs_nothing_but_doubt(target):
    assert depth_loss(prediction(target, 20.0), target) < 1e-6
    assert depth_loss(prediction(target, -20.0), target) > 0.5


def test_below_zero_is_infinitely_far(target):
    below = torch.where(target == 0, -0.05, target)
    gradients_aside = depth_loss(prediction(below, 20.0), target)
    assert gradients_aside < 0.05
    scores = depth_scores(prediction(below), target, torch.ones(2))
    assert scores.sky_zero == 1.0


@pytest.mark.parametrize("error", [0.05, -0.05, 0.2])
def test_errors_cost_more_the_larger_they_are(target, error):
    def cost(scale):
        wrong = torch.where(target == 0, target, target + scale * error)
        return depth_loss(prediction(wrong, 0.0), target)

    assert cost(0.0) < cost(0.5) < cost(1.0)


def test_gradients_are_finite_everywhere(target):
    root = target.clone().requires_grad_()
    logit = torch.zeros_like(target, requires_grad=True)
    depth_loss(DepthPrediction((root[..., 1::2, 1::2], root), logit), target).backward()
    assert torch.all(torch.isfinite(root.grad))
    assert torch.all(torch.isfinite(logit.grad))


def test_scores_of_the_truth_are_perfect_and_scale_with_the_baseline(target):
    perfect = depth_scores(prediction(target, 20.0), target, torch.tensor([2.0, 2.0]))
    assert (perfect.imae, perfect.delta_5, perfect.delta_25, perfect.sky_zero) == (0.0, 1.0, 1.0, 1.0)
    assert perfect.confidence_error < 1e-6
    nearer = prediction(target * math.sqrt(1.07))  # 7 % more inverse depth
    scores = depth_scores(nearer, target, torch.tensor([2.0, 2.0]))
    assert (scores.delta_5, scores.delta_10) == (0.0, 1.0)
    wider = depth_scores(nearer, target, torch.tensor([4.0, 4.0]))
    assert 0 < wider.imae < scores.imae
