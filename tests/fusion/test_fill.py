"""Holes take the colours around them, across the seam and rather from the far side; nothing else changes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from omnisyn_cli.fusion.fill import HoleFiller

sizes = st.sampled_from([(8, 16), (7, 14), (5, 10), (1, 2), (13, 26), (16, 32)])


def filled(image: np.ndarray, weight: np.ndarray, threads: int | None = 1) -> np.ndarray:
    result = image.astype(np.float32).copy()
    HoleFiller(weight.shape, threads)(result, weight.astype(np.float32))
    return result


def random_case(size: tuple[int, int], share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Colours, and weights that are 0 for a share of the pixels; what is hidden is not even a number."""
    rng = np.random.default_rng(seed)
    image, weight = rng.random((*size, 3), np.float32), rng.random(size, np.float32) + 0.01
    weight[rng.random(size) < share] = 0
    image[weight == 0] = np.nan
    return image, weight


@settings(max_examples=60, deadline=None)
@given(sizes, st.floats(0.05, 0.98), st.integers(0, 999))
def test_holes_stay_within_the_known_colours_and_the_known_stay(size: tuple[int, int], share: float, seed: int) -> None:
    image, weight = random_case(size, share, seed)
    known = weight > 0
    result = filled(image, weight)
    np.testing.assert_array_equal(result[known], image[known])
    if known.any():
        low, high = image[known].min(axis=0), image[known].max(axis=0)
        assert (result[~known] >= low - 1e-5).all()
        assert (result[~known] <= high + 1e-5).all()


@given(arrays(np.float32, 3, elements=st.floats(0, 1, width=32)))
def test_a_constant_surrounding_is_continued_constantly(colour: np.ndarray) -> None:
    image, weight = random_case((12, 24), 0.7, 4)
    image[weight > 0] = colour
    np.testing.assert_allclose(filled(image, weight), np.broadcast_to(colour, image.shape), atol=1e-6)


@pytest.mark.parametrize("size", [(16, 32), (12, 24), (9, 18)])
def test_a_hole_on_the_seam_is_filled_from_both_sides(size: tuple[int, int]) -> None:
    """Red to its left, blue to its right, as anywhere else: at the seam's two columns it is half of each."""
    height, width = size
    image, weight = np.zeros((height, width, 3), np.float32), np.ones(size, np.float32)
    image[:, : width // 2, 2] = 1
    image[:, width // 2 :, 0] = 1
    weight[:, :2] = weight[:, -2:] = 0
    result = filled(image, weight)
    assert (result[:, 0, 0] > 0.1).all()
    assert (result[:, -1, 2] > 0.1).all()
    if width % 4 == 0:
        np.testing.assert_allclose(result[:, 0], result[:, -1, ::-1], atol=1e-6)


def test_a_hole_behind_a_near_thing_continues_the_far_side() -> None:
    size = (16, 32)
    image, weight = np.zeros((*size, 3), np.float32), np.ones(size, np.float32)
    image[:, :16] = (1, 0, 0)
    image[:, 16:] = (0, 1, 0)
    weight[:, :16] = 1e-3  # near
    weight[:, 14:18] = 0
    result = filled(image, weight)[4:12, 14:18]
    assert (result[..., 1] > result[..., 0]).all()
    assert result[..., 1].mean() > 0.9


@pytest.mark.parametrize("columns", [16, 32, 48])
def test_rolling_by_multiples_of_the_coarsest_step_rolls_the_result(columns: int) -> None:
    """Pixels are joined in twos, so only such turns leave the pyramid what it was; width 64 is halved to 4 in 16s."""
    image, weight = random_case((32, 64), 0.8, 7)
    weight[:, 60:] = weight[:, :5] = 0
    rolled = filled(np.roll(image, columns, axis=1), np.roll(weight, columns, axis=1))
    np.testing.assert_allclose(rolled, np.roll(filled(image, weight), columns, axis=1), atol=1e-6)


def test_upside_down_is_filled_upside_down() -> None:
    image, weight = random_case((16, 32), 0.8, 9)
    np.testing.assert_allclose(filled(image[::-1], weight[::-1]), filled(image, weight)[::-1], atol=1e-6)


def test_a_reused_filler_does_not_remember_and_without_anything_known_all_is_black() -> None:
    filler, second = HoleFiller((8, 16), 1), random_case((8, 16), 0.9, 5)
    filler(*random_case((8, 16), 0.2, 3))
    again = second[0].copy()
    filler(again, second[1])
    np.testing.assert_array_equal(again, filled(*second))
    nothing = np.full((8, 16, 3), np.nan, np.float32)
    filler(nothing, np.zeros((8, 16), np.float32))
    np.testing.assert_array_equal(nothing, 0)


def test_the_number_of_threads_does_not_show() -> None:
    image, weight = random_case((256, 512), 0.6, 1)
    np.testing.assert_array_equal(filled(image, weight, 1), filled(image, weight, 3))
