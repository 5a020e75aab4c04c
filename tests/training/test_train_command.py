"""Networks trained by commands and published; what is shipped can be trained on: files hold all weights, by name."""

from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from training_samples import TINY, make_pool

from omnisyn_cli.errors import InputError, OmnisynError, OutputPathError
from omnisyn_cli.networks.paper import PAPER_VARIANTS, PaperConfig
from omnisyn_cli.pipeline.methods import SYNSIN_MODELS
from omnisyn_cli.runtime.models import MANIFEST, ModelEntry, find_model, manifest_text, read_manifest
from omnisyn_cli.runtime.session import open_session
from omnisyn_cli.training.checkpoint import load_checkpoint, load_network, publish
from omnisyn_cli.training.data import save_samples
from omnisyn_cli.training.fusion_scenes import FusionBatch
from omnisyn_cli.training.loop import choose_precision, train
from omnisyn_cli.training.tasks import TrainConfig
from synsin_samples import TINY_SIZE, write_synsin_models

SMALL = {"widths": (4, 6, 8, 8, 8, 8), "volume_widths": (4, 6, 8, 8), "levels": 16}


def pools(folder, **options):
    return [f"--{name}={make_pool(folder / name, **options)}" for name in ("pool", "validation-pool")]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["pool", "--kind", "streets"], "'street', 'room'"),
        *((["depth", "--pool", ".", "--validation-pool", ".", "--variant", variant, "--height", 100],
           f"multiple of {config.size_multiple} for") for variant, config in PAPER_VARIANTS.items()),
        (["evidence", "--height", 96], "expected a multiple of 64, got 96"),
        (["fusion-pool", "--height", 96], "expected a multiple of 64, got 96"),
    ],
)  # fmt: skip
def test_sizes_and_kinds_that_do_not_fit_are_refused(tmp_path, omnisyn, words, said):
    assert said in omnisyn.misused("train", words[0], tmp_path / "run", *words[1:])


@pytest.mark.parametrize(
    ("variant", "pool_height", "judged_height", "multiple"),
    [("residual", 96, 64, 64), ("paper-narrow", 64, 64, 128), ("paper-narrow", 128, 96, 64)],
)
def test_a_pool_of_a_size_that_the_network_cannot_halve_is_refused(
    tmp_path, variant, pool_height, judged_height, multiple, omnisyn
):
    for name, height in (("pool", pool_height), ("judged", judged_height)):
        picture = np.zeros((1, height, 2 * height), np.float16)
        save_samples(tmp_path / name / "0.npz", [FusionBatch(picture, picture, picture, np.float32(0.0))])
    of_pools = ("--pool", tmp_path / "pool", "--validation-pool", tmp_path / "judged", "--variant", variant)
    said = omnisyn.refused("train", "fusion", tmp_path / "run", *of_pools, "--steps", 1)
    assert f"expected scenes whose height is a multiple of {multiple} in {tmp_path}" in said


@pytest.mark.parametrize(
    ("variant", "size"), [("paper", (64, 128)), ("paper-square", (64, 64)), ("paper-narrow", (64, 128))]
)
def test_the_papers_network_is_trained_published_and_found_by_its_name(tmp_path, monkeypatch, omnisyn, variant, size):
    monkeypatch.setitem(PAPER_VARIANTS, variant, PaperConfig(variant, size, **SMALL))
    words = ("--variant", variant, "--height", 64, "--steps", 2, "--batch", 1)
    made = omnisyn.made("train", "depth", tmp_path / "run", *pools(tmp_path), *words)
    said = f"{tmp_path / 'run'}: from step 0 on {choose_precision()}, with a line every 250 steps\n"
    assert made.out + made.raw_err == said
    state = load_checkpoint(tmp_path / "run" / "checkpoint.pt")
    assert (state["kind"], state["step"]) == ("paper", 2)
    assert (state["training"]["size"], state["training"]["rate"]) == (size, 1e-4)
    ((entry, difference),) = publish(tmp_path / "run" / "checkpoint.pt", tmp_path / "models", pool=tmp_path / "pool")
    assert difference < 1e-4
    assert (entry.name, entry.role, entry.variant, entry.size) == (f"depth-{variant}", "depth", variant, size)
    assert entry.training == "2 steps"
    session = open_session(find_model(f"depth-{variant}", tmp_path / "models"), device="cpu")
    assert session.get_modelmeta().custom_metadata_map["frame"] == "forward"


def test_the_rate_is_the_authors_unless_told(tmp_path, omnisyn):
    """As that network's is in the test before."""
    words = ("--height", 64, "--steps", 1, "--batch", 1, "--rate", 2e-3)
    omnisyn.made("train", "depth", tmp_path / "run", *pools(tmp_path), *words)
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["training"]["rate"] == 2e-3


def test_a_gpu_that_is_not_there_is_refused_before_anything_is_written(tmp_path, monkeypatch, omnisyn):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    omnisyn.refused("train", "depth", tmp_path / "run", *pools(tmp_path), "--device", "cuda", "--steps", 1)


def test_a_run_begins_with_a_shipped_file(tmp_path, omnisyn):
    """Its checkpoint after one step at a rate of nearly nothing is the file's network."""
    shipped = find_model("depth-paper-narrow")
    options = ["--variant", "paper-narrow", "--height", 128, "--steps", 1, "--rate", 1e-12, "--batch", 1]
    of_pools = pools(tmp_path, size=(128, 256))
    omnisyn.made("train", "depth", tmp_path / "run", *of_pools, "--begin-with", shipped, *options)
    begun, after = (load_network(path)[0].state_dict() for path in (shipped, tmp_path / "run" / "checkpoint.pt"))
    assert all((after[name] - weights).abs().max() < 1e-6 for name, weights in begun.items())


@pytest.fixture
def checkpoint(tmp_path):
    pool = str(make_pool(tmp_path / "pool"))
    train(TINY, TrainConfig(pool, pool, size=(64, 128), batch=1), tmp_path / "run", steps=1)
    return tmp_path / "run" / "checkpoint.pt"


def test_a_model_is_replaced_only_on_request(tmp_path, checkpoint):
    folder = tmp_path / "models"
    publish(checkpoint, folder, licence="MIT")
    with pytest.raises(OutputPathError, match="overwrite"):
        publish(checkpoint, folder)
    assert read_manifest(folder)["depth-tiny"].licence == "MIT"
    publish(checkpoint, folder, overwrite=True)
    assert read_manifest(folder)["depth-tiny"].licence == "Apache-2.0"


def test_a_manifest_survives_the_disk(tmp_path):
    entries = {
        name: ModelEntry(
            name, "depth", "fast", f"{name}.onnx", "00", (2, 4), 7, 'so "quoted"', "MIT", {"delta_25": 0.5}
        )
        for name in ("a", "b")
    }
    (tmp_path / MANIFEST).write_text(manifest_text(entries), encoding="utf-8")
    assert read_manifest(tmp_path) == entries


def test_synsin_becomes_three_models_that_belong_together(tmp_path):
    folder = write_synsin_models(tmp_path / "models")
    entries = read_manifest(folder)
    assert list(entries) == list(SYNSIN_MODELS)
    assert {entry.size for entry in entries.values()} == {TINY_SIZE}
    assert [entry.role for entry in entries.values()] == list(SYNSIN_MODELS)
    assert all(find_model(name, folder).is_file() for name in entries)


def test_if_one_of_three_says_something_else_none_is_left(tmp_path, monkeypatch):
    answers = iter([0.0, 0.0, 0.01])
    monkeypatch.setattr("omnisyn_cli.training.checkpoint.largest_difference", lambda *_: next(answers))
    with pytest.raises(OmnisynError, match="not exported"):
        write_synsin_models(tmp_path / "models")
    assert [path.name for path in (tmp_path / "models").iterdir()] == ["fresh.pt"]


def test_synsin_is_compared_on_samples_of_a_pool_too(tmp_path):
    write_synsin_models(tmp_path)
    (_, _, (_, difference)) = publish(
        tmp_path / "fresh.pt", tmp_path / "models", pool=make_pool(tmp_path / "pool"), name="mine"
    )
    assert difference < 1e-4
    assert list(read_manifest(tmp_path / "models")) == ["mine-depth", "mine-encoder", "mine-decoder"]


MODELS = Path(__file__).parents[2] / "models"
ENTRIES = read_manifest(MODELS)


@pytest.mark.parametrize("name", [name for name in ENTRIES if name != "attitude"])  # which no checkpoint becomes
def test_the_module_made_of_a_file_is_exported_to_the_same_file(tmp_path, monkeypatch, name):
    """Byte for byte, where the same release of torch writes it; and it answers as ONNX Runtime does."""
    monkeypatch.setattr("omnisyn_cli.training.checkpoint.COMPARED_EXAMPLES", 1)
    entry = ENTRIES[name]
    made = {each.name: (each, difference) for each, difference in publish(MODELS / entry.file, tmp_path, name=None)}
    found, difference = next(each for each in made.values() if each[0].role == entry.role)
    assert found.parameters == entry.parameters
    assert difference < 1e-4
    shipped = onnx.load(MODELS / entry.file)
    written = onnx.load(tmp_path / found.file)
    for one, other in zip(shipped.graph.initializer, written.graph.initializer, strict=True):
        assert onnx.numpy_helper.to_array(one).tobytes() == onnx.numpy_helper.to_array(other).tobytes()
    if shipped.producer_version == torch.__version__.split("+")[0]:
        assert (tmp_path / found.file).read_bytes() == (MODELS / entry.file).read_bytes()


def test_a_file_that_no_manifest_names_is_refused(tmp_path):
    (tmp_path / "mine.onnx").write_bytes((MODELS / "synsin-encoder.onnx").read_bytes())
    with pytest.raises(InputError, match=r"expected a network of the manifest beside .*mine\.onnx, found none"):
        load_network(tmp_path / "mine.onnx")
