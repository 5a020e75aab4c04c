"""What becomes of a checkpoint; and what is shipped can be trained on: files hold all weights, by their names."""

from pathlib import Path

import onnx
import pytest
import torch
from training_samples import TINY, make_pool

from omnisyn_cli.errors import InputError, OmnisynError, OutputPathError
from omnisyn_cli.pipeline.methods import SYNSIN_MODELS
from omnisyn_cli.runtime.models import MANIFEST, ModelEntry, find_model, manifest_text, read_manifest
from omnisyn_cli.training.checkpoint import load_network
from omnisyn_cli.training.loop import train
from omnisyn_cli.training.publish import publish
from omnisyn_cli.training.tasks import TrainConfig
from synsin_samples import TINY_SIZE, write_synsin_models


@pytest.fixture
def checkpoint(tmp_path):
    pool = str(make_pool(tmp_path / "pool"))
    train(TINY, TrainConfig(pool, pool, size=(64, 128), batch=1), tmp_path / "run", steps=1)
    return tmp_path / "run" / "checkpoint.pt"


def test_a_published_model_can_be_found_by_name(tmp_path, checkpoint):
    ((entry, difference),) = publish(checkpoint, tmp_path / "models", pool=tmp_path / "pool")
    assert difference < 1e-4
    assert (entry.name, entry.role, entry.size, entry.training) == ("depth-tiny", "depth", (64, 128), "1 steps")
    assert read_manifest(tmp_path / "models") == {"depth-tiny": entry}
    assert find_model("depth-tiny", tmp_path / "models") == tmp_path / "models" / "depth-tiny.onnx"


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
    monkeypatch.setattr("omnisyn_cli.training.publish.largest_difference", lambda *_: next(answers))
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


@pytest.mark.parametrize("name", ENTRIES)
def test_the_module_made_of_a_file_is_exported_to_the_same_file(tmp_path, name):
    """Byte for byte, where the same release of torch writes it; and it answers as ONNX Runtime does."""
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
