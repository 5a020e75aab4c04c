"""The limit holds inside, is gone afterwards, and changes no result."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stereo_samples import OPENINGS, room

from omnisyn_cli.compute.threads import allowed_threads, both, limited_threads, run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.stereo import matching_estimator
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions

SMALL = MatchingOptions(size=(96, 192))


def counts() -> tuple[int, int]:
    return allowed_threads(), cv2.getNumThreads()


def test_the_limit_holds_inside_and_is_gone_after_a_failure() -> None:
    before = counts()

    def fail() -> None:
        with limited_threads(1):
            assert counts() == (1, 1)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert counts() == before


@pytest.mark.parametrize("threads", [None, 10_000])
def test_a_limit_above_what_there_is_changes_nothing(threads: int | None) -> None:
    before = counts()
    with limited_threads(threads):
        assert counts() == before


def test_limits_lie_within_each_other_and_loops_keep_to_them() -> None:
    """A band per thread would be handed to a pool; on one thread there is a single plain call."""
    calls: list[tuple[int, int]] = []
    with limited_threads(1), limited_threads(2):
        assert counts() == (1, 1)
        run_ranges(lambda begin, end: calls.append((begin, end)), 100)
    assert calls == [(0, 100)]


def test_there_is_at_least_one_thread() -> None:
    with pytest.raises(ValueError, match="got 0"), limited_threads(0):
        pass


def test_an_estimate_keeps_to_its_threads_and_does_not_depend_on_them(monkeypatch: pytest.MonkeyPatch) -> None:
    views = room(Pose.identity(), SMALL.size)[0], room(OPENINGS["level"], SMALL.size)[0]
    seen = []
    plain = matching_estimator.fill_with_planes
    monkeypatch.setattr(matching_estimator, "fill_with_planes", lambda *a: seen.append(counts()) or plain(*a))
    many = MatchingDepthEstimator(SMALL)
    for free, limited in zip(many(*views), replace(many, threads=1)(*views), strict=True):
        np.testing.assert_array_equal(free.inverse_depth, limited.inverse_depth)
        np.testing.assert_array_equal(free.confidence, limited.confidence)
    assert seen == [counts()] * 2 + [(1, 1)] * 2


@pytest.mark.parametrize("threads", [1, None])
def test_both_are_done_under_the_limit_and_failures_are_told(threads: int | None) -> None:
    with limited_threads(threads):
        inside = allowed_threads()
        assert both(allowed_threads, allowed_threads) == (inside, inside)
        with pytest.raises(ZeroDivisionError):
            both(lambda: 1, lambda: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            both(lambda: 1 // 0, lambda: 1)
