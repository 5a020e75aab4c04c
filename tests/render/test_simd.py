"""Vectors against numpy: every operation of :mod:`omnisyn_cli.render.simd` on numbers that tell lanes apart."""

import numpy as np
import pytest

from omnisyn_cli.render.simd import (
    LANES,
    double,
    has_bits,
    load,
    load_halves,
    pair,
    single,
    splat,
    store,
    store_half,
    store_halves,
    swapped,
    where,
)
from omnisyn_cli.runtime.jit import kernel


@kernel(cache=False)
def arithmetic(a, b, out):
    x, y = load(a, 1), load(b, 1)
    store(out, 0, x + y)
    store(out, 8, x - y)
    store(out, 16, x * y)
    store(out, 24, x / y)
    store(out, 32, single(double(x) * double(y)))


@kernel(cache=False)
def choices(a, b, flags, bits, out):
    x, y, one, zero = load(a, 0), load(b, 0), splat(np.float32(1.0)), splat(np.float32(0.0))
    store(out, 0, where(x >= y, one, zero))
    store(out, 8, where(x > y, one, zero))
    store(out, 16, where((x >= y) & (y > zero), one, zero))
    store(out, 24, where((x > y) | (y > x), one, zero))
    store(out, 32, where(has_bits(flags, 3, bits), one, zero))


@kernel(cache=False)
def halves(a, out, numbers):
    x = load_halves(a, 2, 11)
    store(out, 0, x)
    store(out, 8, swapped(x))
    store(out, 16, pair(np.float32(3.0), np.float32(4.0)))
    store_half(out, 24, x)
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
    expected = [lower, upper, upper, lower, [3] * 4, [4] * 4, lower, upper, [0] * 4, lower]
    np.testing.assert_array_equal(out.reshape(10, 4), expected)
    assert numbers.tolist() == [4, 5, 6, 7, 0, 1, 2, 3]
