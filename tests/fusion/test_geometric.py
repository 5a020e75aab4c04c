"""Two renderings become one picture: the photographs at the ends, the nearer surface between, no pop, no seam."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omnisyn_cli.fusion import blend_rule
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.types import Layer

SIZE = (16, 32)


def rendering(
    seed: int = 0, inverse_depth: float | np.ndarray | None = None, offset: tuple[float, float, float] = (0, 0, 0)
) -> Layer:
    """Random colours, all of full weight, at random distances from 2 m on unless told otherwise."""
    rng = np.random.default_rng(seed)
    colour = rng.random((*SIZE, 4), np.float32)
    colour[..., 3] = 1
    rho = rng.random(SIZE, np.float32) * 0.5 if inverse_depth is None else inverse_depth
    return Layer.from_arrays(np.full(SIZE, rho, np.float32), colour, Pose(np.eye(3), np.array(offset, float)))


def with_holes(whole: Layer, holes: np.ndarray) -> Layer:
    """What a renderer gives where it sees nothing: negative inverse depth, all of the colour 0."""
    rho = np.where(holes, np.float32(-1), whole.inverse_depth)
    return Layer.from_arrays(rho, np.where(holes[..., None], np.float32(0), whole.colour), whole.target_from_source)


def fuse(first: Layer, second: Layer, t: float, threads: int | None = 1) -> np.ndarray:
    return GeometricFuser(SIZE, threads=threads)(first, second, t).copy()


def half_seen(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random(SIZE) < 0.3


def test_the_ends_are_the_renderings_themselves() -> None:
    first, second = rendering(1, offset=(0, 0, 1)), rendering(2, offset=(0.5, 0, -1))
    np.testing.assert_array_equal(fuse(first, second, 0.0), first.colour[..., :3])
    np.testing.assert_array_equal(fuse(first, second, 1.0), second.colour[..., :3])


def test_at_the_ends_what_one_view_does_not_show_comes_from_the_other() -> None:
    first, second, holes = rendering(1), rendering(2), half_seen(3)
    for t, a, b in ((0.0, with_holes(first, holes), second), (1.0, second, with_holes(first, holes))):
        fused = fuse(a, b, t)
        np.testing.assert_array_equal(fused[holes], second.colour[holes, :3])
        np.testing.assert_array_equal(fused[~holes], first.colour[~holes, :3])


@pytest.mark.parametrize("t", [0.0, 0.02, 0.25, 0.5, 0.8, 1.0])
def test_swapping_the_views_and_the_time_changes_nothing(t: float) -> None:
    first = with_holes(rendering(1, offset=(0.3, -0.1, 0.5)), half_seen(5))
    second = with_holes(rendering(2, offset=(-0.2, 0.2, -1)), half_seen(6))
    np.testing.assert_allclose(fuse(first, second, t), fuse(second, first, 1 - t), atol=2e-6)


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 1), st.integers(0, 99))
def test_every_pixel_lies_between_the_two_colours(t: float, seed: int) -> None:
    first, second = rendering(seed, offset=(0, 0.2, 1)), rendering(seed + 1, offset=(0, 0, -1))
    fused = fuse(first, second, t)
    low = np.minimum(first.colour, second.colour)[..., :3]
    high = np.maximum(first.colour, second.colour)[..., :3]
    assert (fused >= low - 1e-6).all()
    assert (fused <= high + 1e-6).all()


def test_what_agrees_and_is_equally_far_is_mixed_by_the_share_of_the_way() -> None:
    first, second = rendering(1, 0.25), rendering(2, 0.25)
    for t in (0.1, 0.25, 0.5, 0.9):
        expected = (1 - t) * first.colour[..., :3] + t * second.colour[..., :3]
        np.testing.assert_allclose(fuse(first, second, t), expected, atol=1e-6)


def test_the_view_taken_nearer_to_a_surface_counts_more_there() -> None:
    """The first camera stands 1 m ahead (−z) of the target, the second 1 m behind; a ball of 2 m is around it."""
    first, second = rendering(1, 0.5, offset=(0, 0, -1)), rendering(2, 0.5, offset=(0, 0, 1))
    fused = fuse(first, second, 0.5)
    share = (fused - second.colour[..., :3]) / (first.colour[..., :3] - second.colour[..., :3])
    equator = np.median(share, axis=-1)[SIZE[0] // 2]
    ahead, behind, beside = equator[SIZE[1] // 2], equator[0], equator[SIZE[1] // 4]
    np.testing.assert_allclose(ahead, 27 / 28, atol=5e-3)  # 1 m against 3 m, cubed
    np.testing.assert_allclose(behind, 1 / 28, atol=5e-3)
    np.testing.assert_allclose(beside, 1 / 2, atol=8e-2)
    assert (np.diff(equator[: SIZE[1] // 2]) > 0).all()


@pytest.mark.parametrize("near_is_first", [True, False])
def test_the_nearer_surface_wins_where_they_disagree(near_is_first: bool) -> None:
    near, far = rendering(1, 0.5), rendering(2, 0.1)
    for t in (0.2, 0.5, 0.8):
        fused = fuse(near, far, t) if near_is_first else fuse(far, near, t)
        np.testing.assert_allclose(fused, near.colour[..., :3], atol=0.02)


def test_infinitely_far_is_a_place_like_any_other() -> None:
    """Both see the sky: mixed; one sees the sky where the other sees a wall: the wall."""
    sky, other, wall = rendering(1, 0.0), rendering(2, 0.0), rendering(3, 0.02)
    np.testing.assert_allclose(fuse(sky, other, 0.5), (sky.colour + other.colour)[..., :3] / 2, atol=1e-6)
    np.testing.assert_allclose(fuse(sky, wall, 0.5), wall.colour[..., :3], atol=0.02)


def test_trust_is_a_weight() -> None:
    first, second = rendering(1, 0.3), rendering(2, 0.3)
    first.colour[..., 3] = 0.25
    expected = 0.2 * first.colour[..., :3] + 0.8 * second.colour[..., :3]
    np.testing.assert_allclose(fuse(first, second, 0.5), expected, atol=1e-6)


def test_colours_of_almost_no_weight_are_not_shown() -> None:
    """Alpha is interpolated, so beside a mask a forbidden pixel has a trace of it."""
    first, second = rendering(1, 0.3), rendering(2, 0.3)
    first.colour[..., 3] = 1e-5
    for t in (0.0, 0.5):
        np.testing.assert_array_equal(fuse(first, second, t), second.colour[..., :3])


def test_nothing_pops_up_along_the_way() -> None:
    """The picture is a continuous function of t: from a hundredth to a hundredth no pixel moves far, ends included."""
    first = rendering(1, offset=(0, 0, -0.5))
    second = rendering(2, offset=(0, 0, 0.5))
    fuser = GeometricFuser(SIZE, threads=1)
    coarse = np.array([fuser(first, second, t).copy() for t in np.linspace(0, 1, 101)])
    assert np.abs(np.diff(coarse, axis=0)).max() < 0.25
    ends = np.array([fuser(first, second, t).copy() for t in (0.0, 1e-4, 2e-4, 1 - 2e-4, 1 - 1e-4, 1.0)])
    assert np.abs(np.diff(ends, axis=0)[[0, 1, 3, 4]]).max() < 0.005


def test_a_hidden_surface_keeps_the_share_that_it_is_granted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blend_rule, "HIDDEN_WEIGHT", 0.25)
    near, far = rendering(1, 0.5), rendering(2, 0.1)
    fused = GeometricFuser(SIZE, threads=1)(near, far, 0.5)
    np.testing.assert_allclose(fused, 0.8 * near.colour[..., :3] + 0.2 * far.colour[..., :3], atol=1e-5)


def test_turning_everything_by_columns_turns_the_result() -> None:
    """Where anything is seen; what fills the holes is tested by itself."""
    first, second = with_holes(rendering(1), half_seen(3)), with_holes(rendering(2), half_seen(4))
    rolled = [
        Layer.from_arrays(np.roll(r.inverse_depth, 5, axis=1), np.roll(r.colour, 5, axis=1), r.target_from_source)
        for r in (first, second)
    ]
    seen = np.roll((first.inverse_depth >= 0) | (second.inverse_depth >= 0), 5, axis=1)
    assert not seen.all()
    whole, turned = np.roll(fuse(first, second, 0.4), 5, axis=1), fuse(*rolled, 0.4)
    np.testing.assert_allclose(turned[seen], whole[seen], atol=1e-5)


def test_a_hole_beside_a_near_thing_shows_what_is_behind_it() -> None:
    """To its left a near red thing, to its right a far green wall: nobody saw the hole, so it is wall."""
    rho = np.where(np.arange(SIZE[1]) < SIZE[1] // 2, 0.5, 0.05) * np.ones(SIZE)
    first, hole = rendering(1, rho), np.zeros(SIZE, bool)
    first.colour[..., :3] = np.where(rho[..., None] > 0.1, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    hole[:, SIZE[1] // 2 - 3 : SIZE[1] // 2 + 3] = True
    seen = with_holes(first, hole)
    filled = fuse(seen, seen, 0.5)[hole]
    assert (filled[:, 1] > 0.9).all()
    np.testing.assert_allclose(filled.sum(axis=-1), 1, atol=1e-5)


def test_the_number_of_threads_does_not_show() -> None:
    first, second = with_holes(rendering(1), half_seen(3)), with_holes(rendering(2), half_seen(4))
    np.testing.assert_array_equal(fuse(first, second, 0.3, threads=1), fuse(first, second, 0.3, threads=3))


def test_nothing_seen_by_anybody_is_black_and_finite() -> None:
    nothing = with_holes(rendering(1), np.ones(SIZE, bool))
    fuser = GeometricFuser(SIZE, threads=1)
    fuser(rendering(1), rendering(2), 0.5)  # buffers are reused: the former picture must not show
    np.testing.assert_array_equal(fuser(nothing, nothing, 0.5), np.zeros((*SIZE, 3), np.float32))


def test_colours_beyond_white_pass_and_below_black_do_not() -> None:
    """Bicubic lookup overshoots; floating-point panoramas are brighter than 1."""
    first, second = rendering(1, 0.3), rendering(2, 0.3)
    first.colour[..., 0], first.colour[..., 1] = 5.0, -0.2
    fused = fuse(first, second, 0.0)
    np.testing.assert_array_equal(fused[..., 0], 5.0)
    np.testing.assert_array_equal(fused[..., 1], 0.0)
