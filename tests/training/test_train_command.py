import numpy as np
import pytest
from click.testing import CliRunner
from training_samples import make_pool

from omnisyn_cli.cli.train import train
from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.paper import PAPER_VARIANTS, PaperConfig
from omnisyn_cli.runtime.models import find_model
from omnisyn_cli.runtime.session import open_session
from omnisyn_cli.training.checkpoint import load_checkpoint, load_network
from omnisyn_cli.training.data import save_samples
from omnisyn_cli.training.fusion_scenes import FusionBatch
from omnisyn_cli.training.loop import choose_precision
from omnisyn_cli.training.publish import publish

SMALL = {"widths": (4, 6, 8, 8, 8, 8), "volume_widths": (4, 6, 8, 8), "levels": 16}


def run(*arguments):
    return CliRunner().invoke(train, [str(argument) for argument in arguments])


def test_an_unknown_kind_of_scene_is_refused(tmp_path):
    result = run("pool", tmp_path / "pool", "--kind", "streets")
    assert result.exit_code == 2
    assert "'street', 'room'" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("variant", PAPER_VARIANTS)
def test_a_height_that_the_network_cannot_halve_often_enough_is_refused(tmp_path, variant):
    pools = ("--pool", tmp_path, "--validation-pool", tmp_path)
    result = run("depth", tmp_path / "run", *pools, "--variant", variant, "--height", 100)
    assert result.exit_code == 2
    assert f"multiple of {PAPER_VARIANTS[variant].size_multiple} for" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["evidence", "fusion-pool"])
def test_a_pool_that_no_network_could_learn_from_is_not_made(tmp_path, command):
    result = run(command, tmp_path / "pool", "--height", 96)
    assert result.exit_code == 2
    assert "expected a multiple of 64, got 96" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("variant", "pool_height", "judged_height", "multiple"),
    [("residual", 96, 64, 64), ("paper-narrow", 64, 64, 128), ("paper-narrow", 128, 96, 64)],
)
def test_a_pool_of_a_size_that_the_network_cannot_halve_is_refused(
    tmp_path, variant, pool_height, judged_height, multiple
):
    for name, height in (("pool", pool_height), ("judged", judged_height)):
        picture = np.zeros((1, height, 2 * height), np.float16)
        save_samples(tmp_path / name / "0.npz", [FusionBatch(picture, picture, picture, np.float32(0.0))])
    pools = ("--pool", tmp_path / "pool", "--validation-pool", tmp_path / "judged")
    result = run("fusion", tmp_path / "run", *pools, "--variant", variant, "--steps", 1)
    assert isinstance(result.exception, InputError)
    assert f"expected scenes whose height is a multiple of {multiple} in {tmp_path}" in str(result.exception)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("variant", "size"), [("paper", (64, 128)), ("paper-square", (64, 64)), ("paper-narrow", (64, 128))]
)
def test_the_papers_network_is_trained_published_and_found_by_its_name(tmp_path, monkeypatch, variant, size):
    monkeypatch.setitem(PAPER_VARIANTS, variant, PaperConfig(variant, size, **SMALL))
    pools = [f"--{name}={make_pool(tmp_path / name)}" for name in ("pool", "validation-pool")]
    result = run("depth", tmp_path / "run", *pools, "--variant", variant, "--height", 64, "--steps", 2, "--batch", 1)
    assert result.exit_code == 0, result.output
    assert result.output == f"{tmp_path / 'run'}: from step 0 on {choose_precision()}, with a line every 250 steps\n"
    state = load_checkpoint(tmp_path / "run" / "checkpoint.pt")
    assert (state["kind"], state["step"]) == ("paper", 2)
    assert (state["training"]["size"], state["training"]["rate"]) == (size, 1e-4)
    ((entry, difference),) = publish(tmp_path / "run" / "checkpoint.pt", tmp_path / "models", pool=tmp_path / "pool")
    assert difference < 1e-4
    assert (entry.name, entry.role, entry.variant, entry.size) == (f"depth-{variant}", "depth", variant, size)
    session = open_session(find_model(f"depth-{variant}", tmp_path / "models"), device="cpu")
    assert session.get_modelmeta().custom_metadata_map["frame"] == "forward"


def test_the_rate_is_the_authors_unless_told(tmp_path):
    pools = [f"--{name}={make_pool(tmp_path / name)}" for name in ("pool", "validation-pool")]
    for rate, expected in (([], 1e-4), (["--rate", "2e-3"], 2e-3)):
        folder = tmp_path / f"run{len(rate)}"
        result = run("depth", folder, *pools, "--height", 64, "--steps", 1, "--batch", 1, *rate)
        assert result.exit_code == 0, result.output
        assert load_checkpoint(folder / "checkpoint.pt")["training"]["rate"] == expected


def test_a_gpu_that_is_not_there_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    pools = [f"--{name}={make_pool(tmp_path / name)}" for name in ("pool", "validation-pool")]
    result = run("depth", tmp_path / "run", *pools, "--device", "cuda", "--steps", 1)
    assert isinstance(result.exception, InputError)
    assert not (tmp_path / "run").exists()


def test_a_run_begins_with_a_shipped_file(tmp_path):
    """Its checkpoint after one step at a rate of nearly nothing is the file's network."""
    shipped = find_model("depth-paper-narrow")
    pools = [f"--{name}={make_pool(tmp_path / name, size=(128, 256))}" for name in ("pool", "validation-pool")]
    options = ["--variant", "paper-narrow", "--height", "128", "--steps", "1", "--rate", "1e-12", "--batch", "1"]
    result = run("depth", tmp_path / "run", *pools, "--begin-with", shipped, *options)
    assert result.exit_code == 0, result.output
    begun, after = (load_network(path)[0].state_dict() for path in (shipped, tmp_path / "run" / "checkpoint.pt"))
    assert all((after[name] - weights).abs().max() < 1e-6 for name, weights in begun.items())
