from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.runtime.test_monocular_session import network

from cli.cli_samples import Omnisyn, listing, pair_arguments, write_pair
from omnisyn_cli.evaluation.methods import find_method
from omnisyn_cli.pipeline.depth_sources import DEPTH_SOURCES
from omnisyn_cli.pipeline.fusions import FUSIONS
from omnisyn_cli.pipeline.presets import PRESETS
from omnisyn_cli.runtime.models import (
    MANIFEST,
    ModelEntry,
    added_models_folder,
    find_model,
    manifest_text,
    models_folder,
    read_manifest,
    sha256_of,
)
from omnisyn_cli.training.checkpoint import save_checkpoint
from omnisyn_cli.training.tasks import TASKS


def test_what_the_presets_need_is_shipped_whole(omnisyn):
    entries = {entry["name"]: entry for entry in omnisyn.json("models")}
    assert {preset.config.depth.model for preset in PRESETS.values()} <= entries.keys()
    assert {fusion.model for fusion in FUSIONS.values() if fusion.model} <= entries.keys()
    for entry in entries.values():
        assert (models_folder() / entry["file"]).stat().st_size < 16 * 2**20


def test_the_table_of_bundled_networks_fits_a_terminal(omnisyn):
    lines = omnisyn.made("models").out.splitlines()
    entries = read_manifest().values()
    assert max(map(len, lines)) <= 100
    table = lines[: len(entries) + 1]
    assert [line.split()[0] for line in table] == ["name", *(entry.name for entry in entries)]
    assert all(entry.hours > 0 and line.endswith(entry.purpose) for entry, line in zip(entries, table[1:], strict=True))


def test_what_model_takes_is_said_and_nothing_else_is_taken(tmp_path, omnisyn):
    """Each line below the table is a choice that can be planned; every other name and source is refused at once."""
    pair = write_pair(tmp_path)
    choices = {
        tuple(line.removeprefix("for interpolate: ").split())
        for line in omnisyn.quiet("models").out.splitlines()
        if line.startswith("for interpolate: ")
    }
    every = {
        ("--depth", source.name, "--model", name)
        for source in DEPTH_SOURCES.values()
        if source.role
        for name in read_manifest()
    }
    assert choices < every
    for choice in every:
        words = pair_arguments(tmp_path, pair, "out.mp4", *choice, "--dry-run", "--json")
        if choice in choices:
            omnisyn.json(*words)
        else:
            assert f"got '{choice[-1]}'" in omnisyn.ended(3, *words).err


def test_a_folder_of_ones_own_is_listed_and_its_files_are_checked(tmp_path, omnisyn):
    (tmp_path / "a.onnx").write_bytes(b"weights")
    digest = sha256_of(tmp_path / "a.onnx")
    entry = ModelEntry("a", "refine", "v", "a.onnx", digest, (2, 4), 7, "scenes", "MIT", {"delta_25": 0.5})
    (tmp_path / MANIFEST).write_text(manifest_text({"a": entry}), encoding="utf-8")
    assert omnisyn.quiet("models", tmp_path).out.splitlines() == [
        "name  role    size  parameters  hours  purpose",
        "a     refine  4x2   7           -",
    ]
    (tmp_path / "a.onnx").write_bytes(b"other weights")
    assert "sha256" in omnisyn.refused("models", tmp_path)
    (tmp_path / MANIFEST).unlink()
    assert "export-onnx" in omnisyn.quiet("models", tmp_path).out


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A depth network of the user's, whose folders are empty."""
    for name in ("XDG_DATA_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    return network(tmp_path / "own.onnx")


def test_a_network_of_ones_own_is_kept_used_by_its_name_and_removed(tmp_path, own, omnisyn) -> None:
    use = pair_arguments(tmp_path, write_pair(tmp_path), "out.mp4", "--depth-prior", "mine", "--dry-run")
    added = omnisyn.quiet("models", "add", own, "--name", "mine", "--kind", "panorama,depth").out
    own.unlink()
    lines = omnisyn.quiet("models").out.splitlines()
    assert added.strip() == lines[-1] == "for interpolate: --depth-prior mine"
    assert ["mine", "depth-prior", "32x16", "0", "-", "yours,", "panorama,depth"] in [line.split() for line in lines]
    assert omnisyn.json(*use)["depth_prior"] == "mine"
    for more, kind in (("", "panorama,depth"), (":prior-kind=depth", "depth")):
        assert find_method(f"omnisyn-fast:prior=mine{more}").config.depth.prior_kind == kind
    (file,) = added_models_folder().glob("*.onnx")
    file.write_bytes(b"another network")
    assert "add it again" in omnisyn.refused(*use)
    omnisyn.quiet("models", "remove", "mine")
    assert "expected an .onnx file or one of none as --depth-prior, got 'mine'" in omnisyn.refused(*use)
    assert "none was added" in omnisyn.refused("models", "remove", "mine")
    assert [path.name for path in added_models_folder().iterdir()] == ["manifest.toml"]


@pytest.mark.parametrize(
    ("name", "settings", "reason"),
    [("none", {}, "of letters"), ("a/b", {}, "of letters"), ("depth-guided", {}, "bundled"), ("tests", {}, "a file"),
     ("mine", {"inputs": 2}, "one picture"), ("mine", {"constant": np.full((1, 1, 16, 32), 3.0)}, "that varies")],
)  # fmt: skip
def test_what_could_not_be_used_is_not_added(own, omnisyn, monkeypatch, name, settings, reason) -> None:
    monkeypatch.chdir(Path(__file__).parents[2])
    assert reason in omnisyn.refused("models", "add", network(own, **settings), "--name", name)


def test_a_network_is_replaced_on_demand_only(own, omnisyn) -> None:
    words = ("models", "add", own, "--name", "mine")
    omnisyn.quiet(*words)
    before = listing(added_models_folder())
    network(own, nodes=[("ReduceMax", {"axes": [1]})])
    assert "got 'mine', which is taken" in omnisyn.refused(*words)
    assert listing(added_models_folder()) == before
    omnisyn.quiet(*words, "--overwrite")
    assert len(before) == len(listing(added_models_folder())) == 2
    assert sha256_of(find_model("mine", added_models_folder())) == sha256_of(own)


def write_checkpoint(path: Path) -> None:
    """One of a run, whose network has random weights."""
    task = TASKS["fusion"]
    config = task.variants["residual"]
    torch.manual_seed(0)
    network = task.build(config)
    state = {"kind": "fusion", "network": asdict(config), "training": {"size": (64, 128)}, "step": 1200}
    save_checkpoint(path, {**state, "average": network.state_dict()})


def test_a_model_comes_to_lie_beside_its_checkpoint_and_over_no_other_one(tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_checkpoint(tmp_path / "run" / "checkpoint.pt")
    model = tmp_path / "run" / "fusion-residual.onnx"
    words = ("export-onnx", tmp_path / "run" / "checkpoint.pt")
    assert omnisyn.made(*words).out.startswith(f"{model}: ")
    assert list(read_manifest(tmp_path / "run")) == ["fusion-residual"]
    model.write_bytes(b"mine")
    assert omnisyn.refused(*words).startswith(f"omnisyn: {model}: expected a new file, got one that exists")
    assert model.read_bytes() == b"mine"
    omnisyn.made(*words, "--overwrite")
    assert model.read_bytes() != b"mine"
