import math

import pytest
import torch

from omnisyn_cli.networks.completion import CompletionPrediction
from omnisyn_cli.networks.paper import PaperPrediction
from omnisyn_cli.training.losses import completion_loss, depth_scores, paper_loss, polar_weights


@pytest.fixture
def target():
    generator = torch.Generator().manual_seed(0)
    sqrt_inv_depth = 0.2 + torch.rand(2, 1, 16, 32, generator=generator)
    sqrt_inv_depth[..., 16:] = 0.0  # sky
    return sqrt_inv_depth


def prediction(sqrt_inv_depth):
    """Of both heads alike, so that the confidence is 1."""
    return PaperPrediction(sqrt_inv_depth.square(), sqrt_inv_depth.square())


def test_weights_are_solid_angles_with_mean_one():
    weights = polar_weights(torch.zeros(16, 32))
    assert weights.mean() == pytest.approx(1.0)
    assert weights[8, 0] / weights[0, 0] == pytest.approx(math.sin(8.5 / 16 * math.pi) / math.sin(0.5 / 16 * math.pi))


def test_the_truth_costs_nothing(target):
    assert paper_loss(prediction(target), target) == 0


def test_below_zero_is_infinitely_far(target):
    heads = torch.where(target == 0, -0.05, target.square())
    assert paper_loss(PaperPrediction(heads, heads), target) == 0
    assert depth_scores(PaperPrediction(heads, heads), target, torch.ones(2))["sky_zero"] == 1.0


@pytest.mark.parametrize("error", [0.05, -0.05, 0.2])
def test_errors_cost_more_the_larger_they_are(target, error):
    def cost(scale):
        return paper_loss(prediction(torch.where(target == 0, target, target + scale * error)), target)

    assert cost(0.0) < cost(0.5) < cost(1.0)


def test_gradients_are_finite_everywhere(target):
    low, high = (target.square().requires_grad_() for _ in range(2))
    paper_loss(PaperPrediction(low, high), target).backward()
    assert all(torch.all(torch.isfinite(head.grad)) for head in (low, high))


def test_scores_of_the_truth_are_perfect_and_scale_with_the_baseline(target):
    perfect = depth_scores(prediction(target), target, torch.tensor([2.0, 2.0]))
    assert (perfect["imae"], perfect["delta_5"], perfect["delta_25"], perfect["sky_zero"]) == (0.0, 1.0, 1.0, 1.0)
    assert perfect["confidence_error"] < 1e-6
    nearer = prediction(target * math.sqrt(1.07))  # 7 % more inverse depth
    scores = depth_scores(nearer, target, torch.tensor([2.0, 2.0]))
    assert (scores["delta_5"], scores["delta_10"]) == (0.0, 1.0)
    wider = depth_scores(nearer, target, torch.tensor([4.0, 4.0]))
    assert 0 < wider["imae"] < scores["imae"]


def test_the_papers_loss_is_l1_of_inverse_depth_by_solid_angle_and_half_of_the_low_head(target):
    """Pixel by pixel; what is below zero is right in the sky, and the unknown does not count."""
    torch.manual_seed(0)
    low, high = torch.rand(2, 2, 1, 16, 32).unbind()
    high[..., 20:24] = -0.1  # in the sky
    truth = target.clone()
    truth[:, :, 3, 2:9] = math.nan
    total = 0.0
    for row in range(16):
        sine = math.sin((row + 0.5) / 16 * math.pi)
        for image in range(2):
            for col in range(32):
                sqrt_inv_depth = float(truth[image, 0, row, col])
                if math.isnan(sqrt_inv_depth):
                    continue
                for share, head in ((1.0, high), (0.5, low)):
                    value = float(head[image, 0, row, col])
                    error = abs(value - sqrt_inv_depth**2) if sqrt_inv_depth > 0 else max(value, 0.0)
                    total += share * error * sine / polar_mean(16)
    known = float(torch.isfinite(truth).float().mean())
    expected = total / truth.numel() / known
    assert float(paper_loss(PaperPrediction(low, high), truth)) == pytest.approx(expected, rel=1e-5)


def polar_mean(rows):
    return sum(math.sin((row + 0.5) / rows * math.pi) for row in range(rows)) / rows


def test_uncertainty_of_a_completed_root_costs_by_its_solid_angle():
    """A wrong confidence in one row adds to the loss in proportion to the sine of its polar angle."""
    truth = torch.full((1, 1, 16, 32), 0.5)

    def loss(rows):
        logit = torch.full_like(truth, 20.0)
        logit[..., rows, :] = 0.0
        nothing = torch.zeros_like(truth)
        return float(completion_loss(CompletionPrediction(truth.expand(1, 2, 16, 32), nothing, logit), truth, nothing))

    pole, equator = (loss([row]) - loss([]) for row in (0, 8))
    assert pole / equator == pytest.approx(math.sin(0.5 / 16 * math.pi) / math.sin(8.5 / 16 * math.pi), rel=1e-3)
