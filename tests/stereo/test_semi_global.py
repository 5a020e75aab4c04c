"""Semi-global matching over ranges of disparities against plain loops, and what must hold whatever the costs are."""

import numpy as np
import pytest

from omnisyn_cli.stereo.costs import OUT_OF_VIEW_COST, cost_volume
from omnisyn_cli.stereo.semi_global import (
    FIXED_POINT_SCALE,
    MAX_COST,
    MAX_P2,
    RIVAL_MIN_ROWS,
    SEAM_WARM_UP_COLUMNS,
    DisparityRange,
    aggregate_costs,
    to_fixed_point,
    uniqueness_margin,
    winner_takes_all,
)

HEIGHT, WIDTH, LEVELS = 24, 40, 30
SMALL = (48, 96)
RNG = np.random.default_rng(3)

# What sums may err by: costs and penalties are rounded, and on every path some of them come together.
EIGHT_PATHS = 8 * 6 / FIXED_POINT_SCALE


@pytest.fixture
def random():
    return np.random.default_rng(4)


@pytest.fixture
def ranges(random):
    """Of 1 to 9 disparities, some of them with nothing in common with those of the neighbours."""
    lowest = random.integers(0, LEVELS - 9, (HEIGHT, WIDTH)).astype(np.int32)
    lowest[:, 10:30] = 7 + random.integers(0, 3, (HEIGHT, 20))
    highest = lowest + random.integers(0, 9, (HEIGHT, WIDTH))
    return DisparityRange.from_bounds(lowest, highest.astype(np.int32))


def everything(size, levels):
    """The same disparities for all pixels: a whole volume."""
    return DisparityRange.from_bounds(np.zeros(size, np.int32), levels - 1)


def inside(ranges):
    """Which cells of a full volume the ranges have; row by row, and level by level, as in the flat arrays."""
    count = np.diff(ranges.offsets).reshape(ranges.lowest.shape)
    level = np.arange(LEVELS)
    return (level >= ranges.lowest[..., None]) & (level < (ranges.lowest + count)[..., None])


def path_costs(cost, grey, pixels, p1, p2, contrast):
    """Costs along one path through a volume, where NaN is no disparity, one pixel after the other: the definition."""
    found, before, last = {}, None, None
    for pixel in pixels:
        here = {level: value for level, value in enumerate(cost[pixel]) if not np.isnan(value)}
        if before is not None:
            cheapest = min(before.values())
            jump = cheapest + p2 / (1.0 + abs(grey[pixel] - grey[last]) / contrast)
            for level, value in here.items():
                ways = [jump, *(before[k] + p1 * abs(k - level) for k in (level - 1, level, level + 1) if k in before)]
                here[level] = value + min(ways) - cheapest
        found[pixel] = before = here
        last = pixel
    return found


def paths(height, width):
    """Every path: six along meridians, straight or slopeing, and two around, which begin before the seam."""
    for slope in (-1, 0, 1):
        for origin in range(width):
            rows = range(height)
            yield [(row, (origin + slope * k) % width) for k, row in enumerate(rows)], 0
            yield [(row, (origin + slope * k) % width) for k, row in enumerate(reversed(rows))], 0
    for row in range(height):
        yield [(row, k % width) for k in range(-SEAM_WARM_UP_COLUMNS, width)], SEAM_WARM_UP_COLUMNS
        yield [(row, (width - 1 - k) % width) for k in range(-SEAM_WARM_UP_COLUMNS, width)], SEAM_WARM_UP_COLUMNS


def test_sums_are_those_of_plain_loops_over_eight_directions(random):
    size, levels, penalties = (6, 9), 7, (0.1, 0.5, 0.05)
    lowest = random.integers(0, 4, size).astype(np.int32)
    ranges = DisparityRange.from_bounds(lowest, (lowest + random.integers(0, 3, size)).astype(np.int32))
    grey = random.random(size, np.float32)
    count = np.diff(ranges.offsets).reshape(size)
    is_tried = (np.arange(levels) >= lowest[..., None]) & (np.arange(levels) < (lowest + count)[..., None])
    cost = np.where(is_tried, random.random((*size, levels)), np.nan)
    expected = np.where(is_tried, 0.0, np.nan)
    for pixels, run_up in paths(*size):
        steps = [(row, col, k) for k, (row, col) in enumerate(pixels)]
        volume = {(row, col, k): cost[row, col] for row, col, k in steps}
        shades = {(row, col, k): float(grey[row, col]) for row, col, k in steps}
        for (row, col, k), found in path_costs(volume, shades, steps, *penalties).items():
            if k >= run_up:
                for level, value in found.items():
                    expected[row, col, level] += value
    total = aggregate_costs(to_fixed_point(cost[is_tried]), ranges, grey, *penalties) / FIXED_POINT_SCALE
    np.testing.assert_allclose(total, expected[is_tried], atol=EIGHT_PATHS)


def test_costs_of_ranges_are_those_of_the_whole_volume(random, ranges):
    first, second = random.random((2, HEIGHT, WIDTH, 3), np.float32)
    usable = random.random((HEIGHT, WIDTH)) < 0.9
    volume = cost_volume(first, second, usable, everything((HEIGHT, WIDTH), LEVELS), 0.4, 0.1)
    cost = cost_volume(first, second, usable, ranges, 0.4, 0.1)
    np.testing.assert_array_equal(cost, volume.reshape(HEIGHT, WIDTH, LEVELS)[inside(ranges)])
    assert (cost == to_fixed_point(OUT_OF_VIEW_COST)).any()


def test_with_the_largest_penalties_one_level_wins_everywhere_it_can_reach() -> None:
    cost, volume = 0.1 * RNG.random((*SMALL, 5)), everything(SMALL, 5)
    cost[..., [0, 1, 2, 4]] += 0.05
    total = aggregate_costs(to_fixed_point(cost).ravel(), volume, np.zeros(SMALL, np.float32), 1e6, 1e6, 0.1)
    assert np.all(np.rint(winner_takes_all(total, volume, is_complete_range=True)[0]) == 3)


def test_the_largest_costs_and_penalties_do_not_overflow() -> None:
    cost, volume = np.full((*SMALL, 6), MAX_COST), everything(SMALL, 6)
    cost[:, :, 2] = 0.0
    total = aggregate_costs(
        to_fixed_point(2.0 * cost).ravel(), volume, np.zeros(SMALL, np.float32), MAX_P2, MAX_P2, 0.1
    )
    sums = total.reshape(cost.shape) / FIXED_POINT_SCALE
    assert (sums[..., 2] == 0.0).all()
    np.testing.assert_array_equal(np.delete(sums[1:-1, 1:-1], 2, axis=-1), 8.0 * (MAX_COST + MAX_P2))


def test_aggregation_has_no_seam() -> None:
    cost, grey = to_fixed_point(RNG.random((*SMALL, 5))), RNG.random(SMALL).astype(np.float32)
    before = aggregate_costs(cost.ravel(), everything(SMALL, 5), grey, 0.05, 0.3, 0.1).reshape(cost.shape)
    turned = np.roll(cost, 31, axis=1).ravel()
    after = aggregate_costs(turned, everything(SMALL, 5), np.roll(grey, 31, axis=1), 0.05, 0.3, 0.1)
    np.testing.assert_array_equal(np.roll(before, 31, axis=1).ravel(), after)


@pytest.mark.parametrize("is_complete_range", [True, False])
def test_a_minimum_between_disparities_is_found_where_it_is(random, is_complete_range):
    where = random.uniform(6.0, 12.0, (HEIGHT, WIDTH)).astype(np.float32)
    ranges = DisparityRange.from_bounds(np.full((HEIGHT, WIDTH), 3, np.int32), 15)
    total = to_fixed_point(np.abs(np.arange(3, 16) - where[..., None]) / 4.0)
    disparity, margin = winner_takes_all(total.ravel(), ranges, is_complete_range=is_complete_range)
    np.testing.assert_allclose(disparity, where, atol=4.0 / FIXED_POINT_SCALE)
    nearest = np.rint(where)
    np.testing.assert_allclose(margin, 0.5 - 0.5 * np.abs(where - nearest), atol=2.0 / FIXED_POINT_SCALE)


@pytest.mark.parametrize("falling", [True, False])
@pytest.mark.parametrize("is_complete_range", [True, False])
def test_only_where_nothing_lies_beyond_is_the_end_of_a_range_certain(falling, is_complete_range):
    ranges = DisparityRange.from_bounds(np.full((2, 4), 5, np.int32), 8)
    total = np.tile(FIXED_POINT_SCALE * np.arange(4, dtype=np.uint16)[:: -1 if falling else 1], 8)
    disparity, margin = winner_takes_all(total, ranges, is_complete_range=is_complete_range)
    assert (disparity == (8 if falling else 5)).all()
    assert (margin == (2.0 if is_complete_range else 0.0)).all()


def test_the_uniqueness_margin_is_that_of_the_own_cost_over_what_lies_apart(random):
    ranges = DisparityRange.from_bounds(np.full((2, 8), 4, np.int32), 23)
    cost = 0.5 + 0.3 * random.random((2, 8, 20))
    chosen = random.integers(4, 24, (2, 8))
    away = np.abs(np.arange(4, 24) - chosen[..., None])
    cost[away <= 1] = 0.2
    cost[(away == 2) | (away == RIVAL_MIN_ROWS)] = 0.0  # what is close is no rival
    expected = np.where(away > RIVAL_MIN_ROWS, cost, np.inf).min(-1) - 0.2
    found = uniqueness_margin(to_fixed_point(cost).ravel(), ranges, chosen.astype(np.float32))
    np.testing.assert_allclose(found, expected, atol=2.0 / FIXED_POINT_SCALE)
