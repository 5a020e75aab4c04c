"""``omnisyn view`` and ``omnisyn export``: pages and files by name or ending, refusals, all of it or nothing."""

import json
import os
import shutil
import signal
import sys
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest

from cli.cli_samples import Omnisyn, start_cli
from interpolation_samples import CHAIN, listing
from omnisyn_cli.cli import export as command
from omnisyn_cli.interpolation.export import formats as library
from synthesis_samples import write_hall


@pytest.fixture
def walk(tmp_path: Path) -> list[Path]:
    folder = tmp_path / "a walk"
    folder.mkdir()
    return write_hall(folder, CHAIN)


def given(walk: list[Path], *more: object) -> list[object]:
    return [*walk, "--poses", walk[0].parent / "poses.json", "--threads", 1, *more]


def test_a_page_is_written_and_said(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    page = tmp_path / "a b.html"
    result = omnisyn.quiet("view", *given(walk, "-o", page))
    assert result.out.startswith(f"{page}: a walk through 3 panoramas, ")
    assert "--overwrite" in omnisyn.refused("view", *given(walk, "-o", page))
    before = page.read_bytes()
    assert omnisyn("view", *given(walk, "-o", page, "--overwrite", "--quiet")).out == ""
    assert page.read_bytes() == before


def test_a_video_s_page_is_the_page_of_view(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    """Of the same depth, pairs without a frame of their own included."""
    omnisyn.made("view", *given(walk, "-o", tmp_path / "own.html"))
    more = ("--frames", 3, "-o", tmp_path / "frames", "--view", tmp_path / "beside.html")
    made = omnisyn.made("interpolate", *given(walk, *more))
    assert made.out.splitlines()[1] == f"{tmp_path / 'beside.html'}: a walk through 3 panoramas"
    assert (tmp_path / "beside.html").read_bytes() == (tmp_path / "own.html").read_bytes()
    assert len(listing(tmp_path / "frames")) == 3


@pytest.mark.parametrize(
    ("more", "words"),
    [(("--view", "walk.mp4"), "ending in .html"), (("--view", "there.html"), "one that exists"),
     (("--view", "new.html", "--method", "synsin"), "no view")],
)  # fmt: skip
def test_a_page_that_cannot_be_is_refused_before_any_frame(
    walk: list[Path], tmp_path: Path, omnisyn: Omnisyn, more: tuple[str, ...], words: str
) -> None:
    (tmp_path / "there.html").write_text("mine")
    placed = [tmp_path / text if text.endswith((".html", ".mp4")) else text for text in more]
    assert words in omnisyn.refused("interpolate", *given(walk, "-o", tmp_path / "frames", *placed))


def test_the_summary_of_a_video_names_its_page(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    words = ("interpolate", *given(walk, "--frames", 3, "-o", tmp_path / "frames"))
    assert omnisyn.json(*words, "--view", tmp_path / "beside.html")["view"] == str(tmp_path / "beside.html")
    assert omnisyn.json(*words, "--overwrite")["view"] == ""


def test_a_dry_run_says_what_would_be_done(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    plan = omnisyn.json("view", *given(walk, "-o", tmp_path / "walk.html", "--dry-run"))
    assert (plan["texture"], plan["depth"], plan["folder"]) == (4096, "file", False)
    assert plan["memory_mib"] > 100
    assert not (tmp_path / "walk.html").exists()


@pytest.mark.parametrize("more", [("--serve",), ("--cut", "0.1", "--cut-metres", "1")])
def test_options_that_contradict_each_other_are_wrong_usage(
    walk: list[Path], tmp_path: Path, omnisyn: Omnisyn, more: tuple[str, ...]
) -> None:
    omnisyn.misused("view", *given(walk, "-o", tmp_path / "walk.html", *more))


def test_a_folder_is_served_until_it_is_ended(walk: list[Path], tmp_path: Path) -> None:
    process = start_cli("view", *given(walk, "-o", tmp_path / "walk", "--folder", "--serve"), folder=tmp_path)
    try:
        assert process.stderr is not None
        line = next(line for line in process.stderr if b"http://" in line)
        with urlopen(line.split()[0].decode()) as answer:  # noqa: S310 - this machine
            assert answer.read() == (tmp_path / "walk" / "index.html").read_bytes()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 130
    finally:
        process.kill()
        process.communicate()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have other openers")
@pytest.mark.parametrize(("code", "note"), [(0, ""), (3, "note: expected a browser, got none; open {} in one\n")])
def test_what_opens_a_browser_says_nothing_itself(
    walk: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, note: str
) -> None:
    (tmp_path / "bin").mkdir()
    opener = tmp_path / "bin" / "xdg-open"
    opener.write_text(f'#!/bin/sh\necho "no method available" >&2\necho "$1" > opened\nexit {code}\n')
    opener.chmod(0o755)
    monkeypatch.setenv("PATH", f"{opener.parent}:{os.environ['PATH']}")
    process = start_cli("view", *given(walk, "-o", "-walk.html", "--open", "-q"), folder=tmp_path)
    _, err = process.communicate()
    assert (process.returncode, err.decode()) == (0, note.format(tmp_path / "-walk.html"))
    assert (tmp_path / "opened").read_text().strip() == str(tmp_path / "-walk.html")


def words(walk: list[Path], output: Path, *more: object) -> list[object]:
    return ["export", *given(walk, "-o", output, *more)]


def test_formats_are_those_of_the_library() -> None:
    assert tuple(library.FORMATS) == command.FORMATS


@pytest.mark.parametrize(
    ("name", "chosen", "begins"),
    [("a b.glb", [], b"glTF"), ("a b.PLY", [], b"ply\n"), ("c.ply", ["--format", "splats"], b"ply\n")],
)
def test_a_file_is_written_by_its_ending_or_by_name(
    walk: list[Path], tmp_path: Path, omnisyn: Omnisyn, name: str, chosen: list[str], begins: bytes
) -> None:
    assert f"{name}: " in omnisyn.made(*words(walk, tmp_path / name, *chosen)).out
    data = (tmp_path / name).read_bytes()
    assert data.startswith(begins)
    assert (b"rot_3" in data[:1000]) == ("splats" in chosen)
    assert {file.name for file in tmp_path.iterdir()} == {"a walk", name}


@pytest.mark.parametrize("chosen", ["colmap", "nerfstudio"])
def test_a_folder_is_filled_and_added_to_only_if_asked(
    walk: list[Path], tmp_path: Path, omnisyn: Omnisyn, chosen: str
) -> None:
    given = words(walk, tmp_path / "data set", "--format", chosen)
    omnisyn.made(*given)
    first = listing(tmp_path / "data set")
    (tmp_path / "data set" / "mine.txt").write_text("mine")
    assert "expected a new or empty folder" in omnisyn.refused(*given)
    omnisyn.made(*given, "--overwrite")
    assert listing(tmp_path / "data set") == first | {"mine.txt": b"mine"}


def test_nothing_is_overwritten_unasked(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    (tmp_path / "old.glb").write_bytes(b"old")
    assert "--overwrite" in omnisyn.refused(*words(walk, tmp_path / "old.glb"))
    assert (tmp_path / "old.glb").read_bytes() == b"old"
    omnisyn.made(*words(walk, tmp_path / "old.glb", "--overwrite"))
    assert (tmp_path / "old.glb").read_bytes().startswith(b"glTF")


@pytest.mark.parametrize(
    ("output", "more", "says"),
    [("x.obj", [], "expected a name ending in .glb or .ply, or a format for a folder, got '.obj'"),
     ("folder", [], "name the format"), ("x.ply", ["--format", "glb"], "expected a name ending in .glb for glb"),
     ("no/x.glb", [], "expected an existing folder"),
     ("a walk", ["--format", "colmap", "--overwrite"], "expected inputs that are not overwritten")],
)  # fmt: skip
def test_places_that_do_not_fit_are_refused_before_any_work(
    walk: list[Path], tmp_path: Path, omnisyn: Omnisyn, output: str, more: list[str], says: str
) -> None:
    assert says in omnisyn.refused(*words(walk, tmp_path / output, *more))


def test_a_missing_pose_and_a_single_panorama_are_named(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    other = Path(shutil.copy(walk[0], walk[0].with_name("other one.png")))
    assert "other one.png" in omnisyn.refused(*words([*walk, other], tmp_path / "x.glb"))
    assert "two or more panoramas or a folder of them, got one" in omnisyn.refused(*words(walk[:1], tmp_path / "x.glb"))
    omnisyn.misused(*words(walk, tmp_path / "x.glb", "--cut", 0.1, "--cut-metres", 1))


@pytest.mark.parametrize(("name", "chosen"), [("x.glb", "glb"), ("set", "colmap")])
def test_a_broken_panorama_leaves_nothing(
    walk: list[Path], tmp_path: Path, omnisyn: Omnisyn, name: str, chosen: str
) -> None:
    walk[2].write_bytes(walk[2].read_bytes()[:600])
    omnisyn.refused(*words(walk, tmp_path / name, "--format", chosen))


def test_a_dry_run_writes_nothing_and_says_what_would_be(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    plan = omnisyn.json(*words(walk, tmp_path / "x.ply", "--format", "splats", "--dry-run"))
    assert (plan["format"], plan["depth"], plan["sky"], plan["stride"]) == ("splats", "file", True, 1)
    assert plan["memory_mib"] > 100
    assert "sky: yes\n" in omnisyn.made(*words(walk, tmp_path / "x.ply", "--format", "splats", "--dry-run")).out
    assert not (tmp_path / "x.ply").exists()


def test_panoramas_of_one_place_without_depth_are_a_dome(tmp_path: Path, omnisyn: Omnisyn) -> None:
    walk = write_hall(tmp_path, [CHAIN[0]] * 2, with_depth=False)
    said = omnisyn.made(*words(walk, tmp_path / "x.glb", "--json"))
    assert "have the same position" in said.err
    assert json.loads(said.out)["triangles"] > 0
    assert "got sky or masks everywhere" in omnisyn.ended(3, *words(walk, tmp_path / "x.ply")).err


def test_the_summary_counts_what_is_in_the_file(walk: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    summary = omnisyn.json(*words(walk, tmp_path / "x.ply", "--stride", 3))
    head = (tmp_path / "x.ply").read_bytes().split(b"end_header")[0].decode()
    assert f"element vertex {summary['points']}\n" in head
    assert [pair["first"] for pair in summary["confidence"]["pairs"]] == [0, 1]
    assert np.isfinite(summary["stages"]["total"])
