"""What ``import omnisyn_cli`` offers: light to import, complete, and its documentation runs."""

import pydoc
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import omnisyn_cli as omnisyn
from omnisyn_cli.cli import cli
from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.evaluation import public_api as verbs_that_compare
from omnisyn_cli.interpolation import api
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.io import read_panorama
from synthesis_samples import SIZE, hall_image, hall_view, posed, write_hall, ws_psnr

ROOT = Path(__file__).parents[1]

BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```", re.M | re.S)


@pytest.mark.parametrize("document", ["README.md", "docs/python.md"])
def test_every_example_runs(document: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of Python, in their order, and in the documentation of the library the commands between them."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    ran = 0
    for language, text in BLOCK.findall((ROOT / document).read_text(encoding="utf-8")):
        if language == "python":
            exec(compile(text, document, "exec"), {})  # noqa: S102 - our own documentation
            ran += 1
        elif document == "docs/python.md":
            cli.main(shlex.split(text)[1:], standalone_mode=False)
    assert ran > 0
    assert all(video.stat().st_size > 0 for video in tmp_path.glob("*.mp4"))


def test_importing_the_package_imports_nothing_else() -> None:
    program = "import sys, omnisyn_cli; print(*(name for name in sys.modules if name.startswith('omnisyn_cli')))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["omnisyn_cli"]


def test_every_name_is_there_and_no_other() -> None:
    homes = {name: home for home in (api, verbs_that_compare) for name in home.__all__}
    assert sorted(omnisyn.__all__) == sorted(homes)
    for name, home in homes.items():
        assert getattr(omnisyn, name) is getattr(home, name)
        assert name in dir(omnisyn)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        omnisyn.nothing  # noqa: B018


def test_known_depth_makes_the_true_frames(tmp_path: Path) -> None:
    poses = [posed((0, 0, 0.6)), posed((0, 0, -0.6))]
    views = omnisyn.read_views(write_hall(tmp_path, poses, (128, 256)), tmp_path / "poses.json")
    frames = list(omnisyn.make_frames(views, 3, "balanced", size=SIZE))
    assert ws_psnr(frames[1], hall_image(posed((0, 0, 0)))) > 40
    (tmp_path / "frames").mkdir()
    omnisyn.write_video(tmp_path / "frames", frames)
    for frame, path in zip(frames, sorted((tmp_path / "frames").iterdir()), strict=True):
        np.testing.assert_allclose(read_panorama(path).image, frame, atol=0.5 / 255 + 1e-6)


def test_what_cannot_be_used_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="one frame or more"):
        omnisyn.write_video(tmp_path / "none.mp4", [])
    with pytest.raises(ValueError, match="preset of fast"):
        list(omnisyn.make_frames([hall_view(posed((0, 0, z))) for z in (0.5, -0.5)], 3, "hasty"))


def test_a_single_name_is_no_list_of_panoramas(tmp_path: Path) -> None:
    for verb in (
        lambda: omnisyn.read_views("a.jpg", "p.json"),
        lambda: omnisyn.interpolate("a.jpg", "p.json", "o.mp4"),
    ):
        with pytest.raises(InputError, match=r"got the single name 'a\.jpg'"):
            verb()


@pytest.mark.parametrize("size", ["128x64", (128, 64), (64, 128)])
def test_sizes_are_names_or_both_numbers(tmp_path: Path, size: str | tuple[int, int]) -> None:
    images = write_hall(tmp_path, [posed((0, 0, 0.3)), posed((0, 0, -0.3))], (32, 64))
    poses = tmp_path / "poses.json"
    frames = omnisyn.make_frames(omnisyn.read_views(images, poses), 2, "fast", size=size)
    assert next(frames).shape == (64, 128, 3)
    made = omnisyn.interpolate([str(image) for image in images], str(poses), str(tmp_path / "o"), frames=2, size=size)
    assert made.plan.size == (64, 128)
    assert repr(made).startswith(f"Summary({tmp_path / 'o'}: 2 png images of 128x64 in ")
    assert "\n" not in repr(made)


@pytest.mark.parametrize("size", ["64x128", "64", (64, 64), (1, 2, 3), "0x0"])
def test_a_size_that_is_none_says_what_is(size: str | tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="twice as wide as high, such as 2048x1024"):
        list(omnisyn.make_frames([hall_view(posed((0, 0, z))) for z in (0.5, -0.5)], 3, size=size))  # type: ignore[arg-type]


def test_a_view_is_shown_in_a_line() -> None:
    assert repr(hall_view(posed((0, 0.25, -1)))) == "View(128x64 at (0, 0.25, -1) m, with depth)"


def test_help_lists_every_option_with_its_type() -> None:
    text = pydoc.render_doc(omnisyn.interpolate, renderer=pydoc.plaintext)
    for field in fields(InterpolationJob):
        assert re.search(rf"\b{field.name}: .*", text), field.name
    assert "frames: int | None = None" in text or "frames: Optional[int] = None" in text
    assert "one of :data:`omnisyn_cli.pipeline.presets.PRESETS`" in text
