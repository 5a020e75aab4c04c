import json

import pytest
from click.testing import CliRunner

from cli.cli_samples import pair_arguments, write_pair
from omnisyn_cli.cli.models import models
from omnisyn_cli.errors import InputError
from omnisyn_cli.pipeline.depth_sources import DEPTH_SOURCES
from omnisyn_cli.pipeline.fusions import FUSIONS
from omnisyn_cli.pipeline.presets import PRESETS
from omnisyn_cli.runtime.models import ModelEntry, models_folder, read_manifest, sha256_of
from omnisyn_cli.training.publish import write_manifest


def test_what_the_presets_need_is_shipped_whole():
    result = CliRunner().invoke(models, ["--json"])
    assert result.exit_code == 0, result.output
    entries = {entry["name"]: entry for entry in json.loads(result.stdout)}
    assert {preset.config.depth.model for preset in PRESETS.values()} <= entries.keys()
    assert {fusion.model for fusion in FUSIONS.values() if fusion.model} <= entries.keys()
    for entry in entries.values():
        assert (models_folder() / entry["file"]).stat().st_size < 16 * 2**20


def test_the_table_of_bundled_networks_fits_a_terminal():
    lines = CliRunner().invoke(models).output.splitlines()
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


def test_a_folder_of_ones_own_is_listed_and_its_files_are_checked(tmp_path):
    (tmp_path / "a.onnx").write_bytes(b"weights")
    digest = sha256_of(tmp_path / "a.onnx")
    entry = ModelEntry("a", "refine", "v", "a.onnx", digest, (2, 4), 7, "scenes", "MIT", {"delta_25": 0.5})
    write_manifest(tmp_path, {"a": entry})
    result = CliRunner().invoke(models, [str(tmp_path)])
    assert result.output.splitlines() == [
        "name  role    size  parameters  hours  purpose",
        "a     refine  4x2   7           -",
    ]
    (tmp_path / "a.onnx").write_bytes(b"other weights")
    with pytest.raises(InputError, match="sha256"):
        CliRunner().invoke(models, [str(tmp_path)], catch_exceptions=False)


def test_an_empty_folder_says_how_models_are_made(tmp_path):
    assert "export-onnx" in CliRunner().invoke(models, [str(tmp_path)]).output
