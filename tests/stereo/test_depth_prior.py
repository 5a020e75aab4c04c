"""What a network expects: what it is shown, what disparities then cost, and what becomes of floors and of gaps."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from tests.stereo.test_plane_sweep import texture, turn

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.stereo import matching_estimator
from omnisyn_cli.stereo.disparity import DisparityMap
from omnisyn_cli.stereo.expected_depth import at_best_scale, expected_planes, fill_as_expected, with_guided_priors
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.plane_sweep import sweep_directions
from omnisyn_cli.stereo.rectify import DepthPrior, rectify
from omnisyn_cli.stereo.refined_estimator import RefinedDepthEstimator
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, DisparityRange
from omnisyn_cli.stereo.surface_labels import CandidatePlanes, label_surfaces
from omnisyn_cli.types import View

SIZE = (256, 512)
ROOM = np.array([[-7.0, -1.6, -8.0], [6.0, 1.8, 5.0]])  # Lower and upper corner in metres; one camera is at the origin.
POSITIONS = np.array([0.4, 0.0, 0.9]), np.array([-0.6, 0.05, -3.2])
TILE = 0.55


def distance_to_wall(position: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Metres to the wall of the room along unit vectors, and along which axis it lies."""
    with np.errstate(divide="ignore"):
        reach = np.where(rays > 0, (ROOM[1] - position) / rays, (ROOM[0] - position) / rays)
    return reach.min(axis=-1), reach.argmin(axis=-1)


def photograph(position: np.ndarray, rotation: np.ndarray) -> View:
    """A view of the room: plain walls and ceiling with some texture, a floor of equal tiles."""
    rays = pixel_directions(*SIZE) @ rotation.T
    reach, axis = distance_to_wall(position, rays)
    points = position + rays * reach[..., None]
    image = np.zeros((*SIZE, 3))
    for k in range(3):
        on_axis = axis == k
        image[on_axis] = texture(np.delete(points, k, axis=-1), seed=k)[on_axis]
    is_floor = (axis == 1) & (rays[..., 1] < 0)
    tiles = (np.floor(points[..., 0] / TILE) + np.floor(points[..., 2] / TILE)) % 2
    image[is_floor] = (0.15 + 0.7 * tiles[..., None] * np.ones(3))[is_floor]
    return View(image.astype(np.float32), Pose(rotation, position))


def room_views() -> tuple[View, View]:
    """Two views of the room, tilted and turned."""
    up, side = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    return (
        photograph(POSITIONS[0], turn(up, 30.0) @ turn(side, 4.0)),
        photograph(POSITIONS[1], turn(up, -100.0) @ turn(side, -3.0)),
    )


views = pytest.fixture(room_views, scope="module")


class KnowsTheRoom:
    """A network that sees the room from where it is asked: depth is a factor off, its confidence as told."""

    def __init__(self, factor: float = 1.0, confidence: float = 0.9) -> None:
        self.factor, self.confidence = factor, confidence
        self.asked: list[tuple[np.ndarray, np.ndarray]] = []

    def __call__(self, first, second, towards):
        self.asked.append((first, towards))
        here = len(self.asked) == 1  # for the second panorama, then for the first one
        motion = POSITIONS[0] - POSITIONS[1] if here else POSITIONS[1] - POSITIONS[0]
        back = -motion * [1, 0, 1] / np.hypot(motion[0], motion[2])
        frame = np.stack([np.cross([0.0, 1.0, 0.0], back), [0.0, 1.0, 0.0], back], axis=1)
        reach, _ = distance_to_wall(POSITIONS[int(here)], pixel_directions(*first.shape[1:]) @ frame.T)
        unit = np.linalg.norm(motion) / np.linalg.norm(towards)
        inverse_depth = (unit / reach / self.factor).astype(np.float32)
        return inverse_depth, np.full(inverse_depth.shape, self.confidence, np.float32)


def true_disparity(pair, position: np.ndarray) -> np.ndarray:
    reach, _ = distance_to_wall(position, pair.grid.directions @ pair.world_from_frame.T)
    return pair.grid.disparity(pair.baseline / reach)


def test_the_network_sees_upright_panoramas_with_the_other_camera_ahead(views: tuple[View, View]) -> None:
    model = KnowsTheRoom()
    with_guided_priors(rectify(*views, SIZE), *views, model=model)
    assert [np.linalg.norm(towards) for _, towards in model.asked] == pytest.approx([1.5, 1.5])
    for image, towards in model.asked:
        assert abs(towards[0]) < 1e-6
        assert towards[2] < 0
        assert np.std(image[:, -40:]) > 0.25  # black and white tiles of the floor, in all columns alike: upright


def test_priors_are_in_the_frames_of_the_pair_and_of_its_reverse(views: tuple[View, View]) -> None:
    pair = with_guided_priors(rectify(*views, SIZE), *views, model=KnowsTheRoom())
    pairs = pair, pair.reversed(), pair.resized((128, 256))
    for each, position in zip(pairs, (*POSITIONS, POSITIONS[0]), strict=True):
        truth = true_disparity(each, position)
        assert np.quantile(each.prior.cost(truth), 0.99) == 0.0
        assert np.median(each.prior.cost(truth * 2.5 + 10)) == pytest.approx(0.4, abs=1e-6)


def with_places_as_descriptors(pair):
    """Descriptors that say which place of the room each pixel shows."""
    waves = np.random.default_rng(0).normal(0.0, 0.7, (3, 24))

    def described(position: np.ndarray) -> np.ndarray:
        rays = pair.grid.directions @ pair.world_from_frame.T
        places = position + rays * distance_to_wall(position, rays)[0][..., None]
        return (3.0 * np.cos(places @ waves + np.arange(24.0))).astype(np.float32)

    return replace(pair, descriptors=(described(POSITIONS[0]), described(POSITIONS[1])))


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_the_scale_of_a_prior_is_the_one_at_which_descriptors_agree(views: tuple[View, View], factor: float) -> None:
    guessed = with_guided_priors(rectify(*views, SIZE), *views, model=KnowsTheRoom(factor))
    assert at_best_scale(guessed) is guessed
    pair = at_best_scale(with_places_as_descriptors(guessed))
    for each, position in zip((pair, pair.reversed()), POSITIONS, strict=True):
        reach, _ = distance_to_wall(position, each.grid.directions @ each.world_from_frame.T)
        ratio = np.square(each.priors[0].sqrt_inv_depth) * reach / pair.baseline
        assert np.median(ratio) == pytest.approx(1.0, abs=0.08)
        assert each.are_priors_candidates
    exchanged = at_best_scale(with_places_as_descriptors(guessed).reversed()).reversed()
    np.testing.assert_array_equal(exchanged.priors, pair.priors)


def test_where_matches_are_wrong_pixels_lie_on_the_prior_at_the_scale_that_matches_there(views) -> None:
    pair = with_guided_priors(rectify(*views, SIZE), *views, model=KnowsTheRoom(1.16))
    none = DisparityMap(np.zeros(SIZE, np.float32), np.zeros(SIZE, bool))
    no_planes = CandidatePlanes(np.zeros((0, 3)), np.zeros(0, bool))
    for direction in (pair, replace(pair, are_priors_candidates=True).reversed()):
        found = label_surfaces(direction, none, no_planes, MatchingOptions())
        assert found.valid.mean() == pytest.approx(1.0 * direction.are_priors_candidates, abs=0.05)
    assert np.median(np.abs(found.disparity - true_disparity(direction, POSITIONS[1]))[found.valid]) < 0.5


def test_a_prior_that_is_not_sure_costs_nothing_and_one_that_guesses_tolerates_more(views: tuple[View, View]) -> None:
    pair = rectify(*views, SIZE)
    unsure = with_guided_priors(pair, *views, model=KnowsTheRoom(confidence=0.1))
    assert not unsure.prior.cost(np.zeros(SIZE, np.float32)).any()
    models = KnowsTheRoom(confidence=0.9), KnowsTheRoom(confidence=0.3)
    sure, guessed = (with_guided_priors(pair, *views, model=model).prior for model in models)
    assert np.median(guessed.upper - guessed.lower) > 1.5 * np.median(sure.upper - sure.lower)


def test_all_disparities_of_a_range_cost_what_single_surfaces_do() -> None:
    rng = np.random.default_rng(1)
    maps = [rng.uniform(low, high, (8, 16)).astype(np.float32) for low, high in ((0.2, 1.8), (0.05, 0.4), (0.0, 1.0))]
    grid = rectify(*flat_views(), (8, 16)).grid
    prior = DepthPrior(*maps).in_rows(grid)
    lowest = rng.integers(0, 3, (8, 16)).astype(np.int32)
    ranges = DisparityRange.from_bounds(lowest, lowest + 4)
    costs = np.full(ranges.offsets[-1], 100, np.uint16)
    prior.add_to(costs, ranges)
    each = costs.reshape(8, 16, 5)
    for k in range(5):
        expected = 100 + prior.cost((lowest + k).astype(np.float32)) * FIXED_POINT_SCALE
        assert np.abs(each[..., k] - expected).max() <= 0.51


def flat_views() -> tuple[View, View]:
    grey = np.full((8, 16, 3), 0.5, np.float32)
    return View(grey, Pose(np.eye(3), np.zeros(3))), View(grey, Pose(np.eye(3), np.array([0.0, 0.0, -1.0])))


def test_a_floor_of_equal_tiles_gets_its_height_from_what_is_expected(views: tuple[View, View]) -> None:
    options = MatchingOptions(size=SIZE)
    baseline = float(np.linalg.norm(POSITIONS[1] - POSITIONS[0]))

    def share_right(estimates) -> float:
        shares = []
        for view, estimate in zip(views, estimates, strict=True):
            rays = pixel_directions(*SIZE) @ view.pose.rotation.T
            reach, axis = distance_to_wall(view.pose.position, rays)
            is_floor = (axis == 1) & (rays[..., 1] < -0.4)
            shares.append(np.mean(np.abs(estimate.inverse_depth * reach - 1.0)[is_floor] < 0.04))
        return min(shares)

    assert baseline > 4.0
    expecting = MatchingDepthEstimator(options, prior=partial(with_guided_priors, model=KnowsTheRoom(factor=1.1)))
    assert share_right(MatchingDepthEstimator(options)(*views)) < 0.5
    assert share_right(expecting(*views)) > 0.9


def test_a_prior_that_matches_contradict_is_used_where_the_photographs_confirm_it(
    views: tuple[View, View], monkeypatch: pytest.MonkeyPatch
) -> None:
    class KnowsAnotherRoom(KnowsTheRoom):
        def __call__(self, first, second, towards):
            inverse_depth, confidence = super().__call__(first, second, towards)
            return inverse_depth * np.geomspace(0.02, 1.0, inverse_depth.shape[1], dtype=np.float32), confidence

    scaled: list[object] = []
    monkeypatch.setattr(matching_estimator, "at_best_scale", lambda pair: scaled.append(pair) or pair)
    right, wrong, without = (
        MatchingDepthEstimator(MatchingOptions(size=(256, 512)), prior=prior)
        for prior in (*(partial(with_guided_priors, model=model()) for model in (KnowsTheRoom, KnowsAnotherRoom)), None)
    )
    assert all(each.expected is not None for (pair,) in [[*right.candidates(*views)]] for each in pair)
    plain, expecting = wrong.candidates(*views)
    assert len(scaled) == 1  # of the wrong one alone
    for each, doubted, unasked in zip(plain, expecting, without.features(*views), strict=True):
        assert each.expected is None
        assert doubted.expected is not None
        np.testing.assert_array_equal(each.matched, unasked.matched)
    monkeypatch.setattr(MatchingDepthEstimator, "candidates", lambda *_: iter((plain, expecting)))
    for scores, chosen in (((0.5, 0.39), plain), ((0.5, 0.41), expecting), ((0.0, 0.0), expecting)):
        said = iter(scores)
        estimator = RefinedDepthEstimator(wrong, None, 0, lambda *_, said=said: next(said))
        found, other = estimator(*views), RefinedDepthEstimator(wrong, None, 0)._estimates(views, chosen)
        for one, two in zip(found, other, strict=True):
            np.testing.assert_array_equal(one.inverse_depth, two.inverse_depth)


def test_a_prior_that_nothing_came_of_costs_no_second_matching(views, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever asked for it; one that is used does."""
    match, asked = matching_estimator.match_all_disparities, []
    monkeypatch.setattr(matching_estimator, "match_all_disparities", lambda *each: asked.append(1) or match(*each))
    counts = []
    for prior in (lambda pair, *_: pair, partial(with_guided_priors, model=KnowsTheRoom())):
        MatchingDepthEstimator(MatchingOptions(size=(64, 128)), prior=prior).features(*views)
        counts.append(len(asked))
    assert counts == [2, 6]


def test_expected_planes_move_to_where_the_images_match(views: tuple[View, View]) -> None:
    pair, none_swept = rectify(*views, SIZE), np.zeros((0, 3))
    assert len(expected_planes(pair, sweep_directions(pair), none_swept)) == 0
    pair = with_guided_priors(pair, *views, model=KnowsTheRoom(factor=1.08))
    planes = expected_planes(pair, sweep_directions(pair), none_swept)
    for axis in range(3):
        for corner in ROOM:
            way = np.sign(corner[axis]) * np.eye(3)[axis] @ pair.world_from_frame
            true = way / (abs(corner[axis] - POSITIONS[0][axis]) / pair.baseline)
            nearest = min(np.linalg.norm(plane - true) / np.linalg.norm(true) for plane in planes)
            assert nearest < 0.12  # as expected at worst
            assert nearest < 0.02 or corner[axis] < -1.7 or axis == 1


def test_expected_floors_near_swept_ones_are_left_out_and_walls_are_not(views: tuple[View, View]) -> None:
    pair = with_guided_priors(rectify(*views, SIZE), *views, model=KnowsTheRoom())
    directions, (x, y, z) = sweep_directions(pair), np.eye(3) @ pair.world_from_frame
    planes = expected_planes(pair, directions, np.zeros((0, 3)))

    def facing(way: np.ndarray, planes: np.ndarray) -> np.ndarray:
        return planes[planes @ way > 0.97 * np.linalg.norm(planes, axis=-1)]

    floor, wall = facing(-y, planes)[0], facing(-z, planes)[0]
    near = expected_planes(pair, directions, 1.3 * np.stack([floor, wall]))
    assert len(facing(-y, near)) == 0
    for way in (x, y, z, -x, -z):
        np.testing.assert_array_equal(facing(way, near), facing(way, planes))
    far = expected_planes(pair, directions, 1.6 * floor[None])
    np.testing.assert_array_equal(far, planes)


def test_gaps_are_filled_with_what_is_expected_corrected_by_the_matches_around(views: tuple[View, View]) -> None:
    prior = partial(with_guided_priors, model=KnowsTheRoom(factor=1.25))
    features, _ = MatchingDepthEstimator(MatchingOptions(size=SIZE), prior=prior).features(*views)
    reach, _ = distance_to_wall(POSITIONS[0], pixel_directions(*features.matched.shape) @ views[0].pose.rotation.T)
    true = np.linalg.norm(POSITIONS[1] - POSITIONS[0]) / reach
    valid = np.zeros(true.shape, bool)
    valid[::3, ::5] = True
    scarce = replace(features, matched=np.where(valid, true, 9.0), left_right_consistent=valid)
    scarce = replace(scarce, sky=np.zeros_like(valid), filled=np.full(true.shape, 9.0))
    completed = np.where(valid, true, 0.01).astype(np.float32), np.full(true.shape, 0.3, np.float32)
    inverse_depth, confidence = fill_as_expected(scarce, completed)
    assert np.quantile(np.abs(inverse_depth / true - 1.0), 0.95) < 0.03
    assert np.array_equal(inverse_depth[valid], completed[0][valid])
    assert confidence[valid] == pytest.approx(0.3)
    assert confidence[~valid] == pytest.approx(0.9, abs=0.01)
    near = (1.1 * true).astype(np.float32)
    exact, _ = fill_as_expected(replace(scarce, filled=near), completed)
    assert np.mean(np.isclose(exact, near, rtol=1e-4)[~valid]) > 0.95  # a proposal that is near is taken as it is
    assert fill_as_expected(replace(scarce, expected=None), completed) is completed
