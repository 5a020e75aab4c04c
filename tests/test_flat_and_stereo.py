"""``--view flat`` and ``--stereo top-bottom`` as users have them: sizes, directions, metadata, what does not fit."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import Omnisyn, listing, pair_arguments, write_pair
from interpolation_samples import Hall, described_by_ffmpeg
from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.geometry.pose import rotation_from_heading
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.look import look_along
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_header, read_spherical
from omnisyn_cli.io.decode import decode_image
from omnisyn_cli.synthesis.trajectory import plan_path
from synthesis_samples import posed


@pytest.fixture
def images(tmp_path: Path) -> list[Path]:
    return write_pair(tmp_path)


def test_a_flat_video_is_of_16_to_9_and_says_nothing_of_a_sphere(tmp_path, images, omnisyn: Omnisyn) -> None:
    made = omnisyn.quiet(*pair_arguments(tmp_path, images, "out.mp4", "--view", "flat", "--fov", 75))
    assert "out.mp4: 3 frames of 1920x1080" in made.out
    spherical = read_spherical(tmp_path / "out.mp4")
    assert (spherical.has_version_1, spherical.has_version_2) == (False, False)
    assert "Spherical" not in described_by_ffmpeg(tmp_path / "out.mp4")
    assert (tmp_path / "out.mp4").read_bytes()[36:40] == b"moov"  # players start before the whole file has come


def test_a_flat_video_and_a_page_are_made_at_once(tmp_path, images, omnisyn: Omnisyn) -> None:
    more = ("--view", "flat", "--view", tmp_path / "walk.html", "--size", "64x36")
    omnisyn.quiet(*pair_arguments(tmp_path, images, "out.mp4", *more))
    assert {"out.mp4", "walk.html"} <= set(listing(tmp_path))
    assert "expected one page" in omnisyn.misused(*pair_arguments(tmp_path, images, "b.mp4", *more, "--view", "b.html"))


@pytest.mark.parametrize("codec", ["png", "exr"])
def test_flat_frames_begin_and_end_with_the_photographs(tmp_path: Path, images: list[Path], codec: str) -> None:
    """The panoramas have the colour of each direction, so a pinhole picture has that of its rays."""
    job = InterpolationJob(tuple(images), tmp_path / "poses.json", tmp_path / "out", frames=3, threads=1, codec=codec,
                           projection="flat", size=(36, 64), look="first", fov=np.radians(70))  # fmt: skip
    run_interpolation(plan_interpolation(job))
    step = 2 * np.tan(np.radians(35)) / 64
    x, y = (np.arange(64) - 31.5) * step, (17.5 - np.arange(36)) * step
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1)
    expected = 0.5 + 0.4 * rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    for number in (0, 2):
        samples = decode_image(tmp_path / "out" / f"{number:06d}.{codec}")[1]
        np.testing.assert_allclose(samples / (255.0 if samples.dtype == np.uint8 else 1.0), expected, atol=0.02)


def test_looks(tmp_path: Path) -> None:
    first = posed((0, 0, 0), heading=0.5, pitch=0.2, roll=0.1)
    path = plan_path([first, posed((1, 0, 0))], 5, heading="travel")
    forward = {
        look: [w.pose.rotation @ [0, 0, -1] for w in look_along(path, first, look)]
        for look in ("ahead", "first", "40,-10")
    }
    np.testing.assert_allclose(forward["ahead"], [[1, 0, 0]] * 5, atol=1e-9)
    heading = np.arctan2(*(first.rotation @ [0, 0, -1])[[0, 2]] * (1, -1))
    np.testing.assert_allclose(forward["first"], [rotation_from_heading(heading) @ [0, 0, -1]] * 5, atol=1e-9)
    turned = rotation_from_heading(heading + np.radians(40), np.radians(-10)) @ [0, 0, -1]
    np.testing.assert_allclose(forward["40,-10"], [turned] * 5, atol=1e-9)
    keys = tmp_path / "look.json"
    keys.write_text(json.dumps([{"at": 0, "yaw": 0}, {"at": 1, "yaw": 80, "pitch": -20}]))
    np.testing.assert_allclose(look_along(path, first, str(keys))[2].pose.rotation @ [0, 0, -1], turned, atol=1e-9)
    keys.write_text(json.dumps([{"at": 2, "yaw": 0}]))
    with pytest.raises(PoseError, match=r"keyframes\[0\]\.at"):
        look_along(path, first, str(keys))
    for wrong in ("sideways", "1,2,3", "nan,0", "0,91"):
        with pytest.raises(InputError, match=r"expected ahead, first, YAW,PITCH"):
            look_along(path, first, wrong)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"fov": 1.0}, "no --fov with a 360° video"), ({"look": "ahead"}, "no --look with a 360° video"),
     ({"projection": "flat", "heading": "fixed"}, "no --heading with --view flat"),
     ({"projection": "flat", "stereo": "top-bottom"}, "no --stereo with --view flat"),
     ({"stereo": "top-bottom", "method": "synsin"}, "no --method with --stereo top-bottom"),
     ({"projection": "fisheye"}, "equirectangular, flat as projection")],
)  # fmt: skip
def test_what_does_not_go_along_is_refused(pair: Hall, changes, words) -> None:
    pair.refuses(InputError, words, **changes)


def test_players_are_told_that_one_eye_is_above_the_other(tmp_path, images, omnisyn: Omnisyn) -> None:
    """ffmpeg, whose code is not ours, reads the metadata as they are meant."""
    made = omnisyn.quiet(*pair_arguments(tmp_path, images, "out.mp4", "--stereo", "top-bottom"))
    assert "out.mp4: 3 frames of 32x32" in made.out
    spherical = read_spherical(tmp_path / "out.mp4")
    assert (spherical.has_version_1, spherical.has_version_2, spherical.stereo_mode) == (True, True, "top-bottom")
    report = described_by_ffmpeg(tmp_path / "out.mp4")
    assert "top and bottom" in report
    assert "Spherical Mapping: equirectangular" in report


def test_both_eyes_of_a_chain_are_frames_of_twice_the_height(tmp_path: Path, chain: Hall) -> None:
    summary = run_interpolation(chain.plan(stereo="top-bottom", frames=5))
    files = sorted((tmp_path / "out").iterdir())
    assert [(read_header(file).height, read_header(file).width) for file in files] == [(128, 128)] * 5
    assert "eyes" in summary.seconds
