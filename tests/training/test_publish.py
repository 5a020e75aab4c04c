import pytest
from training_samples import TINY, make_pool

from omnisyn_cli.errors import OmnisynError, OutputPathError
from omnisyn_cli.pipeline.methods import SYNSIN_MODELS
from omnisyn_cli.runtime.models import ModelEntry, find_model, read_manifest
from omnisyn_cli.training.loop import train
from omnisyn_cli.training.publish import publish, write_manifest
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


def test_a_model_that_says_something_else_is_refused(tmp_path, checkpoint, monkeypatch):
    monkeypatch.setattr("omnisyn_cli.training.publish.largest_difference", lambda *_: 0.01)
    with pytest.raises(OmnisynError, match="not exported"):
        publish(checkpoint, tmp_path / "models")
    assert list((tmp_path / "models").iterdir()) == []


def test_a_manifest_survives_the_disk(tmp_path):
    entries = {
        name: ModelEntry(
            name, "depth", "fast", f"{name}.onnx", "00", (2, 4), 7, 'so "quoted"', "MIT", {"delta_25": 0.5}
        )
        for name in ("a", "b")
    }
    write_manifest(tmp_path, entries)
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
