import pytest
from training_samples import TINY, make_pool

from omnisyn_cli.errors import OmnisynError
from omnisyn_cli.runtime.models import ModelEntry, find_model, read_manifest
from omnisyn_cli.training import publish
from omnisyn_cli.training.loop import TrainConfig, train


@pytest.fixture
def checkpoint(tmp_path):
    pool = str(make_pool(tmp_path / "pool"))
    train(TINY, TrainConfig(pool, pool, size=(64, 128), batch=1), tmp_path / "run", steps=1)
    return tmp_path / "run" / "checkpoint.pt"


def options(**changes):
    return {"name": None, "pool": None, "training": "", "licence": "Apache-2.0"} | changes


def test_a_published_model_can_be_found_by_name(tmp_path, checkpoint):
    entry, difference = publish.publish(checkpoint, tmp_path / "models", **options(pool=tmp_path / "pool"))
    assert difference < 1e-4
    assert (entry.name, entry.role, entry.size, entry.training) == ("depth-tiny", "depth", (64, 128), "1 steps")
    assert read_manifest(tmp_path / "models") == {"depth-tiny": entry}
    assert find_model("depth-tiny", tmp_path / "models") == tmp_path / "models" / "depth-tiny.onnx"


def test_a_model_that_says_something_else_is_refused(tmp_path, checkpoint, monkeypatch):
    monkeypatch.setattr(publish, "largest_difference", lambda *_: 0.01)
    with pytest.raises(OmnisynError, match="not exported"):
        publish.publish(checkpoint, tmp_path / "models", **options())
    assert list((tmp_path / "models").iterdir()) == []


def test_a_manifest_survives_the_disk(tmp_path):
    entries = {
        name: ModelEntry(
            name, "depth", "fast", f"{name}.onnx", "00", (2, 4), 7, 'so "quoted"', "MIT", {"delta_25": 0.5}
        )
        for name in ("a", "b")
    }
    publish.write_manifest(tmp_path, entries)
    assert read_manifest(tmp_path) == entries
