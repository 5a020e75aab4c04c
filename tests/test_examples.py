"""What lies in examples/ works."""

import re
import runpy
import shutil
from pathlib import Path

import pytest

from omnisyn_cli.interpolation.viewer.page import module_code
from omnisyn_cli.io import read_header, read_panorama
from omnisyn_cli.poses.file import read_poses

EXAMPLES = Path(__file__).parents[1] / "examples"
FOLDERS = sorted(path for path in EXAMPLES.iterdir() if path.is_dir())


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_every_pair_is_complete(folder: Path) -> None:
    poses = read_poses(folder / "poses.json")
    for name in ("first.jpg", "second.jpg"):
        panorama = read_panorama(folder / name)
        assert panorama.image.shape[1] == 2 * panorama.image.shape[0]
        assert poses.of(folder / name).pose.position.shape == (3,)


def test_the_strip_shows_five_bands(tmp_path: Path) -> None:
    for name in ("first.jpg", "second.jpg", "poses.json"):
        shutil.copy(EXAMPLES / "street" / name, tmp_path / name)
    make_strip = runpy.run_path(str(EXAMPLES / "make_strip.py"))["make_strip"]
    header = read_header(make_strip(tmp_path, 256))
    assert (header.height, header.width) == (5 * 64 + 4 * 4, 256)


def test_the_walk_is_what_view_makes_now() -> None:
    """After a change of its scripts or its rules the page is made again: see examples/README.md."""
    page = (EXAMPLES / "street" / "walk.html").read_text(encoding="utf-8")
    (script,) = re.findall(r'<script type="module">(.*?)</script>', page, re.DOTALL)
    assert script.startswith(module_code())
