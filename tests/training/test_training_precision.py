import pytest
import torch
from training_samples import TINY, make_pool

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.completion import CompletionConfig, CompletionNetwork
from omnisyn_cli.networks.fusion import FusionConfig, build_fusion
from omnisyn_cli.networks.paper import PaperNetwork
from omnisyn_cli.networks.synsin import FeatureEncoder, MonocularNetwork, RefinementDecoder, SynSinConfig
from omnisyn_cli.training.data import list_scene_files
from omnisyn_cli.training.loop import Trainer
from omnisyn_cli.training.precision import BF16_INSTRUCTIONS, Precision, choose_precision
from omnisyn_cli.training.tasks import TrainConfig

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


def test_other_devices_are_refused():
    with pytest.raises(InputError, match="abacus"):
        choose_precision("abacus")


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
