"""``omnisyn info --report``: a page about each pair, whole in one file, whatever the panoramas are called."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import Omnisyn
from interpolation_samples import edit_poses
from omnisyn_cli.geometry.pose import distance_between
from omnisyn_cli.interpolation import summary
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.types import DepthEstimate, View

ROOM = Path(__file__).parents[2] / "examples" / "room"
SECOND = "<b>&'.jpg"


@pytest.fixture
def room(tmp_path: Path) -> list[Path]:
    """Photographs of a room at a quarter of their size, and their poses."""
    shutil.copy(ROOM / "poses.json", tmp_path)
    for name, copy in (("first.jpg", "first.jpg"), ("second.jpg", SECOND)):
        image = read_panorama(ROOM / name).original
        assert image is not None
        write_image(tmp_path / copy, np.ascontiguousarray(image[::4, ::4]))
    edit_poses(tmp_path, lambda panoramas: panoramas.update({SECOND: panoramas.pop("second.jpg")}))
    return [tmp_path / "first.jpg", tmp_path / SECOND]


def circles(page: str, kind: str) -> int:
    return page.count(f'<circle class="{kind}"')


def test_the_page_shows_matches_epipoles_depth_and_confidence(
    tmp_path: Path, room: list[Path], omnisyn: Omnisyn
) -> None:
    arguments = [*room, tmp_path / "poses.json", "--preset", "fast", "--report", tmp_path / "report.html"]
    omnisyn.made("info", *arguments)
    page = (tmp_path / "report.html").read_text()
    assert circles(page, "fits") > 10 * circles(page, "contradicts")
    assert page.count('<path class="epipole"') == 4
    assert (
        len(re.findall(r'(?:src|href)="data:image/jpeg;base64,', page)) == len(re.findall(r'(?:src|href)="', page)) == 6
    )
    assert "<b>&'" not in page
    assert "confidence: high (" in page
    assert "the poses fit" in page
    assert "expected a new file" in omnisyn("info", *arguments).err


def test_wrong_poses_are_seen_in_red(tmp_path: Path, room: list[Path], omnisyn: Omnisyn) -> None:
    edit_poses(tmp_path, lambda panoramas: panoramas[SECOND].update(rotation=[0.98, 0, 0.199, 0]))
    omnisyn.made("info", *room, tmp_path / "poses.json", "--preset", "fast", "--report", tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert circles(page, "contradicts") > 10 * circles(page, "fits")


def two_baselines_away(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
    rho = np.full((64, 128), 0.5 / distance_between(first.pose, second.pose), np.float32)
    return (DepthEstimate(rho, np.ones_like(rho)),) * 2


def test_the_page_that_a_video_suggests_has_the_metres_of_the_video(
    tmp_path: Path, room: list[Path], omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where poses are found in the pictures; of a depth that follows from them at once."""
    monkeypatch.chdir(tmp_path)
    for module in ("pipeline.config", "interpolation.loading"):
        monkeypatch.setattr(f"omnisyn_cli.{module}.make_estimator", lambda *_, **__: two_baselines_away)
    monkeypatch.setattr(summary, "CONFIDENCE_WORDS", ((1.1, "high"), (0.0, "low")))
    nearest, fast = [], ("--preset", "fast")
    for baseline in (1.0, 2.5):
        poses = ("--poses", "auto", "--baseline", baseline)
        made = omnisyn.made("interpolate", *room, *poses, "-o", f"{baseline}.mp4", "--frames", 3, *fast)
        command = re.search(r"^to see why: omnisyn (.*)$", made.out, re.MULTILINE)
        assert command
        omnisyn.made(*shlex.split(command[1]), *fast, "--overwrite")
        nearest.append(float(re.findall(r"from ([\d.]+) m on", (tmp_path / "report.html").read_text())[0]))
    assert nearest == pytest.approx([2.0, 5.0], rel=0.02)


def test_a_report_is_about_two_panoramas_and_one_pose_file(tmp_path: Path, room: list[Path], omnisyn: Omnisyn) -> None:
    page, poses = tmp_path / "report.html", tmp_path / "poses.json"
    for files, message in (
        ([room[0], poses], "expected two or more panoramas, got 1"),
        ([*room, poses, poses], "one pose file"),
    ):
        result = omnisyn("info", *files, "--report", page)
        assert message in result.err
        assert result.code in (2, 3)
        assert not page.exists()


def test_parts_of_the_sphere_are_read_as_for_a_video(tmp_path: Path, room: list[Path], omnisyn: Omnisyn) -> None:
    """Nothing is to see above the middle half and below it."""
    for path in room:
        image = read_panorama(path).original
        assert image is not None
        write_image(path, np.ascontiguousarray(image[len(image) // 4 : -len(image) // 4]))
    said = omnisyn.json("info", *room, "--hfov", 360)
    assert [each["usable_share"] for each in said] == pytest.approx([0.5, 0.5], abs=0.01)
    parts = ("--hfov", 360, "--preset", "fast", "--report", tmp_path / "report.html")
    omnisyn.made("info", *room, tmp_path / "poses.json", *parts)
    assert "the poses fit" in (tmp_path / "report.html").read_text()
