"""``omnisyn export`` from the command line: formats by name or ending, refusals, all of it or nothing."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from interpolation_samples import CHAIN
from omnisyn_cli.cli import export as command
from omnisyn_cli.cli import main
from omnisyn_cli.interpolation import export as library
from synthesis_samples import write_hall


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["export", *map(str, arguments)])
    return int(ended.value.code or 0)


@pytest.fixture
def walk(tmp_path: Path) -> list[Path]:
    folder = tmp_path / "a walk"
    folder.mkdir()
    return write_hall(folder, CHAIN)


def options(walk: list[Path], output: Path) -> list[object]:
    return ["--poses", walk[0].parent / "poses.json", "-o", output, "--threads", 1]


def test_formats_are_those_of_the_library() -> None:
    assert tuple(library.FORMATS) == command.FORMATS


@pytest.mark.parametrize(
    ("name", "chosen", "begins"),
    [("a b.glb", None, b"glTF"), ("a b.PLY", None, b"ply\n"), ("c.ply", "splats", b"ply\n")],
)
def test_a_file_is_written_by_its_ending_or_by_name(
    walk: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, chosen: str | None, begins: bytes
) -> None:
    named = [] if chosen is None else ["--format", chosen]
    assert run(*walk, *options(walk, tmp_path / name), *named) == 0
    data = (tmp_path / name).read_bytes()
    assert data.startswith(begins)
    assert (b"rot_3" in data[:1000]) == (chosen == "splats")
    assert f"{name}: " in capsys.readouterr().out
    assert [file.name for file in tmp_path.iterdir()] in (["a walk", name], [name, "a walk"])


@pytest.mark.parametrize("chosen", ["colmap", "nerfstudio"])
def test_a_folder_is_filled_and_added_to_only_if_asked(
    walk: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], chosen: str
) -> None:
    given = [*walk, *options(walk, tmp_path / "data set"), "--format", chosen]
    assert run(*given) == 0
    first = listing_of(tmp_path / "data set")
    (tmp_path / "data set" / "mine.txt").write_text("mine")
    assert run(*given) == 3
    assert "expected a new or empty folder" in capsys.readouterr().err
    assert run(*given, "--overwrite") == 0
    assert listing_of(tmp_path / "data set") == first | {"mine.txt": b"mine"}


def listing_of(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_nothing_is_overwritten_unasked(walk: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "old.glb").write_bytes(b"old")
    assert run(*walk, *options(walk, tmp_path / "old.glb")) == 3
    assert "--overwrite" in capsys.readouterr().err
    assert (tmp_path / "old.glb").read_bytes() == b"old"
    assert run(*walk, *options(walk, tmp_path / "old.glb"), "--overwrite") == 0
    assert (tmp_path / "old.glb").read_bytes().startswith(b"glTF")


@pytest.mark.parametrize(
    ("output", "more", "says"),
    [
        ("x.obj", [], "expected a name ending in .glb or .ply, or a format for a folder, got '.obj'"),
        ("folder", [], "name the format"),
        ("x.ply", ["--format", "glb"], "expected a name ending in .glb for glb"),
        ("no/x.glb", [], "expected an existing folder"),
        ("a walk", ["--format", "colmap", "--overwrite"], "expected inputs that are not overwritten"),
    ],
)
def test_places_that_do_not_fit_are_refused_before_any_work(
    walk: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], output: str, more: list[str], says: str
) -> None:
    before = listing_of(tmp_path)
    assert run(*walk, *options(walk, tmp_path / output), *more) == 3
    assert says in capsys.readouterr().err
    assert listing_of(tmp_path) == before


def test_a_missing_pose_and_a_single_panorama_are_named(
    walk: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(walk[0], walk[0].with_name("other one.png"))
    assert run(*walk, walk[0].with_name("other one.png"), *options(walk, tmp_path / "x.glb")) == 3
    assert "other one.png" in capsys.readouterr().err
    assert run(walk[0], *options(walk, tmp_path / "x.glb")) == 3
    assert "two or more panoramas, got 1" in capsys.readouterr().err
    assert run(*walk, *options(walk, tmp_path / "x.glb"), "--cut", 0.1, "--cut-metres", 1) == 2


def test_a_broken_panorama_leaves_nothing(walk: list[Path], tmp_path: Path) -> None:
    walk[2].write_bytes(walk[2].read_bytes()[:600])
    for name, chosen in (("x.glb", "glb"), ("set", "colmap")):
        assert run(*walk, *options(walk, tmp_path / name), "--format", chosen) == 3
        assert [file.name for file in tmp_path.iterdir()] == ["a walk"]


def test_a_dry_run_writes_nothing_and_says_what_would_be(
    walk: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*walk, *options(walk, tmp_path / "x.ply"), "--format", "splats", "--dry-run", "--json") == 0
    plan = json.loads(capsys.readouterr().out)
    assert (plan["format"], plan["depth"], plan["sky"], plan["stride"]) == ("splats", "file", True, 1)
    assert plan["memory_mib"] > 100
    assert not (tmp_path / "x.ply").exists()


def test_panoramas_of_one_place_without_depth_are_a_dome(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = write_hall(tmp_path, [CHAIN[0]] * 2, with_depth=False)
    assert run(*walk, *options(walk, tmp_path / "x.glb"), "--json") == 0
    said = capsys.readouterr()
    assert "have the same position" in said.err
    assert json.loads(said.out)["triangles"] > 0
    assert run(*walk, *options(walk, tmp_path / "x.ply")) == 3
    assert "got sky or masks everywhere" in capsys.readouterr().err


def test_the_summary_counts_what_is_in_the_file(
    walk: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*walk, *options(walk, tmp_path / "x.ply"), "--stride", 3, "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    head = (tmp_path / "x.ply").read_bytes().split(b"end_header")[0].decode()
    assert f"element vertex {summary['points']}\n" in head
    assert [pair["first"] for pair in summary["confidence"]] == [0, 1]
    assert np.isfinite(summary["stages"]["total"])
