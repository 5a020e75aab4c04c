"""Depth, baselines, turns, masks, samples and sizes at their extremes, from two panoramas to finished frames."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from interpolation_samples import job_of, listing
from omnisyn_cli.errors import ImageError
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_inverse_depth, read_panorama, write_depth
from omnisyn_cli.io.encode import write_channels
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.rasterize import rasterize
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import DepthEstimate, KnownDepth, View
from process_limits import memory_taken
from synthesis_samples import RADIUS, SIZE, distance_to_wall, hall_image, hall_view, posed, write_hall, ws_psnr

PAIR = (posed((-0.5, -0.1, 0.4), 0.3), posed((0.4, 0.2, -0.3), 0.9))


def frames(views: list[View], count: int = 5, size: tuple[int, int] = SIZE) -> list[np.ndarray]:
    path = plan_path([view.pose for view in views], count)
    method = SurfaceMethod(KnownDepth(), SynthesisOptions(size, threads=1))
    return [frame.image.copy() for frame in synthesize(views, path, method)]


def scaled(view: View, factor: float) -> View:
    depth = DepthEstimate((view.known_depth.inverse_depth / factor).astype(np.float32), view.known_depth.confidence)
    return View(view.image, Pose(view.pose.rotation, view.pose.position * factor), view.mask, depth)


def with_depth(view: View, inverse_depth: np.ndarray) -> View:
    depth = DepthEstimate(inverse_depth.astype(np.float32), np.ones(inverse_depth.shape, np.float32))
    return View(view.image, view.pose, view.mask, depth)


@pytest.mark.parametrize("baseline", [1e-6, 1e-3, 1e3, 1e6])
def test_only_the_ratio_of_depth_and_baseline_counts(baseline: float) -> None:
    """A world of any size looks the same: 1e-6 m and 1e3 m between the panoramas are 1 m in other units."""
    factor = baseline / float(np.linalg.norm(PAIR[1].position - PAIR[0].position))
    views = [hall_view(pose) for pose in PAIR]
    for plain, other in zip(frames(views), frames([scaled(view, factor) for view in views]), strict=True):
        np.testing.assert_allclose(other, plain, atol=2e-3)
        assert ws_psnr(other, plain) > 80


@pytest.mark.parametrize("baseline", [0.0, 1e-6])
def test_a_baseline_of_nothing_or_a_micrometre_shows_the_photographs(baseline: float) -> None:
    """In a hall of metres nothing moves by more than rounding."""
    views = [hall_view(posed((x, 0, 0))) for x in (0.0, baseline)]
    for frame in frames(views):
        assert ws_psnr(frame, views[0].image) > 60


def test_a_baseline_of_a_kilometre_in_a_room_gives_finite_pictures() -> None:
    """The way leads through walls, and from each end nothing of the other is near."""
    views = [with_depth(hall_view(posed((0, 0, 0))), 1 / distance_to_wall(posed((0, 0, 0)), SIZE))] * 2
    moved = View(views[1].image, posed((1e3, 0, 0)), None, views[1].known_depth)
    for frame in frames([views[0], moved], 7):
        assert np.isfinite(frame).all()
        assert 0 <= frame.min() <= frame.max() <= 1.0


def test_depths_from_a_millimetre_to_a_thousand_kilometres_in_one_picture() -> None:
    """Sky among them: inverse depth stays exact, but for rows at the poles, where a ray may meet the cap beside it."""
    rng = np.random.default_rng(0)
    rho = 10.0 ** rng.uniform(-6, 3, SIZE)
    rho[rng.random(SIZE) < 0.1] = 0.0
    rho = rho.astype(np.float32)
    there = rasterize(build_mesh(rho), Pose.identity(), SIZE)
    assert there.visibility.all()
    np.testing.assert_allclose(there.inverse_depth[1:-1], rho[1:-1], rtol=1e-5)
    assert there.inverse_depth.max() <= rho.max() * (1 + 1e-5)
    for distance in (1e-6, 1e-3, 1.0, 1e3, 1e6):
        found = rasterize(build_mesh(rho), Pose(np.eye(3), np.array([0.6, 0.64, -0.48]) * distance), SIZE)
        assert np.isfinite(found.inverse_depth).all()
        assert (found.inverse_depth[found.visibility] >= 0).all()
    views = [with_depth(hall_view(pose), rho) for pose in PAIR]
    for frame in frames(views):
        assert np.isfinite(frame).all()
        assert 0 <= frame.min() <= frame.max() <= 1.0


def test_depth_files_of_every_kind_of_number(tmp_path: Path) -> None:
    """1e-3 to 1e6 m come back to a rounding, 0 and infinity are nothing, what is undefined or negative is counted."""
    depth = np.geomspace(1e-3, 1e6, 128, dtype=np.float32).reshape(8, 16)
    depth[0, 0], depth[0, 1] = 0.0, np.inf
    write_channels(tmp_path / "a.exr", depth, ("Z",), tmp_path / "a.exr")
    inverse = read_inverse_depth(tmp_path / "a.exr")
    assert (inverse[0, :2] == 0).all()
    np.testing.assert_allclose(inverse.ravel()[2:], 1 / depth.ravel()[2:].astype(float), rtol=1e-6)
    depth[2, 3], depth[4, 5:7] = np.nan, -1.0
    write_channels(tmp_path / "b.exr", depth, ("Z",), tmp_path / "b.exr")
    with pytest.raises(ImageError, match="1 NaN and 2 negative of 128"):
        read_inverse_depth(tmp_path / "b.exr")
    write_depth(tmp_path / "c.exr", np.full((8, 16), 1e-30, np.float32))
    assert np.isfinite(read_inverse_depth(tmp_path / "c.exr")).all()


@pytest.mark.parametrize("turn", [math.pi, math.pi - 1e-9, -math.pi + 1e-6])
def test_half_a_turn_between_the_panoramas(turn: float) -> None:
    poses = (posed((-0.4, 0, 0.2), 0.0), posed((0.4, 0, -0.2), turn))
    path = plan_path(poses, 5)
    views = [hall_view(pose) for pose in poses]
    for waypoint, frame in zip(path, frames(views), strict=True):
        np.testing.assert_allclose(np.linalg.det(waypoint.pose.rotation), 1, atol=1e-9)
        assert ws_psnr(frame, hall_image(waypoint.pose)) > 50
    turns = [np.trace(a.pose.rotation.T @ b.pose.rotation) for a, b in pairwise(path)]
    np.testing.assert_allclose(turns, turns[0], atol=1e-6)  # at constant speed, no jump


def test_cameras_upside_down_to_each_other() -> None:
    poses = (posed((-0.4, 0, 0.2)), posed((0.4, 0, -0.2), 0.0, 0.0, math.pi))
    path = plan_path(poses, 5)
    for waypoint, frame in zip(path, frames([hall_view(pose) for pose in poses]), strict=True):
        assert ws_psnr(frame, hall_image(waypoint.pose)) > 50


def test_a_way_through_a_wall() -> None:
    """The camera leaves one ball and enters another: pictures are finite on the wall too, and right at both ends."""
    first, second = hall_view(posed((0, 0, 0))), hall_view(posed((0, 0, 0)))
    beyond = View(second.image, posed((2 * RADIUS, 0, 0)), None, second.known_depth)
    made = frames([first, beyond], 9)
    assert all(np.isfinite(frame).all() and frame.min() >= 0 and frame.max() <= 1 for frame in made)
    assert ws_psnr(made[0], first.image) > 60
    assert ws_psnr(made[-1], second.image) > 60


def test_nothing_but_sky() -> None:
    """Directions are all that counts: every frame is the photograph, whatever the way."""
    views = [with_depth(View(hall_image(posed((0, 0, 0))), posed((x, 0, 0))), np.zeros(SIZE)) for x in (-50.0, 50.0)]
    for frame in frames(views):
        assert ws_psnr(frame, views[0].image) > 60


def test_nothing_usable_in_either_panorama() -> None:
    mask = np.zeros(SIZE, bool)
    for frame in frames([hall_view(pose, mask=mask) for pose in PAIR]):
        assert np.isfinite(frame).all()
        assert 0 <= frame.min() <= frame.max() <= 1


@pytest.mark.parametrize("peak", [1.0, 8.0, 60_000.0])
def test_values_above_one_pass(peak: float) -> None:
    """High dynamic range: the frames of a brighter world are brighter by the same factor."""
    views = [hall_view(pose) for pose in PAIR]
    bright = [View(view.image * np.float32(peak), view.pose, None, view.known_depth) for view in views]
    for plain, frame in zip(frames(views), frames(bright), strict=True):
        assert np.isfinite(frame).all()
        assert ws_psnr(frame / np.float32(peak), plain) > 50
        assert frame.max() > 0.85 * peak


@pytest.mark.parametrize(
    ("source", "target"), [((4, 8), (4, 8)), ((4, 8), (64, 128)), ((63, 126), (33, 66)), ((2, 4), (2, 4))]
)
def test_tiny_and_odd_sizes(source: tuple[int, int], target: tuple[int, int]) -> None:
    for frame in frames([hall_view(pose, source) for pose in PAIR], 5, target):
        assert frame.shape == (*target, 3)
        assert np.isfinite(frame).all()
        assert 0 <= frame.min() <= frame.max() <= 1.1  # bicubic textures overshoot a little; samples are clipped later


def run(folder: Path, images: list[Path], output: str, **options: object) -> list[np.ndarray]:
    """Frames of an interpolation as files, read again."""
    run_interpolation(plan_interpolation(job_of(folder, images, output=folder / output, **{"frames": 5, **options})))
    return [read_panorama(file).image for file in sorted((folder / output).iterdir())]


def test_eight_by_four_pixels_from_files_to_a_video(tmp_path: Path) -> None:
    images = write_hall(tmp_path, PAIR, (4, 8))
    for depth in ("file", "matching"):
        assert [frame.shape for frame in run(tmp_path, images, depth, depth=depth, threads=1)] == [(4, 8, 3)] * 5
    run_interpolation(plan_interpolation(job_of(tmp_path, images, output=tmp_path / "out.mp4")))
    assert (tmp_path / "out.mp4").stat().st_size > 0


@pytest.mark.parametrize(("name", "size", "depth"), [("frames", (32, 64), "matching"), ("a.mp4", (64, 128), "file")])
def test_equal_runs_make_equal_bytes_at_any_number_of_threads(tmp_path, name, size, depth) -> None:
    images = write_hall(tmp_path, PAIR, size)
    made = []
    for threads in (1, 2, 5):
        folder = tmp_path / f"{threads}"
        folder.mkdir()
        options = {"frames": 20, "depth": depth, "threads": threads, "save_depth": folder / "depth"}
        run_interpolation(plan_interpolation(job_of(tmp_path, images, output=folder / name, **options)))
        made.append(listing(folder))
    assert len(made[0]) == (20 if name == "frames" else 1) + 2
    assert made[0] == made[1] == made[2]


YAW_SIZE = (64, 128)
YAW_PAIR = (posed((-0.4, 0, 0)), posed((0.4, 0, 0)))


def matched_frames(folder: Path, poses: Sequence[Pose]) -> list[np.ndarray]:
    images = write_hall(folder, poses, YAW_SIZE, with_depth=False)
    return run(folder, images, "out", depth="matching", frames=4, threads=1)


@pytest.fixture(scope="module")
def straight_frames(tmp_path_factory: pytest.TempPathFactory) -> list[np.ndarray]:
    """Of panoramas that nobody has turned."""
    return matched_frames(tmp_path_factory.mktemp("straight"), YAW_PAIR)


@pytest.mark.parametrize("columns", [1, 7, 32, 64])
def test_turning_both_panoramas_turns_the_video(tmp_path, straight_frames, columns) -> None:
    """The whole pipeline, depth by matching: rolled inputs give rolled frames that are as good within 0.1 dB."""
    turn = rotation_from_heading(columns * 2 * np.pi / YAW_SIZE[1]).T
    turned_frames = matched_frames(tmp_path, [Pose(pose.rotation @ turn, pose.position) for pose in YAW_PAIR])
    for waypoint, plain, turned in zip(plan_path(YAW_PAIR, 4), straight_frames, turned_frames, strict=True):
        truth = hall_image(waypoint.pose, YAW_SIZE)
        back = np.roll(turned, -columns, axis=1)
        assert abs(ws_psnr(back, truth) - ws_psnr(plain, truth)) < 0.1
        assert ws_psnr(back, plain) > 40


@pytest.mark.slow
def test_sixteen_thousand_columns(tmp_path: Path) -> None:
    """16384×8192 from panoramas of 1024×512: within the memory that the plan says."""
    images = write_hall(tmp_path, PAIR, (512, 1024))
    plan = plan_interpolation(job_of(tmp_path, images, size=(8192, 16384), codec="jpg", threads=None))
    used = memory_taken(run_interpolation, plan)
    print(f"planned {plan.memory / 2**30:.2f} GiB, used {used / 2**30:.2f} GiB")
    assert used < 1.25 * plan.memory
    middle = read_panorama(tmp_path / "out" / "000001.jpg").image[::16, ::16]
    assert middle.shape == (512, 1024, 3)
    rows = np.arange(0, 8192, 16) + 0.5
    directions = pixel_directions(8192, 2)[np.arange(0, 8192, 16), 0]
    np.testing.assert_allclose(np.arccos(directions[:, 1]), rows / 8192 * np.pi, atol=1e-6)
    assert middle.std() > 0.1
