"""A common smooth surface for doubtful pairs; frames shown again, rounded, or of simplified surfaces."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from confidence_samples import generated_views
from interpolation_samples import job_of
from omnisyn_cli.fusion.photometry import ExposureMatcher
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.interpolation.plan import plan_interpolation, with_preset
from omnisyn_cli.io.images import outside_nadir
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.synthesis import frame
from omnisyn_cli.synthesis.consistency import cross_check
from omnisyn_cli.synthesis.ground import continue_ground
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import CrossFade, SynthesisOptions
from omnisyn_cli.synthesis.soft_surface import is_enclosed, reliabilities, soften_pair
from omnisyn_cli.synthesis.synthesize import Frame, synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint, plan_path
from omnisyn_cli.types import DepthEstimate, KnownDepth, Layer, View
from synthesis_samples import as_bytes, hall_view, posed, write_hall

SIZE = (128, 256)


@pytest.fixture(scope="module")
def room() -> tuple[View, View]:
    first, _, last = generated_views("room", 104, 1.0, SIZE)
    return first, last


def with_noise(depth: DepthEstimate, seed: int) -> DepthEstimate:
    """Depth that is wrong by factors of up to e in patches of the lower half; its confidence is low there."""
    rng = np.random.default_rng(seed)
    factor = np.exp(rng.uniform(-1.0, 1.0, (SIZE[0] // 8, SIZE[1] // 8))).repeat(8, 0).repeat(8, 1)
    factor[: SIZE[0] // 2] = 1.0
    confidence = np.where(factor == 1.0, depth.confidence, 0.1).astype(np.float32)
    return replace(depth, inverse_depth=(depth.inverse_depth * factor).astype(np.float32), confidence=confidence)


def step_share(depth: DepthEstimate, rows: slice) -> float:
    """Share of neighbours in a row whose inverse depth differs by more than a mesh bears."""
    rho = depth.inverse_depth[rows]
    return float((np.abs(np.diff(rho, axis=1)) > 0.05 * np.maximum(rho[:, 1:], rho[:, :-1])).mean())


def test_torn_depth_becomes_one_smooth_surface_for_both_views_and_confirmed_depth_stays(room) -> None:
    true = KnownDepth()(*room)
    torn = with_noise(true[0], 1), with_noise(true[1], 2)
    soft = soften_pair(room, torn, reliabilities(torn, cross_check(room, torn, Cut())))
    low, high = slice(SIZE[0] * 5 // 8, SIZE[0] * 15 // 16), slice(SIZE[0] // 4, SIZE[0] * 3 // 8)
    for before, after, right in zip(torn, soft, true, strict=True):
        assert step_share(before, low) > 0.05
        assert step_share(after, low) < 0.2 * step_share(before, low)
        kept = np.abs(after.inverse_depth[high] - right.inverse_depth[high])
        assert np.median(kept / np.maximum(right.inverse_depth[high], 1e-3)) < 0.05
    # a point of the one surface lies on the other one too
    first, second = room
    points = pixel_directions(*SIZE)[low] / np.maximum(soft[0].inverse_depth[low], 1e-3)[..., None]
    seen = (points @ first.pose.rotation.T + first.pose.position - second.pose.position) @ second.pose.rotation
    distance = np.linalg.norm(seen, axis=-1)
    other = sample_bilinear(soft[1].inverse_depth[..., None], seen / distance[..., None])[..., 0]
    assert np.median(np.abs(other * distance - 1.0)) < 0.1


def in_a_box(pose: Pose) -> tuple[View, DepthEstimate]:
    """A grey room of 6×3×8 metres, as unreliable depth; every fifth pixel is twice as near as its wall."""
    rays = pixel_directions(*SIZE)
    sides = np.array([3.0, 1.5, 4.0])
    near, far = sides + pose.position, sides - pose.position
    is_thing = np.random.default_rng(3).random(SIZE) < 0.2
    inverse_depth = np.where(is_thing, 2.0, 1.0) * np.maximum(-rays / near, rays / far).max(axis=-1)
    depth = DepthEstimate(inverse_depth.astype(np.float32), np.full(SIZE, 0.1, np.float32))
    return View(np.full((*SIZE, 3), 0.5, np.float32), pose), depth


def test_walls_that_nobody_confirms_stay_flat_in_spite_of_what_stands_before_them() -> None:
    boxes = in_a_box(posed((0.0, 0.0, 0.7))), in_a_box(posed((0.0, 0.0, -0.7)))
    views, depths = (boxes[0][0], boxes[1][0]), (boxes[0][1], boxes[1][1])
    soft = soften_pair(views, depths, reliabilities(depths, cross_check(views, depths, Cut())))
    for after in soft:
        rays = pixel_directions(*SIZE)
        floor = rays[..., 1] < -0.8
        error = np.log(after.inverse_depth * 1.5 / -rays[..., 1], where=floor, out=np.zeros(SIZE))[floor]
        assert np.abs(error).max() < 0.03
        assert error.std() < 0.01


@pytest.mark.parametrize(("kind", "expected"), [("room", True), ("street", False)])
def test_a_room_is_enclosed_and_a_street_is_not(kind: str, expected: bool) -> None:
    first, _, last = generated_views(kind, 104, 1.0, SIZE)
    depths = KnownDepth()(first, last)
    known = reliabilities(depths, cross_check((first, last), depths, Cut()))
    assert is_enclosed((first, last), depths, known) == expected
    noise = np.random.default_rng(0).random(last.image.shape, np.float32)
    other = replace(last, image=noise)  # near, but not confirmed: the sky of a pair that fails
    unknown = reliabilities(depths, cross_check((first, other), depths, Cut()))
    assert not is_enclosed((first, other), depths, unknown)


HEIGHT = 1.6


def on_a_floor(pose: Pose, brightness: float = 1.0) -> tuple[View, DepthEstimate]:
    """A tiled floor without end under a grey sky."""
    world = pixel_directions(*SIZE) @ pose.rotation.T
    rho = np.maximum(-world[..., 1], 0.0) / HEIGHT
    x, z = (world[..., k] / np.maximum(rho, 1e-3) + pose.position[k] for k in (0, 2))
    tiles = 0.5 + 0.2 * np.sign(np.sin(5.0 * x) * np.sin(5.0 * z)) * np.clip(6.0 * rho - 0.4, 0.0, 1.0)
    image = np.where(rho > 0.0, brightness * tiles, 0.7)[..., None] * np.ones(3)
    return View(image.astype(np.float32), pose), DepthEstimate(rho.astype(np.float32), np.ones(SIZE, np.float32))


def capped(view: View, degrees: float) -> View:
    mask = outside_nadir(SIZE, np.radians(degrees))
    return replace(view, image=np.where(mask[..., None], view.image, np.float32(1.0)), mask=mask, shows_masked=True)


@pytest.mark.parametrize("brightness", [1.0, 0.7])
@pytest.mark.parametrize("heading", [0.0, 1.0])
def test_the_other_panorama_fills_what_it_sees_in_the_exposure_of_the_ground_around(brightness, heading) -> None:
    (first, a), (second, b) = on_a_floor(posed((0, 0, 0))), on_a_floor(posed((1.5, 0, 0.5), heading), brightness)
    views, depths = continue_ground((capped(first, 25.0), second), (a, b))
    gap = ~outside_nadir(SIZE, np.radians(25.0))
    assert np.abs(views[0].image - first.image)[gap].mean() < 0.08
    assert views[0].mask is None
    assert (views[1], depths[1]) == (second, b)
    np.testing.assert_allclose(depths[0].inverse_depth[gap], a.inverse_depth[gap], rtol=0.05)
    assert depths[0].confidence[gap].max() < 0.1 < depths[0].confidence[~gap].min()


def test_light_that_changes_across_the_gap_goes_on_in_it() -> None:
    (first, a), (second, b) = on_a_floor(posed((0, 0, 0))), on_a_floor(posed((1.5, 0, 0.5)))
    light = 1.0 + 0.3 * pixel_directions(*SIZE)[..., :1] / np.maximum(-pixel_directions(*SIZE)[..., 1:2], 0.4)
    first = replace(first, image=(first.image * light).astype(np.float32))
    views, _ = continue_ground((capped(first, 25.0), second), (a, b))
    gap = ~outside_nadir(SIZE, np.radians(25.0))
    step = (views[0].image - first.image)[gap]
    side = pixel_directions(*SIZE)[gap, 0] > 0
    assert abs(step[side].mean() - step[~side].mean()) < 0.03
    assert np.abs(step).mean() < 0.08


def test_what_the_other_panorama_is_not_sure_of_comes_from_a_patch() -> None:
    """Here it shows furniture at the depth of the floor."""
    (first, a), (second, b) = on_a_floor(posed((0, 0, 0))), on_a_floor(posed((1.5, 0, 0.5)))
    towards = pixel_directions(*SIZE) @ np.array([-1.5, -HEIGHT, -0.5]) / np.linalg.norm([1.5, HEIGHT, 0.5])
    furniture = np.where(towards[..., None] > 0.97, np.float32([0.9, 0.1, 0.1]), second.image)
    soft = replace(b, confidence=np.full(SIZE, 0.15, np.float32))
    views, _ = continue_ground((capped(first, 20.0), replace(second, image=furniture)), (a, soft))
    gap = ~outside_nadir(SIZE, np.radians(18.0))
    assert np.ptp(views[0].image[gap], axis=-1).max() < 0.05


def test_a_patch_fills_what_nobody_sees_with_the_same_pattern() -> None:
    (first, a), (second, b) = on_a_floor(posed((0, 0, 0))), on_a_floor(posed((30.0, 0, 0)))
    views, _ = continue_ground((capped(first, 20.0), second), (a, b))
    gap = ~outside_nadir(SIZE, np.radians(18.0))
    filled, truth = views[0].image[gap], first.image[gap]
    assert filled.std() > 0.7 * truth.std()
    assert np.abs(filled - truth).mean() < 0.1


def test_without_a_mask_below_or_without_a_ground_nothing_changes() -> None:
    pair = [on_a_floor(posed(place)) for place in ((0, 0, 0), (1.5, 0, 0))]
    views, depths = (pair[0][0], pair[1][0]), (pair[0][1], pair[1][1])
    above = replace(views[0], mask=np.arange(SIZE[0])[:, None] + np.zeros(SIZE, int) > 20)
    for kept in (views, (above, views[1])):
        found, same = continue_ground(kept, depths)
        assert all(a is b for a, b in zip((*found, *same), (*kept, *depths), strict=True))
    noise = DepthEstimate(np.exp(np.random.default_rng(0).normal(0, 2, SIZE)).astype(np.float32), depths[0].confidence)
    masked = capped(views[0], 20.0)
    assert continue_ground((masked, views[1]), (noise, depths[1]))[0][0] is masked


LARGE = (1024, 2048)
POSES = [posed((0, 0, 0.5)), posed((0.3, 0.1, -0.4), 0.2)]


def views(*, as_samples: bool) -> list[View]:
    """A hall painted in steps of 1/255; the second view is half a stop darker than the first."""
    made = []
    for index, pose in enumerate(POSES):
        view = hall_view(pose, (128, 256))
        samples = as_bytes(view.image * (1.0, 0.85)[index])
        image = np.float32(samples / np.float32(255))
        made.append(View(image, pose, None, view.known_depth, image_uint8=samples if as_samples else None))
    return made


def frames(shown: list[View], ring: list[np.ndarray] | None) -> list[np.ndarray]:
    memory = None if ring is None else iter(ring).__next__
    path, options = plan_path(POSES, 4, heading="first"), SynthesisOptions(LARGE, threads=2)
    return [each.image.copy() for each in synthesize(shown, path, SurfaceMethod(KnownDepth(), options), memory)]


@pytest.mark.parametrize("as_samples", [False, True])
def test_rounding_early_changes_a_sample_by_one_at_most(as_samples: bool) -> None:
    """Photographs turned and enlarged, and frames between, of numbers as of samples."""
    ring = [np.empty((*LARGE, 3), np.uint8) for _ in range(4)]
    rounded, exact = frames(views(as_samples=as_samples), ring), frames(views(as_samples=False), None)
    assert [frame.dtype for frame in rounded] == [np.uint8] * 4
    for found, numbers in zip(rounded, exact, strict=True):
        difference = np.abs(found.astype(int) - as_bytes(numbers))
        assert difference.max() <= 1
        assert (difference > 0).mean() < 0.02


def test_photographs_are_cross_faded_into_samples_as_into_numbers() -> None:
    """Where confidence is low, gradually around there, and nowhere else."""
    rng, size = np.random.default_rng(0), (64, 128)
    fade = CrossFade([rng.random((32, 64, 3), np.float32) for _ in POSES], POSES, size, threads=2)
    samples, confidence = rng.integers(0, 256, (*size, 3), np.uint8), np.ones(size, np.float32)
    confidence[20:45, 100:] = 0.0
    numbers, before = np.float32(samples / 255), samples.copy()
    for image in (samples, numbers):
        fade(image, confidence, POSES[0], 0.3)
    np.testing.assert_array_equal(samples, as_bytes(numbers))
    changed = (samples != before).any(axis=-1)
    assert changed[25:40, 106:122].mean() > 0.9
    assert not changed[:, 30:80].any()


SMALL = (64, 128)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The places on the way that renderings are fused for, in order."""
    found: list[float] = []

    class Counted(ExposureMatcher):
        def __call__(self, first: Layer, second: Layer, t: float) -> tuple[Layer, Layer]:
            found.append(t)
            return super().__call__(first, second, t)

    monkeypatch.setattr(frame, "ExposureMatcher", Counted)
    return found


def hall_frames(
    shares: list[float], *, turn: float = 0.0, mask: np.ndarray | None = None, **options: object
) -> list[Frame]:
    """Of a way of one metre in a hall of four."""
    views = [hall_view(posed([0.0, 0.0, z]), SMALL, mask) for z in (0.5, -0.5)]
    path = [Waypoint(0, t, posed([0.0, 0.0, 0.5 - t], k * turn)) for k, t in enumerate(shares)]
    return list(synthesize(views, path, SurfaceMethod(KnownDepth(), SynthesisOptions(SMALL, threads=1, **options))))


def test_a_step_of_less_than_a_quarter_of_a_pixel_is_not_rendered(made: list[float]) -> None:
    """The nearest wall is 3.5 m away: a quarter of a pixel, 0.0123 rad, is 4 cm; 1 mm is much less, 10 cm is more."""
    shown = hall_frames([0.5, 0.501, 0.6])
    assert made == [0.5, 0.6]
    assert [frame.waypoint.t for frame in shown] == [0.5, 0.501, 0.6]
    assert [frame.is_shown_again for frame in shown] == [False, True, False]


def test_small_steps_add_up(made: list[float]) -> None:
    """Each is compared with the frame that was rendered, not with the one before."""
    hall_frames([0.5 + 0.001 * k for k in range(6)])
    assert len(made) == 3  # 1/512 of the way is passed after every second step


def test_a_turn_of_more_than_a_quarter_of_a_pixel_is_rendered(made: list[float]) -> None:
    hall_frames([0.5, 0.5], turn=0.0002)
    assert len(made) == 1
    hall_frames([0.5, 0.5], turn=0.02)
    assert len(made) == 1 + 2


def test_triangles_are_counted_and_the_switch_draws_them_all() -> None:
    views = [hall_view(posed([0.0, 0.0, z]), SMALL) for z in (0.5, -0.5)]
    counts = {}
    for adaptive in (False, True):
        method = SurfaceMethod(KnownDepth(), SynthesisOptions(SMALL, threads=1, adaptive=adaptive))
        counts[adaptive] = method.prepare(0, views).prepared.triangles
    assert counts[False][0] == counts[False][1] == counts[True][1] > counts[True][0]


def test_fewer_triangles_are_looked_for_where_frames_pay_for_it(tmp_path: Path) -> None:
    """Unless the user says otherwise,."""
    images = write_hall(tmp_path, [posed([0.0, 0.0, z]) for z in (0.5, 0.0, -0.5)])
    usual = {frames: plan_interpolation(job_of(tmp_path, images, frames=frames)) for frames in (64, 65)}
    assert [plan.config.adaptive for plan in usual.values()] == [False, True]
    for adaptive in (True, False):
        asked = plan_interpolation(job_of(tmp_path, images, frames=64, adaptive=adaptive))
        assert asked.config.adaptive == with_preset(asked, "fast").config.adaptive == adaptive
