"""Vectors against numpy: every operation of :mod:`omnisyn_cli.render.simd` on numbers that tell lanes apart."""

import numpy as np
import pytest

from omnisyn_cli.compute.jit import kernel
from omnisyn_cli.render.simd import (
    FIXED_POINT_UNIT,
    FIXED_TEXEL,
    LANES,
    broadcast,
    broadcast_weight,
    has_bits,
    load,
    load_four_weights,
    load_halves,
    load_texel_pairs,
    load_texels,
    pair,
    prefetch,
    store,
    store_halves,
    store_texel_sum,
    to_float32,
    to_float64,
    where,
)


@kernel(cache=False)
def arithmetic(a, b, out):
    x, y = load(a, 1), load(b, 1)
    store(out, 0, x + y)
    store(out, 8, x - y)
    store(out, 16, x * y)
    store(out, 24, x / y)
    store(out, 32, to_float32(to_float64(x) * to_float64(y)))


@kernel(cache=False)
def choices(a, b, flags, bits, out):
    x, y, one, zero = load(a, 0), load(b, 0), broadcast(np.float32(1.0)), broadcast(np.float32(0.0))
    store(out, 0, where(x >= y, one, zero))
    store(out, 8, where(x > y, one, zero))
    store(out, 16, where((x >= y) & (y > zero), one, zero))
    store(out, 24, where((x > y) | (y > x), one, zero))
    store(out, 32, where(has_bits(flags, 3, bits), one, zero))


@kernel(cache=False)
def halves(a, out, numbers):
    x = load_halves(a, 2, 11)
    store(out, 0, x)
    store(out, 16, pair(np.float32(3.0), np.float32(4.0)))
    store_halves(out, 36, 28, x)
    store_halves(numbers, 4, 0, load_halves(numbers, 0, 4))


@pytest.fixture
def two() -> np.ndarray:
    return np.random.default_rng(0).uniform(0.5, 2.0, (2, 32)).astype(np.float32)


def test_arithmetic_is_numpy_s(two):
    a, b, out = *two, np.zeros(5 * LANES, np.float32)
    arithmetic(a, b, out)
    x, y = two[:, 1:9]
    exact = (x.astype(float) * y.astype(float)).astype(np.float32)
    np.testing.assert_array_equal(out.reshape(5, LANES), [x + y, x - y, x * y, x / y, exact])


def test_masks_choose_lane_by_lane(two):
    a, b, out = *two, np.zeros(5 * LANES, np.float32)
    b[:4] = a[:4]
    b[7] = -1.0
    flags, bits = np.arange(32, dtype=np.uint8), np.uint8(6)
    choices(a, b, flags, bits, out)
    x, y = a[:8], b[:8]
    expected = [x >= y, x > y, (x >= y) & (y > 0), x != y, (flags[3:11] & bits) != 0]
    np.testing.assert_array_equal(out.reshape(5, LANES), expected)


def test_comparisons_with_nan_are_false(two):
    a, b, out = *two, np.zeros(5 * LANES, np.float32)
    a[:8] = np.nan
    choices(a, b, np.zeros(32, np.uint8), np.uint8(1), out)
    assert not out.any()


def test_halves_come_from_and_go_to_different_places(two):
    a, out, numbers = two[0], np.zeros(40, np.float32), np.arange(8, dtype=np.int32)
    halves(a, out, numbers)
    lower, upper = a[2:6], a[11:15]
    expected = [lower, upper, [0] * 4, [0] * 4, [3] * 4, [4] * 4, [0] * 4, upper, [0] * 4, lower]
    np.testing.assert_array_equal(out.reshape(10, 4), expected)
    assert numbers.tolist() == [4, 5, 6, 7, 0, 1, 2, 3]


@kernel(cache=False)
def sums(texels, of_rows, of_columns, once, twice, out):
    prefetch(texels, 1 << 20)
    rows = load_texels(texels, 4) * broadcast_weight(of_rows, 1) + load_texels(texels, 24) * broadcast_weight(
        of_rows, 2
    )
    store_texel_sum(out, 0, rows * load_four_weights(of_columns, 2), twice, np.float32(0.5), np.float32(3.0))
    pairs = load_texel_pairs(texels, 4, 28) * load_four_weights(of_columns, 1)
    store_texel_sum(out, 4, pairs, once, np.float32(0.0), np.float32(1.0))


def test_texels_are_weighted_and_summed():
    """To rounding as numbers; as integers to a 32nd of a level for each product, which are cut off."""
    rng = np.random.default_rng(1)
    texels, weights, out = rng.integers(0, 256, 48), rng.uniform(-0.1, 0.7, 8), np.zeros(8, np.float32)
    rows = texels[4:20] * weights[1] + texels[24:40] * weights[2]
    pairs = np.concatenate([texels[4:12], texels[28:36]])
    four = (weights[2:6] @ rows.reshape(4, 4)) * [1, 1, 1, 3] + [0.5, 0.5, 0.5, 0]
    expected = np.concatenate([four, weights[1:5] @ pairs.reshape(4, 4)])
    one = np.float32(1.0)
    sums(texels.astype(np.float32), *[weights.astype(np.float32)] * 2, one, one, out)
    np.testing.assert_allclose(out, expected, rtol=1e-5)
    fixed, once = np.rint(weights * FIXED_POINT_UNIT).astype(np.int16), np.float32(2.0 / FIXED_TEXEL)
    sums(texels.astype(np.uint8), np.repeat(fixed, 2).view(np.int32), fixed, once, 2 * once, out)
    errors = (expected - out) / [1, 1, 1, 3, 1, 1, 1, 1]
    assert ((errors > 0) & (errors < 6 / 32)).all()
