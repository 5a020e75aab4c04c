"""In a tour the depth of a panorama comes from both its neighbours, once, whichever way the tour is walked."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.synthesis.chain_depth import ChainDepth, PairDepth, fuse_depth
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import DepthEstimate, DepthEstimator, KnownDepth, View
from synthesis_samples import SIZE, hall_view, posed

WALK = [posed((0.0, 0.0, 0.9)), posed((0.1, 0.0, 0.0), 0.3), posed((0.8, 0.1, -0.4), 0.5), posed((1.2, 0.0, -1.3), 0.1)]


def grey_view(position: Sequence[float]) -> View:
    """Nothing in it tells right distances from wrong ones."""
    return View(np.full((*SIZE, 3), 0.5, np.float32), posed(position))


def everywhere(rho: float | np.ndarray, confidence: float) -> DepthEstimate:
    return DepthEstimate(np.full(SIZE, rho, np.float32), np.full(SIZE, confidence, np.float32))


def opinions(
    *depths: DepthEstimate,
    views: Sequence[View] | None = None,
    others: Sequence[Sequence[float]] = ((0, 0, 1), (0, 0, -1)),
) -> tuple[PairDepth, ...]:
    """Of the second of three views, by comparison with the first and the last."""
    before, own, after = views or [grey_view(others[0]), grey_view((0, 0, 0)), grey_view(others[1])]
    usable = np.ones((*SIZE, 1), np.float32)
    return tuple(
        PairDepth(depth, own.image, np.dstack([other.image, usable]), other.pose.inverse() @ own.pose)
        for depth, other in zip(depths, (before, after), strict=True)
    )


def guesses(seed: int) -> DepthEstimate:
    rng = np.random.default_rng(seed)
    rho = 0.3 + 0.02 * rng.random(SIZE) + (rng.random(SIZE) < 0.3)
    return DepthEstimate(rho.astype(np.float32), rng.random(SIZE).astype(np.float32))


def disturbed(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
    """The truth with errors of its own for every pair, the same whichever way round it is asked for."""
    found = []
    for view, other in ((first, second), (second, first)):
        rng = np.random.default_rng(int(1000 * np.abs(view.pose.position - 3 * other.pose.position).sum()))
        rho = np.full(SIZE, 0.25) * (1 + 0.02 * rng.standard_normal(SIZE)) + (rng.random(SIZE) < 0.2)
        found.append(DepthEstimate(rho.astype(np.float32), rng.random(SIZE).astype(np.float32)))
    return found[0], found[1]


class Counted:
    def __init__(self, estimator: DepthEstimator) -> None:
        self._estimator, self.asked = estimator, 0

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        self.asked += 1
        return self._estimator(first, second)


def tour_of(views: Sequence[View], estimator: DepthEstimator) -> ChainDepth:
    return ChainDepth(views, estimator, Stopwatch(), 1)


def assert_equal(one: DepthEstimate, other: DepthEstimate) -> None:
    np.testing.assert_array_equal(one.inverse_depth, other.inverse_depth)
    np.testing.assert_array_equal(one.confidence, other.confidence)


def test_joining_an_estimate_with_itself_changes_nothing() -> None:
    assert_equal(fuse_depth(*opinions(guesses(1), guesses(1))), guesses(1))


def test_the_order_of_both_opinions_is_nothing() -> None:
    one, other = opinions(guesses(1), guesses(2), others=((0, 0, 1), (0.3, 0.1, -0.5)))
    assert_equal(fuse_depth(one, other), fuse_depth(other, one))


@pytest.mark.parametrize("right", [0.301, 0.9], ids=["they agree", "they contradict each other"])
def test_where_one_knows_nothing_the_other_stands(right: float) -> None:
    for both in ((everywhere(0.3, 0.0), everywhere(right, 0.4)), (everywhere(right, 0.4), everywhere(0.3, 0.0))):
        found = fuse_depth(*opinions(*both))
        np.testing.assert_allclose(found.inverse_depth, right, rtol=1e-6)
        np.testing.assert_allclose(found.confidence, 0.4)


def test_the_surer_one_stands_where_they_contradict_each_other_and_colours_say_nothing() -> None:
    found = fuse_depth(*opinions(everywhere(0.3, 0.4), everywhere(0.5, 0.6)))
    np.testing.assert_array_equal(found.inverse_depth, np.float32(0.5))
    np.testing.assert_array_equal(found.confidence, np.float32(0.6))


def test_in_a_mean_each_counts_by_the_square_of_its_parallax() -> None:
    """Neighbours 1 m ahead and 2 m aside: each is blind along its own axis, the farther one more exact."""
    found = fuse_depth(*opinions(everywhere(0.5, 0.8), everywhere(0.51, 0.8), others=((0, 0, -1), (2, 0, 0))))
    directions = pixel_directions(*SIZE)
    ahead, aside = 1 - directions[..., 2] ** 2, 4 * (1 - directions[..., 0] ** 2)
    np.testing.assert_allclose(found.inverse_depth, (0.5 * ahead + 0.51 * aside) / (ahead + aside), rtol=1e-5)


def test_colours_overrule_confidence_where_one_neighbour_at_least_shows_them() -> None:
    """The walls of the hall as they are against walls too near; one neighbour sees something else, which is no harm."""
    views = [hall_view(pose) for pose in WALK[:3]]
    truth = views[1].known_depth
    wrong = DepthEstimate(2.0 * truth.inverse_depth, np.full(SIZE, 0.9, np.float32))
    unsure = replace(truth, confidence=np.full(SIZE, 0.5, np.float32))
    views[2] = replace(views[2], image=np.zeros_like(views[2].image))
    found = fuse_depth(*opinions(wrong, unsure, views=views))
    assert (found.inverse_depth == truth.inverse_depth).mean() > 0.8


def test_estimates_of_two_sizes_meet_at_the_larger_one() -> None:
    """The smaller one is nearest-neighbour, right way up and round: its upper left quarter is the surer one."""
    small, sure = np.full((16, 32), 0.9, np.float32), np.zeros((16, 32), np.float32)
    sure[:8, :16] = 0.8
    found = fuse_depth(*opinions(DepthEstimate(small, sure), everywhere(0.2, 0.5)))
    expected = np.full(SIZE, 0.2, np.float32)
    expected[:32, :64] = 0.9
    np.testing.assert_array_equal(found.inverse_depth, expected)


def test_depth_depends_neither_on_what_was_asked_for_before_nor_on_the_direction() -> None:
    views = [hall_view(pose) for pose in WALK]
    there, back = tour_of(views, disturbed), tour_of(views[::-1], disturbed)
    for index in (2, 0, 1, 1):
        alone_pair, again_pair = tour_of(views, disturbed)(index), back(2 - index)[::-1]
        for depth, alone, again in zip(there(index), alone_pair, again_pair, strict=True):
            assert_equal(depth, alone)
            assert_equal(depth, again)


def test_every_pair_is_compared_once_and_both_sides_of_a_panorama_have_one_depth() -> None:
    views, estimator = [hall_view(pose) for pose in WALK], Counted(disturbed)
    tour = tour_of(views, estimator)
    pairs = [tour(index) for index in range(3)]
    assert estimator.asked == 3
    assert all(before[1] is after[0] for before, after in pairwise(pairs))
    assert_equal(pairs[0][0], disturbed(*views[:2])[0])


def test_a_long_tour_is_looked_at_one_pair_ahead() -> None:
    """And nothing is kept of what lies behind."""
    views, estimator = [hall_view(posed((0.1 * k, 0, 0))) for k in range(9)], Counted(disturbed)
    tour = tour_of(views, estimator)
    for index in range(5):
        tour(index)
        assert estimator.asked == index + 2
        assert len(tour._known) + len(tour._pair_depths) <= 3


def test_a_pair_alone_has_what_its_estimator_found() -> None:
    views, found = [hall_view(pose) for pose in WALK[:2]], (guesses(1), guesses(2))
    depths = tour_of(views, lambda *_: found)(0)
    assert depths[0] is found[0]
    assert depths[1] is found[1]


def test_known_depth_is_left_alone() -> None:
    views = [hall_view(pose) for pose in WALK[:3]]
    assert all(
        depth is view.known_depth for depth, view in zip(tour_of(views, KnownDepth())(1), views[1:], strict=True)
    )


@pytest.mark.parametrize("still", [0, 1])
def test_a_neighbour_at_one_place_says_nothing(still: int) -> None:
    poses = [WALK[0], WALK[0], WALK[1]] if still == 0 else [WALK[0], WALK[1], WALK[1]]
    views = [hall_view(pose) for pose in poses]
    depths = tour_of(views, disturbed)(1 - still)
    for depth, alone in zip(depths, disturbed(views[1 - still], views[2 - still]), strict=True):
        assert_equal(depth, alone)


def test_frames_on_both_sides_are_made_of_the_joined_depth() -> None:
    """Each pair is wrong of half of the middle panorama, and knows that; together they are right, as frames show."""
    views = [hall_view(pose) for pose in WALK[:3]]
    left = np.arange(SIZE[1]) < SIZE[1] // 2

    def half_blind(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        answers = []
        for view in (first, second):
            truth = view.known_depth
            if view is not views[1]:
                answers.append(truth)
                continue
            knows = np.broadcast_to(left if first is views[0] else ~left, SIZE).astype(np.float32)
            answers.append(DepthEstimate(np.where(knows > 0, truth.inverse_depth, 0.9).astype(np.float32), knows))
        return answers[0], answers[1]

    def frames(estimator: Callable[[View, View], tuple[DepthEstimate, DepthEstimate]]) -> list[np.ndarray]:
        method = SurfaceMethod(estimator, SynthesisOptions(SIZE, threads=1))
        path = plan_path([view.pose for view in views], 5)
        return [np.array(frame.image) for frame in synthesize(views, path, method)]

    for made, right in zip(frames(half_blind), frames(KnownDepth()), strict=True):
        np.testing.assert_allclose(made, right, atol=0.02)


def test_at_a_crossing_all_neighbours_are_asked_once() -> None:
    """Three links meet at the second panorama; what two of them agree on stands, whatever the order of the links."""
    views = [hall_view(pose) for pose in WALK]
    estimator = Counted(disturbed)
    links = [(0, 1), (1, 2), (1, 3)]
    graph = ChainDepth(views, estimator, Stopwatch(), 1, links)
    crossing = [graph(index)[int(index == 0)] for index in range(3)]
    assert estimator.asked == 3
    assert crossing[0] is crossing[1] is crossing[2]
    other = ChainDepth(views, disturbed, Stopwatch(), 1, [(1, 3), (0, 1), (1, 2)])(0)[0]
    np.testing.assert_allclose(crossing[0].inverse_depth, other.inverse_depth, rtol=1e-5)
    off = np.abs(crossing[0].inverse_depth - 0.25)
    assert (off > 0.1).mean() < (np.abs(disturbed(views[1], views[2])[0].inverse_depth - 0.25) > 0.1).mean()
