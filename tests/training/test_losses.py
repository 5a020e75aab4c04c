"""Losses by definition, and what they are in half precision."""

import math

import pytest
import torch
from training_samples import TINY, make_pool

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.completion import CompletionConfig, CompletionNetwork, CompletionPrediction
from omnisyn_cli.networks.fusion import FusionConfig, build_fusion
from omnisyn_cli.networks.paper import PaperNetwork, PaperPrediction
from omnisyn_cli.networks.synsin import FeatureEncoder, MonocularNetwork, RefinementDecoder, SynSinConfig
from omnisyn_cli.training.data import list_scene_files
from omnisyn_cli.training.loop import BF16_INSTRUCTIONS, Precision, Trainer, choose_precision
from omnisyn_cli.training.losses import completion_loss, depth_scores, paper_loss, polar_weights
from omnisyn_cli.training.tasks import TrainConfig


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


SYNSIN = SynSinConfig("tiny", (32, 64), features=6, depth_widths=(6, 8), decoder_widths=(6, 8, 8), fine=4)
HALF = Precision(torch.device("cpu"), is_half=True)


@pytest.mark.parametrize("question", BF16_INSTRUCTIONS)
@pytest.mark.parametrize("has_bf16", [True, False])
def test_without_a_gpu_bfloat16_is_used_where_the_processor_has_it(monkeypatch, question, has_bf16):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for each in BF16_INSTRUCTIONS:
        monkeypatch.setattr(torch.cpu, each, lambda answer=has_bf16 and each == question: answer, raising=False)
    assert choose_precision("auto") == Precision(torch.device("cpu"), is_half=has_bf16)
    with choose_precision().autocast():
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == (torch.bfloat16 if has_bf16 else torch.float32)


def test_a_torch_that_cannot_tell_computes_in_single_precision(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for each in BF16_INSTRUCTIONS:
        monkeypatch.delattr(torch.cpu, each, raising=False)
    assert choose_precision("auto") == Precision(torch.device("cpu"), is_half=False)


def test_the_processor_asked_for_by_name_computes_in_single_precision(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_precision("cpu") == Precision(torch.device("cpu"), is_half=False)
    with choose_precision("cpu").autocast():
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == torch.float32
    with pytest.raises(InputError, match="--device cpu"):
        choose_precision("cuda")


@pytest.mark.parametrize("has_bf16", [True, False])
def test_with_a_gpu_bfloat16_is_used_where_it_has_it(monkeypatch, has_bf16):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: has_bf16)
    assert choose_precision("auto") == choose_precision("cuda") == Precision(torch.device("cuda"), is_half=has_bf16)
    assert choose_precision("cpu").device.type == "cpu"


def test_bfloat16_gives_finite_gradients_and_nearly_the_same_loss(tmp_path):
    """On the processor, where the arithmetic is the same; weights, averages and losses stay in single precision."""
    folder = make_pool(tmp_path)
    config = TrainConfig(str(folder), str(folder), size=(64, 128), batch=1, warmup_steps=1)
    losses = []
    for precision in (Precision(torch.device("cpu")), HALF):
        trainer = Trainer(TINY, config, precision)
        trainer.pool = list_scene_files(folder)
        losses.append(trainer.advance())
        for name, parameter in trainer.network.named_parameters():
            assert parameter.dtype == torch.float32
            assert parameter.grad is None or torch.all(torch.isfinite(parameter.grad)), name
    assert losses[0] != losses[1]
    assert losses[1] == pytest.approx(losses[0], rel=0.05)


def test_depth_is_in_single_precision_even_under_autocast():
    """Eight bits would round every inverse depth to 0.4 %, nearly a tenth of what δ1.05 forgives."""
    torch.manual_seed(0)
    network = PaperNetwork(TINY).eval()
    pair = torch.rand(2, 1, 3, 64, 128)
    with torch.no_grad():
        single = network(*pair)
        with HALF.autocast():
            half = network(*pair)
    for name, head in vars(half).items():
        assert head.dtype == torch.float32
        assert (head - vars(single)[name]).abs().max() < 0.02 * TINY.max_sqrt_inv_depth
    assert torch.unique(half.low).numel() > 256


@pytest.mark.parametrize(
    ("network", "channels"),
    [
        (CompletionNetwork(CompletionConfig("small", 19, (8, 12), 8, heads=2, attention_layers=1)), 19),
        (build_fusion(FusionConfig("small", 52, (8, 12), 8)), 52),
        (build_fusion(FusionConfig("small", 8, (8, 12, 16), is_direct=True)), 8),
        (MonocularNetwork(SYNSIN), 3),
        (FeatureEncoder(SYNSIN), 3),
        (RefinementDecoder(SYNSIN), SYNSIN.features + 1),
    ],
    ids=lambda x: type(x).__name__,
)
def test_what_losses_are_computed_from_is_in_single_precision(network, channels):
    """A processor's autocast, unlike CUDA's, would sum a loss in the bits that it is given."""
    with HALF.autocast():
        answer = network(torch.rand(1, channels, *SYNSIN.size))
    for value in (answer,) if isinstance(answer, torch.Tensor) else vars(answer).values():
        assert value.dtype == torch.float32


def test_a_run_goes_on_with_another_precision(tmp_path):
    folder = make_pool(tmp_path)
    config = TrainConfig(str(folder), str(folder), size=(64, 128), batch=1)
    half, single = Trainer(TINY, config, HALF), Trainer(TINY, config)
    half.pool = single.pool = list_scene_files(folder)
    half.advance()
    single.restore(half.state())
    for one, other in zip(single.network.parameters(), half.network.parameters(), strict=True):
        assert torch.equal(one, other)
    single.advance()
    assert single.step == 2
