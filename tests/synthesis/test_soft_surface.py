"""Pairs that cannot be relied on: a common smooth surface where the photographs do not confirm depth."""

from dataclasses import replace

import numpy as np
import pytest

from confidence_samples import generated_views
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.synthesis.consistency import cross_check
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


def test_torn_depth_becomes_one_smooth_surface_for_both_views_and_confirmed_depth_stays(
    room: tuple[View, View],
) -> None:
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
