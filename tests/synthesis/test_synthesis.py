"""Frames between two panoramas of a hall with exact depth are what a camera there would see."""

from dataclasses import replace

import numpy as np
import pytest

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.interpolation.api import estimate_depth, make_frames
from omnisyn_cli.pipeline.config import DepthSource, RunConfig
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import Frame, synthesize, turned_panorama
from omnisyn_cli.synthesis.trajectory import HEADINGS, Waypoint, plan_path
from omnisyn_cli.types import DepthEstimate, KnownDepth, View
from synthesis_samples import SIZE, hall_image, hall_view, posed, ws_psnr

BASELINES = {
    "forward": (posed((0, 0, 0.6)), posed((0, 0, -0.6))),
    "sideways": (posed((-0.6, 0, 0)), posed((0.6, 0.0, 0), 0.5)),
    "vertical": (posed((0, -0.6, 0), 2.0), posed((0, 0.6, 0), 2.0)),
    "tilted": (posed((-0.5, -0.3, 0.4), 1.0, 0.2, 0.1), posed((0.4, 0.5, -0.2), 2.0, -0.3, 0.4)),
}


def frames_of(views: list[View], path: list[Waypoint], size: tuple[int, int] = SIZE) -> list[Frame]:
    made = synthesize(views, path, SurfaceMethod(KnownDepth(), SynthesisOptions(size, threads=1)))
    return [Frame(m.image.copy(), m.waypoint, m.panorama) for m in made]


def refuse(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
    raise AssertionError("depth has no effect here and must not be looked for")


@pytest.mark.parametrize("baseline", BASELINES)
def test_every_frame_is_what_a_camera_there_sees(baseline: str) -> None:
    """Far better than a cross-fade; a flipped sign, axis or rotation is worse than one."""
    poses = BASELINES[baseline]
    first, second = (hall_view(pose) for pose in poses)
    for frame in frames_of([first, second], plan_path(poses, 5)):
        truth = hall_image(frame.waypoint.pose)
        t = frame.waypoint.t
        turned = [turned_panorama(v.image, Pose(frame.waypoint.pose.rotation.T @ v.pose.rotation, np.zeros(3)), SIZE, 1)
                  for v in (first, second)]  # fmt: skip
        cross_fade = (1 - t) * turned[0] + t * turned[1]
        assert ws_psnr(frame.image, truth) > 54
        if 0 < t < 1:
            assert ws_psnr(frame.image, truth) > ws_psnr(cross_fade, truth) + 25


def test_the_ends_are_the_photographs_themselves() -> None:
    poses = BASELINES["tilted"]
    views = [hall_view(pose) for pose in poses]
    method = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1))
    made = list(synthesize(views, plan_path(poses, 4), method))
    ends = [m for m in made if m.panorama is not None]
    assert [end.panorama for end in ends] == [0, 1]
    for end, view in zip(ends, views, strict=True):
        assert end.image is view.image


def test_beside_the_ends_nothing_pops_up() -> None:
    poses = BASELINES["sideways"]
    path = [Waypoint(0, t, Pose(poses[0].rotation, (1 - t) * poses[0].position + t * poses[1].position))
            for t in (0.0, 1e-3)]  # fmt: skip
    at, beside = frames_of([hall_view(pose) for pose in poses], path)
    assert np.abs(at.image - beside.image).max() < 0.01


def test_a_chain_shows_every_photograph_and_prepares_every_pair_once() -> None:
    poses = [posed((0, 0, 0.8)), posed((0.1, 0.1, 0), 0.7), posed((0.9, 0, 0), 1.4)]
    views = [hall_view(pose) for pose in poses]
    method, prepared = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1)), []
    made = list(synthesize(views, plan_path(poses, 9), method, on_pair=lambda *told: prepared.append(told)))
    assert [(index, pair.prepared.index) for index, pair in prepared] == [(0, 0), (1, 1)]
    shown = {m.panorama: m.image for m in made if m.panorama is not None}
    assert all(shown[index] is view.image for index, view in enumerate(views))
    assert len(made) == 9


@pytest.mark.parametrize("heading", HEADINGS)
def test_the_picture_looks_where_the_waypoint_says(heading: str) -> None:
    poses = BASELINES["tilted"]
    for frame in frames_of([hall_view(pose) for pose in poses], plan_path(poses, 3, heading=heading)):
        assert ws_psnr(frame.image, hall_image(frame.waypoint.pose)) > 54


@pytest.mark.parametrize(("columns", "tolerance"), [(8, 5e-5), (40, 5e-5), (1, 3e-3), (13, 3e-3)])
def test_rolling_both_inputs_rolls_the_output(columns: int, tolerance: float) -> None:
    """A camera turned left by k columns sees the same k columns to the right, but for rounding of blocks of quads."""
    poses = BASELINES["sideways"]
    turn = rotation_from_heading(columns * 2 * np.pi / SIZE[1]).T
    views = [hall_view(pose) for pose in poses]
    turned_poses = [Pose(pose.rotation @ turn, pose.position) for pose in poses]
    turned_views = [View(np.roll(v.image, columns, axis=1), pose, None, _rolled(v.known_depth, columns))
                    for v, pose in zip(views, turned_poses, strict=True)]  # fmt: skip
    for plain, turned in zip(
        frames_of(views, plan_path(poses, 5)), frames_of(turned_views, plan_path(turned_poses, 5)), strict=True
    ):
        np.testing.assert_allclose(turned.image, np.roll(plain.image, columns, axis=1), atol=tolerance)


def _rolled(depth: DepthEstimate | None, columns: int) -> DepthEstimate:
    return DepthEstimate(np.roll(depth.inverse_depth, columns, axis=1), depth.confidence)


def test_from_one_place_it_is_a_turn_and_a_cross_fade_without_depth() -> None:
    poses = (posed((1, 0, 0), 0.0), posed((1, 0, 0), 1.0))
    elsewhere = np.array([-1.0, 0.3, 0.5])
    first = View(hall_image(poses[0]), poses[0])
    second = View(hall_image(Pose(poses[1].rotation, elsewhere)), poses[1])  # other things at the same place
    path = plan_path(poses, 5)
    made = synthesize([first, second], path, SurfaceMethod(refuse, SynthesisOptions(SIZE, threads=1)))
    for frame in [Frame(m.image.copy(), m.waypoint, None) for m in made]:
        seen = hall_image(frame.waypoint.pose), hall_image(Pose(frame.waypoint.pose.rotation, elsewhere))
        t = frame.waypoint.t
        np.testing.assert_allclose(frame.image, (1 - t) * seen[0] + t * seen[1], atol=0.02)


def garbled(view: View, hole: np.ndarray) -> View:
    """Absurd colours where the mask forbids to look."""
    image = view.image.copy()
    image[hole] = (9, 0, 9)
    return View(image, view.pose, ~hole, view.known_depth)


def test_what_one_mask_forbids_comes_from_the_other_view_at_any_time() -> None:
    poses = BASELINES["forward"]
    first, second = (hall_view(pose) for pose in poses)
    hole = np.zeros(SIZE, bool)
    hole[16:32, 40:60] = True
    hole[40:52, :8] = hole[40:52, -8:] = True
    for t in (0.0, 0.01, 0.5, 1.0):
        at = Pose(poses[0].rotation, (1 - t) * poses[0].position + t * poses[1].position)
        for views, time in (([garbled(first, hole), second], t), ([first, garbled(second, hole)], t)):
            (frame,) = frames_of(views, [Waypoint(0, time, at)])
            assert np.abs(frame.image - hall_image(at)).max() < 0.1
            assert ws_psnr(frame.image, hall_image(at)) > 50


def test_what_a_mask_forbids_does_not_come_back_where_photographs_are_cross_faded() -> None:
    poses = BASELINES["sideways"]
    hole = np.zeros(SIZE, bool)
    hole[20:36, 56:72] = True
    wrong = DepthEstimate(np.full(SIZE, 1.2, np.float32), np.ones(SIZE, np.float32))
    views = [replace(garbled(hall_view(pose), hole), known_depth=wrong) for pose in poses]
    options = SynthesisOptions(SIZE, threads=1, faded_below=19.2)
    pair = SurfaceMethod(KnownDepth(), options).prepare(0, views)
    assert pair.prepared.cross_fade is not None
    assert pair.frame(plan_path(poses, 3)[1]).image.max() < 1.2


def test_what_nobody_saw_is_filled_with_what_is_around() -> None:
    poses = BASELINES["forward"]
    hole = np.zeros(SIZE, bool)
    hole[20:36, 56:72] = True
    views = [garbled(hall_view(pose), hole) for pose in poses]
    for frame in frames_of(views, plan_path(poses, 3)):
        assert np.isfinite(frame.image).all()
        assert 0 <= frame.image.min() <= frame.image.max() < 1.2
        assert frame.panorama is None
    blind = [garbled(hall_view(pose), np.ones(SIZE, bool)) for pose in poses]
    for frame in frames_of(blind, plan_path(poses, 3)):
        np.testing.assert_array_equal(frame.image, 0)


@pytest.mark.parametrize(
    ("source", "target"), [((128, 256), (64, 128)), ((64, 128), (128, 256)), ((64, 128), (54, 108))]
)
def test_sizes_of_source_and_target_are_independent(source: tuple[int, int], target: tuple[int, int]) -> None:
    poses = BASELINES["tilted"]
    for frame in frames_of([hall_view(pose, source) for pose in poses], plan_path(poses, 3), target):
        assert frame.image.shape == (*target, 3)
        assert frame.panorama is None
        assert ws_psnr(frame.image, hall_image(frame.waypoint.pose, target)) > 38


def test_depth_may_be_coarser_than_the_photograph() -> None:
    poses = BASELINES["forward"]
    views = [View(hall_image(pose), pose, None, hall_view(pose, (32, 64)).known_depth) for pose in poses]
    middle = frames_of(views, plan_path(poses, 3))[1]
    assert ws_psnr(middle.image, hall_image(middle.waypoint.pose)) > 38


def test_a_turned_panorama_is_a_roll_and_an_unturned_one_itself() -> None:
    image = np.random.default_rng(0).random((*SIZE, 3), np.float32)
    unturned = turned_panorama(image, Pose(np.eye(3), np.zeros(3)), SIZE, 1)
    np.testing.assert_allclose(unturned, image, atol=1e-3)
    quarter = Pose(rotation_from_heading(np.pi / 2), np.zeros(3))
    np.testing.assert_allclose(
        turned_panorama(image, quarter, SIZE, 1), np.roll(image, SIZE[1] // 4, axis=1), atol=1e-3
    )


def test_known_depth_wants_to_be_known() -> None:
    view = hall_view(posed((0, 0, 0)))
    with pytest.raises(ValueError, match="known depth"):
        KnownDepth()(view, View(view.image, view.pose))


def test_the_clock_counts_every_stage() -> None:
    poses, clock = BASELINES["forward"], Stopwatch()
    views = [hall_view(pose) for pose in poses]
    method = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1), clock=clock)
    list(synthesize(views, plan_path(poses, 3), method))
    assert set(clock.seconds) == {"depth", "check", "mesh", "render", "fuse"}
    assert all(seconds >= 0 for seconds in clock.seconds.values())


@pytest.mark.parametrize("rounded", [False, True])
def test_frames_made_at_once_are_the_very_same_in_their_order(rounded: bool) -> None:
    """Also where a slow walk shows frames again, and where an end is masked, so that it is no photograph."""
    poses, hole = [*BASELINES["tilted"], posed((2.0, 0.5, -0.2), 2.0)], np.zeros(SIZE, bool)
    hole[40:50, 10:30] = True
    views = [garbled(hall_view(poses[0]), hole), *(hall_view(pose) for pose in poses[1:])]
    path = plan_path(poses, 40, ease="smooth")
    slow = [replace(path[20], t=path[20].t + step * 1e-4) for step in range(3)]
    path, made = [*path[:20], *slow, *path[21:]], []
    for threads in (1, 2, 3):
        options = SynthesisOptions(SIZE, threads=threads, confidence=True)
        out = (lambda: np.empty((*SIZE, 3), np.uint8)) if rounded else None
        frames = synthesize(views, path, SurfaceMethod(KnownDepth(), options), out)
        made.append([(m.image.copy(), m.confidence, m.waypoint, m.is_shown_again) for m in frames])
    assert [waypoint for _, _, waypoint, _ in made[0]] == path
    assert sum(again for *_, again in made[0]) >= 2
    for one, *others in zip(*made, strict=True):
        for other in others:
            assert one[2:] == other[2:]
            np.testing.assert_array_equal(one[0], other[0])
            np.testing.assert_array_equal(one[1], other[1])


def test_an_error_in_one_of_the_frames_made_at_once_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MemoryError("none left")

    monkeypatch.setattr(GeometricFuser, "blend", fail)
    poses = BASELINES["forward"]
    method = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=3))
    with pytest.raises(MemoryError, match="none left"):
        list(synthesize([hall_view(pose) for pose in poses], plan_path(poses, 9), method))


def test_another_fuser_may_be_plugged_in() -> None:
    poses = BASELINES["forward"]
    views = [hall_view(pose) for pose in poses]

    def only_second(first: object, second: object, t: float) -> np.ndarray:
        return np.full((*SIZE, 3), np.float32(t))

    method = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1), only_second)
    made = synthesize(views, plan_path(poses, 3), method)
    assert (next(m for m in made if m.waypoint.t == 0.5).image == 0.5).all()


MATCHING = RunConfig(DepthSource("matching", rows=64))


def views(distance: float) -> tuple[View, View]:
    """Two turned panoramas of the hall; their pictures are those of one position."""
    first, second = hall_view(posed((0.0, 0.0, 0.0))), hall_view(posed((0.0, 0.0, 0.0), 0.4))
    apart = replace(second.pose, position=np.array([0.0, 0.0, distance]))
    return replace(first, known_depth=None), replace(second, pose=apart, known_depth=None)


@pytest.mark.parametrize("distance", [0.0, 1e-9, 9e-7])
def test_there_is_no_depth_without_parallax(distance: float) -> None:
    for estimate in estimate_depth(*views(distance), MATCHING, threads=1):
        assert not estimate.inverse_depth.any()
        assert not estimate.confidence.any()


def test_frames_are_those_of_one_position() -> None:
    same, close = (
        list(make_frames(views(distance), 3, MATCHING, size=(32, 64), threads=1)) for distance in (0.0, 1e-9)
    )
    np.testing.assert_allclose(close, same, atol=1e-6)
