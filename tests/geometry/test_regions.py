"""Regions on the sphere: a picture without a first column."""

import numpy as np
import pytest

from omnisyn_cli.geometry.regions import connected_regions


@pytest.mark.parametrize(("is_diagonal", "count"), [(True, 1), (False, 3)])
def test_corners_join_regions_only_where_they_are_asked_to(is_diagonal: bool, count: int) -> None:
    mask = np.zeros((4, 6), bool)
    mask[[0, 1, 2], [5, 0, 1]] = True  # a diagonal across the seam
    assert len(np.unique(connected_regions(mask, is_diagonal=is_diagonal)[mask])) == count


@pytest.mark.parametrize("is_diagonal", [True, False])
def test_turning_changes_no_region(is_diagonal: bool) -> None:
    rng = np.random.default_rng(2)
    for share in (0.2, 0.4, 0.6):
        mask = rng.random((30, 50)) < share
        found = connected_regions(mask, is_diagonal=is_diagonal)
        turned = np.roll(connected_regions(np.roll(mask, 17, axis=1), is_diagonal=is_diagonal), -17, axis=1)
        assert ((found > 0) == mask).all()
        pairs = np.unique(np.stack([found[mask], turned[mask]]), axis=1)
        assert len(pairs[0]) == len(np.unique(pairs[0])) == len(np.unique(pairs[1]))
