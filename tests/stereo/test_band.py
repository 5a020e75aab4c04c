"""Matching in bands against matching of all disparities, in which those outside of the bands are made impossible."""

import numpy as np
import pytest

from omnisyn_cli.stereo.band import Bands, aggregate_bands, band_cost, choose_in_bands
from omnisyn_cli.stereo.semi_global import UNSEEN, aggregate, sweep_cost

HEIGHT, WIDTH, LEVELS = 24, 40, 30
IMPOSSIBLE = np.float32(1e4)


@pytest.fixture
def random():
    return np.random.default_rng(4)


@pytest.fixture
def bands(random):
    """Of 1 to 9 disparities, some of them with nothing in common with those of the neighbours."""
    lowest = random.integers(0, LEVELS - 9, (HEIGHT, WIDTH)).astype(np.int32)
    lowest[:, 10:30] = 7 + random.integers(0, 3, (HEIGHT, 20))
    highest = lowest + random.integers(0, 9, (HEIGHT, WIDTH))
    return Bands.between(lowest, highest.astype(np.int32))


def inside(bands):
    """Which cells of a full volume the bands have; row by row, and level by level, as in the flat arrays."""
    count = np.diff(bands.begin).reshape(HEIGHT, WIDTH)
    level = np.arange(LEVELS)
    return (level >= bands.lowest[..., None]) & (level < (bands.lowest + count)[..., None])


def test_costs_are_those_of_the_sweep(random, bands):
    first, second = random.random((2, HEIGHT, WIDTH, 3), np.float32)
    usable = random.random((HEIGHT, WIDTH)) < 0.9
    everything = sweep_cost(first, second, usable, np.zeros((HEIGHT, WIDTH), np.float32), LEVELS, 0.4, 0.1)
    cost = band_cost(first, second, usable, bands, 0.4, 0.1)
    np.testing.assert_allclose(cost, everything[inside(bands)], rtol=1e-6)
    assert (cost == UNSEEN).any()


def test_paths_are_those_of_a_volume_with_nothing_outside_of_the_bands(random, bands):
    cost, luminance = random.random((HEIGHT, WIDTH, LEVELS), np.float32), random.random((HEIGHT, WIDTH), np.float32)
    penalties = 0.1, 0.5, 0.05
    full = aggregate(np.where(inside(bands), cost, IMPOSSIBLE), luminance, *penalties)
    total = aggregate_bands(cost[inside(bands)], bands, luminance, *penalties)
    np.testing.assert_allclose(total, full[inside(bands)], rtol=1e-3, atol=2e-2)


def test_a_minimum_between_disparities_is_found_where_it_is(random):
    where = random.uniform(6.0, 12.0, (HEIGHT, WIDTH)).astype(np.float32)
    bands = Bands.between(np.full((HEIGHT, WIDTH), 3, np.int32), np.full((HEIGHT, WIDTH), 15, np.int32))
    total = np.abs(np.arange(3, 16) - where[..., None]).astype(np.float32)
    disparity, margin = choose_in_bands(total.ravel(), bands)
    np.testing.assert_allclose(disparity, where, atol=1e-4)
    nearest = np.rint(where)
    np.testing.assert_allclose(margin, 2.0 - 2.0 * np.abs(where - nearest), atol=1e-4)


@pytest.mark.parametrize("falling", [True, False])
def test_nothing_is_sure_at_the_end_of_a_band(falling):
    bands = Bands.between(np.full((2, 4), 5, np.int32), np.full((2, 4), 8, np.int32))
    total = np.tile(np.arange(4.0, dtype=np.float32)[:: -1 if falling else 1], 8)
    disparity, margin = choose_in_bands(total, bands)
    assert (disparity == (8 if falling else 5)).all()
    assert not margin.any()
