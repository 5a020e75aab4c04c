"""``omnisyn view`` from the command line, and the page that ``interpolate --view`` makes beside a video."""

import os
import signal
import sys
from pathlib import Path
from urllib.request import urlopen

import pytest

from cli.cli_samples import Omnisyn, start_cli
from interpolation_samples import CHAIN, listing
from synthesis_samples import write_hall


@pytest.fixture
def tour(tmp_path: Path) -> list[Path]:
    folder = tmp_path / "a walk"
    folder.mkdir()
    return write_hall(folder, CHAIN)


def given(tour: list[Path], *more: object) -> list[object]:
    return [*tour, "--poses", tour[0].parent / "poses.json", "--threads", 1, *more]


def test_a_page_is_written_and_said(tour: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    page = tmp_path / "a b.html"
    result = omnisyn.quiet("view", *given(tour, "-o", page))
    assert result.out.startswith(f"{page}: a walk through 3 panoramas, ")
    assert "--overwrite" in omnisyn.refused("view", *given(tour, "-o", page))
    before = page.read_bytes()
    assert omnisyn("view", *given(tour, "-o", page, "--overwrite", "--quiet")).out == ""
    assert page.read_bytes() == before


def test_a_video_s_page_is_the_page_of_view(tour: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    """Of the same depth, pairs without a frame of their own included."""
    omnisyn.made("view", *given(tour, "-o", tmp_path / "own.html"))
    more = ("--frames", 3, "-o", tmp_path / "frames", "--view", tmp_path / "beside.html")
    made = omnisyn.made("interpolate", *given(tour, *more))
    assert made.out.splitlines()[1] == f"{tmp_path / 'beside.html'}: a walk through 3 panoramas"
    assert (tmp_path / "beside.html").read_bytes() == (tmp_path / "own.html").read_bytes()
    assert len(listing(tmp_path / "frames")) == 3


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--view", "walk.mp4"), "ending in .html"),
        (("--view", "there.html"), "one that exists"),
        (("--view", "new.html", "--method", "synsin"), "no view"),
    ],
)
def test_a_page_that_cannot_be_is_refused_before_any_frame(
    tour: list[Path], tmp_path: Path, omnisyn: Omnisyn, more: tuple[str, ...], words: str
) -> None:
    (tmp_path / "there.html").write_text("mine")
    placed = [tmp_path / text if text.endswith((".html", ".mp4")) else text for text in more]
    assert words in omnisyn.refused("interpolate", *given(tour, "-o", tmp_path / "frames", *placed))


def test_the_summary_of_a_video_names_its_page(tour: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    words = ("interpolate", *given(tour, "--frames", 3, "-o", tmp_path / "frames"))
    assert omnisyn.json(*words, "--view", tmp_path / "beside.html")["view"] == str(tmp_path / "beside.html")
    assert omnisyn.json(*words, "--overwrite")["view"] == ""


def test_a_dry_run_says_what_would_be_done(tour: list[Path], tmp_path: Path, omnisyn: Omnisyn) -> None:
    plan = omnisyn.json("view", *given(tour, "-o", tmp_path / "walk.html", "--dry-run"))
    assert (plan["texture"], plan["depth"], plan["folder"]) == (4096, "file", False)
    assert plan["memory_mib"] > 100
    assert not (tmp_path / "walk.html").exists()


@pytest.mark.parametrize("more", [("--serve",), ("--cut", "0.1", "--cut-metres", "1")])
def test_options_that_contradict_each_other_are_wrong_usage(
    tour: list[Path], tmp_path: Path, omnisyn: Omnisyn, more: tuple[str, ...]
) -> None:
    omnisyn.misused("view", *given(tour, "-o", tmp_path / "walk.html", *more))


def test_a_folder_is_served_until_it_is_ended(tour: list[Path], tmp_path: Path) -> None:
    process = start_cli("view", *given(tour, "-o", tmp_path / "walk", "--folder", "--serve"), folder=tmp_path)
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
    tour: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, note: str
) -> None:
    (tmp_path / "bin").mkdir()
    opener = tmp_path / "bin" / "xdg-open"
    opener.write_text(f'#!/bin/sh\necho "no method available" >&2\necho "$1" > opened\nexit {code}\n')
    opener.chmod(0o755)
    monkeypatch.setenv("PATH", f"{opener.parent}:{os.environ['PATH']}")
    process = start_cli("view", *given(tour, "-o", "-walk.html", "--open", "-q"), folder=tmp_path)
    _, err = process.communicate()
    assert (process.returncode, err.decode()) == (0, note.format(tmp_path / "-walk.html"))
    assert (tmp_path / "opened").read_text().strip() == str(tmp_path / "-walk.html")
