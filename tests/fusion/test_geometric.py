"""Two renderings become one picture: photographs at the ends, no seam; kernels are the rule; numbers are rounded."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from omnisyn_cli.fusion.blend_kernels import quantize_rows
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, blend_layers, view_weights
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, Layer

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


def fuse(first: Layer, second: Layer, t: float) -> np.ndarray:
    return GeometricFuser(SIZE, threads=1)(first, second, t).copy()


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


def test_colours_of_almost_no_weight_are_not_shown() -> None:
    """Alpha is interpolated, so beside a mask a forbidden pixel has a trace of it."""
    first, second = rendering(1, 0.3), rendering(2, 0.3)
    first.colour[..., 3] = 1e-5
    for t in (0.0, 0.5):
        np.testing.assert_array_equal(fuse(first, second, t), second.colour[..., :3])


def test_colours_beyond_white_pass_and_below_black_do_not() -> None:
    """Bicubic lookup overshoots; floating-point panoramas are brighter than 1."""
    first, second = rendering(1, 0.3), rendering(2, 0.3)
    first.colour[..., 0], first.colour[..., 1] = 5.0, -0.2
    fused = fuse(first, second, 0.0)
    np.testing.assert_array_equal(fused[..., 0], 5.0)
    np.testing.assert_array_equal(fused[..., 1], 0.0)


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


def test_nothing_seen_by_anybody_is_black_and_finite() -> None:
    nothing = with_holes(rendering(1), np.ones(SIZE, bool))
    fuser = GeometricFuser(SIZE, threads=1)
    fuser(rendering(1), rendering(2), 0.5)  # buffers are reused: the former picture must not show
    np.testing.assert_array_equal(fuser(nothing, nothing, 0.5), np.zeros((*SIZE, 3), np.float32))


WIDE_SIZE = (61, 1200)  # More columns than are blended together.


def mixed_rendering(seed: int) -> Layer:
    """Holes, masked pixels, weights around the least that counts, infinity, distances alike and far apart."""
    rng = np.random.default_rng(seed)
    colour = rng.uniform(-0.05, 1.2, (*WIDE_SIZE, 4)).astype(np.float32)
    colour[..., 3] = np.clip(colour[..., 3], 0, 1) * (rng.random(WIDE_SIZE) > 0.2)
    faint = rng.random(WIDE_SIZE) < 0.1
    colour[faint, 3] = MIN_VISIBLE_WEIGHT * rng.choice(np.float32([0.5, 1.0, 1.001, 2.0]), faint.sum())
    rho = (0.3 + 0.02 * rng.standard_normal(WIDE_SIZE)).clip(0.0) * (rng.random(WIDE_SIZE) > 0.1)
    rho[rng.random(WIDE_SIZE) < 0.1] *= 3
    hole = rng.random(WIDE_SIZE) < 0.3
    colour[hole], rho[hole] = 0.0, -1.0
    offset = ((0.2, -0.1, 0.4), (-0.3, 0.2, -0.5))[seed]
    return Layer.from_arrays(rho.astype(np.float32), colour, Pose(np.eye(3), np.array(offset)))


def shown(view: Layer) -> LayerArrays:
    offset = view.target_from_source.position.astype(np.float32)
    return LayerArrays(view.colour[..., :3], view.colour[..., 3], view.inverse_depth, offset)


def as_tensors(view: LayerArrays) -> LayerArrays:
    return LayerArrays(*(torch.from_numpy(np.ascontiguousarray(part)) for part in vars(view).values()))


DIRECTIONS = pixel_directions(*WIDE_SIZE).astype(np.float32)
VIEWS = mixed_rendering(0), mixed_rendering(1)


@pytest.mark.parametrize("t", [0.0, 0.002, 0.05, 0.5, 0.93, 1.0])
@pytest.mark.parametrize("changes", [{}, {"disagreement": 0.2, "hidden_weight": 0.3}, {"hidden_weight": 1.0}], ids=str)
def test_the_kernel_is_the_rule(t: float, changes: dict[str, float]) -> None:
    """What is seen, to a tenth of a level; the exponential of the kernel is right to a ten-thousandth of itself."""
    rule, views = replace(BlendRule.at(t), **changes), [shown(view) for view in VIEWS]
    weights = view_weights(*views, DIRECTIONS, rule)
    expected, counts = blend_layers(*views, weights)
    fuser, found = GeometricFuser(WIDE_SIZE, threads=1), np.empty((*WIDE_SIZE, 3), np.float32)
    fuser.blend(LayerPair(*VIEWS), rule, found)
    np.testing.assert_array_equal(fuser.is_seen > 0, counts > 0)
    seen = counts > 0
    assert 0.05 < 1 - seen.mean() < 0.5
    np.testing.assert_allclose(found[seen], expected[seen], atol=1e-4)
    alone = seen & ((weights[0] == 0) | (weights[1] == 0))
    one = np.where((weights[0] > 0)[..., None], views[0].colour, views[1].colour)
    np.testing.assert_array_equal(found[alone], np.maximum(one, 0)[alone])


@pytest.mark.parametrize("t", [0.0, 0.3, 1.0])
def test_tensors_are_blended_as_arrays(t: float) -> None:
    rule, views = BlendRule.at(t), [shown(view) for view in VIEWS]
    expected = blend_layers(*views, view_weights(*views, DIRECTIONS, rule))
    tensors = [as_tensors(view) for view in views]
    found = blend_layers(*tensors, view_weights(*tensors, torch.from_numpy(DIRECTIONS), rule))
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == torch.float32
        assert other.dtype == np.float32
        np.testing.assert_allclose(one.numpy(), other, atol=2e-5)


def test_gradients_are_finite_holes_infinity_and_equal_depths_included() -> None:
    views = [as_tensors(shown(view)) for view in VIEWS]
    for view in views:
        view.colour.requires_grad_()
        view.inverse_depth.requires_grad_()
    weights = view_weights(*views, torch.from_numpy(DIRECTIONS), BlendRule.at(0.4))
    sum(part.sum() for part in blend_layers(*views, weights)).backward()
    for view in views:
        assert torch.isfinite(view.colour.grad).all()
        assert torch.isfinite(view.inverse_depth.grad).all()
        assert view.inverse_depth.grad.abs().max() > 0


def test_hiding_sets_in_smoothly_and_symmetrically() -> None:
    t = np.linspace(0, 1, 201)
    occlusion_strength = np.array([BlendRule.at(x).occlusion_strength for x in t])
    np.testing.assert_allclose(occlusion_strength, occlusion_strength[::-1], atol=1e-12)
    assert occlusion_strength[0] == occlusion_strength[-1] == 0
    assert (occlusion_strength[20:181] == 1).all()
    assert np.abs(np.diff(occlusion_strength)).max() < 0.1
    assert (np.diff(occlusion_strength[:21]) >= 0).all()


def quantized(values: np.ndarray, dtype: type = np.uint8) -> np.ndarray:
    image = np.repeat(np.asarray(values, np.float32)[None, :, None], 3, axis=2)
    out = np.zeros(image.shape, dtype)
    quantize_rows(image, np.float32(np.iinfo(dtype).max), out, 0, 1)
    assert (out == out[..., :1]).all()
    return out[0, :, 0]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_sample_survives_the_way_to_a_number_and_back(dtype: type) -> None:
    samples = np.arange(np.iinfo(dtype).max + 1)
    np.testing.assert_array_equal(quantized(samples / np.iinfo(dtype).max, dtype), samples)


def test_the_nearest_sample_is_taken_and_for_what_is_out_of_range_an_end() -> None:
    levels = {0.49: 0, 0.51: 1, 1.49: 1, 1.51: 2, 254.49: 254, 254.51: 255, -1e3: 0, -1e-6: 0, 255.001: 255, 1e4: 255,
              np.inf: 255, -np.inf: 0}  # fmt: skip
    np.testing.assert_array_equal(quantized(np.array(list(levels)) / 255), list(levels.values()))


def test_only_the_asked_rows_become_samples() -> None:
    out = np.full((4, 2, 3), 9, np.uint8)
    quantize_rows(np.zeros((4, 2, 3), np.float32), np.float32(255), out, 1, 3)
    np.testing.assert_array_equal(out[:, 0, 0], [9, 0, 0, 9])
