"""A common smooth surface for doubtful pairs; ground below a mask goes on as it would look."""

from dataclasses import replace

import numpy as np
import pytest

from confidence_samples import generated_views
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io.images import outside_nadir
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.synthesis.consistency import cross_check
from omnisyn_cli.synthesis.ground import continue_ground
from omnisyn_cli.synthesis.soft_surface import is_enclosed, soften_pair
from omnisyn_cli.types import DepthEstimate, KnownDepth, View
from synthesis_samples import posed

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
    soft = soften_pair(room, torn, cross_check(room, torn, Cut()))
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
    soft = soften_pair(views, depths, cross_check(views, depths, Cut()))
    for after in soft:
        rays = pixel_directions(*SIZE)
        floor = rays[..., 1] < -0.8
        error = np.log(after.inverse_depth * 1.5 / -rays[..., 1], where=floor, out=np.zeros(SIZE))[floor]
        assert np.abs(error).max() < 0.03
        assert error.std() < 0.01


@pytest.mark.parametrize(("kind", "expected"), [("room", True), ("street", False)])
def test_a_room_is_enclosed_and_a_street_is_not(kind: str, expected: bool) -> None:
    first, _, last = generated_views(kind, 104, 1.0, SIZE)
    assert is_enclosed((first, last), KnownDepth()(first, last)) == expected


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
