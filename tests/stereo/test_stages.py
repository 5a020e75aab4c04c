import numpy as np
import pytest
from stereo_samples import HALF_ROOM, OPENINGS, SIZE, room

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.stereo import costs
from omnisyn_cli.stereo.filling import fill_with_planes, fitted_values, normal_equations
from omnisyn_cli.stereo.map_filters import joint_upsample, remove_speckles
from omnisyn_cli.stereo.matching_estimator import find_sky
from omnisyn_cli.stereo.plane_fitting import PlanePoints, find_planes, planes_from_second
from omnisyn_cli.stereo.rectify import rectify
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, DisparityRange
from omnisyn_cli.stereo.surface_labels import _floor_and_ceiling_bound, _smoothed_support

SMALL = (48, 96)
RNG = np.random.default_rng(3)
FLOOR = np.array([0.05, -0.6, 0.1])
NO_POINTS = PlanePoints(np.zeros((0, 3)), *(np.zeros(0) for _ in range(3)), *(np.zeros(0, int) for _ in range(2)))


def plane(size: tuple[int, int], normal: np.ndarray) -> np.ndarray:
    return np.maximum(pixel_directions(*size) @ normal, 0.0)


@pytest.mark.parametrize("name", OPENINGS)
def test_rectified_matches_lie_in_one_column_where_the_true_depth_says(name: str) -> None:
    first, second = room(Pose.identity())[0], room(OPENINGS[name])[0]
    pair = rectify(first, second, SIZE)
    grid = pair.grid
    to_camera = grid.directions @ pair.world_from_frame.T
    with np.errstate(divide="ignore"):
        depth = (np.sign(to_camera) * HALF_ROOM / to_camera).min(axis=-1)
    target = np.arange(SIZE[0])[:, None] + grid.disparity(pair.baseline / depth)
    below = np.clip(np.rint(target), 0, SIZE[0] - 1).astype(int)
    found = np.take_along_axis(pair.second, below[..., None], axis=0)
    assert np.median(np.abs(found - pair.first)) < 0.03


def test_a_pair_seen_from_its_second_panorama_twice_is_the_pair() -> None:
    pair = rectify(room(Pose.identity())[0], room(OPENINGS["level"])[0], SMALL)
    again = pair.reversed().reversed()
    np.testing.assert_array_equal(again.first, pair.first)
    np.testing.assert_allclose(again.world_from_frame, pair.world_from_frame)
    swapped = rectify(room(OPENINGS["level"])[0], room(Pose.identity())[0], SMALL)
    np.testing.assert_allclose(swapped.first, pair.reversed().first, atol=1e-5)


def test_disparity_and_inverse_depth_are_each_others_inverse() -> None:
    pair = rectify(room(Pose.identity())[0], room(OPENINGS["oblique and turned"])[0], SMALL)
    grid = pair.grid
    inverse_depth = RNG.uniform(0.0, 2.0, SMALL)
    np.testing.assert_allclose(grid.inverse_depth(grid.disparity(inverse_depth)), inverse_depth, rtol=1e-3, atol=1e-4)


def test_bits_of_a_signature_are_neighbours_row_after_row() -> None:
    grey = RNG.random((9, 11)).astype(np.float32)
    windows = np.pad(np.pad(grey, ((3, 3), (0, 0)), mode="edge"), ((0, 0), (3, 3)), mode="wrap")
    expected = np.zeros(grey.shape, np.uint64)
    for k in [k for k in range(49) if k != 24]:
        brighter = windows[k // 7 :, k % 7 :][:9, :11] > grey + costs.CENSUS_NOISE
        expected = (expected << np.uint64(1)) | brighter.astype(np.uint64)
    np.testing.assert_array_equal(costs.census_transform(grey), expected)


def test_a_surface_costs_what_the_sweep_says_at_its_disparity() -> None:
    first, second = RNG.random((2, *SMALL, 3)).astype(np.float32)
    usable, zero = np.ones(SMALL, bool), np.zeros(SMALL, np.float32)
    ranges = DisparityRange.from_bounds(np.zeros(SMALL, np.int32), 5)
    sweep = costs.cost_volume(first, second, usable, ranges, 0.5, 0.3).reshape(*SMALL, 6)
    surface = costs.surface_cost(
        first, costs.census_transform(first.sum(-1) / np.float32(3)), second, usable, zero + 4, 0.5, 0.3
    )
    inside = slice(4, SMALL[0] - 10)
    np.testing.assert_allclose(surface[inside], sweep[inside, :, 4] / FIXED_POINT_SCALE, atol=0.6 / FIXED_POINT_SCALE)


def test_a_surface_costs_what_plain_loops_say() -> None:
    size = (12, 9)
    first, second = RNG.random((2, *size, 3)).astype(np.float32)
    usable, disparity = RNG.random(size) > 0.1, RNG.uniform(-2.0, 12.0, size).astype(np.float32)
    warped, seen = np.zeros_like(first), np.zeros(size, bool)
    for row, col in np.ndindex(size):
        target = row + float(disparity[row, col])
        if disparity[row, col] >= 0 and target <= 11:
            r = min(int(target), 10)
            share, seen[row, col] = target - r, usable[r, col] and usable[r + 1, col]
            warped[row, col] = (1 - share) * second[r, col] + share * second[r + 1, col]
    own, other = costs.census_transform(first.mean(-1)), costs.census_transform(warped.mean(-1))
    bits = np.unpackbits((own ^ other).view(np.uint8), axis=-1).reshape(*size, 64).sum(-1)
    colour = np.minimum(np.abs(first - warped).mean(-1) / 0.1, 1.0)
    expected = np.where(seen, 0.7 * np.minimum(bits / 24, 1.0) + 0.3 * colour, costs.OUT_OF_VIEW_COST)
    found = costs.surface_cost(first, own, second, usable, disparity, 0.3, 0.1)
    np.testing.assert_allclose(found, np.where(disparity < 0, costs.INVALID_COST, expected), atol=1e-5)


@pytest.mark.parametrize("is_second", [False, True])
def test_planes_are_found_among_outliers_in_points_of_either_camera(is_second: bool) -> None:
    up, directions = np.array([0.0, 0.0, 1.0]), pixel_directions(*SMALL).reshape(-1, 3)
    normals = np.array([-0.6 * up, [0.3, 0.2, 0.0], [-0.2, -0.4, 0.1]])  # none passes between the cameras
    inverse_depth = np.max(directions @ (planes_from_second(normals) if is_second else normals).T, axis=1)
    wrong = RNG.random(len(directions)) < 0.1
    inverse_depth[wrong] = RNG.uniform(0.1, 1.0, int(wrong.sum()))
    seen = np.flatnonzero(inverse_depth > 0.05)
    row, col = np.unravel_index(seen, SMALL)
    area = solid_angles(*SMALL).ravel()[seen]
    points = PlanePoints(directions[seen], inverse_depth[seen], np.full(len(seen), 0.003), area, row, col)
    both = (NO_POINTS, points) if is_second else (points, NO_POINTS)
    found = find_planes(both, up, max_planes=6, min_support=0.05)
    for normal in normals:
        assert np.abs(found - normal).max(axis=1).min() < 2e-3


def test_too_few_points_make_no_plane() -> None:
    assert find_planes((NO_POINTS, NO_POINTS), FLOOR, max_planes=3, min_support=0.1).shape == (0, 3)


def test_filling_leaves_what_is_known_and_stays_within_it() -> None:
    values, weight = RNG.random(SMALL), (RNG.random(SMALL) < 0.3).astype(float)
    filled = fill_with_planes(values, weight, RNG.random((*SMALL, 3)))
    known = weight == 1
    np.testing.assert_array_equal(filled[known], values[known].astype(np.float32))
    assert filled.min() >= np.float32(values[known].min())
    assert filled.max() <= np.float32(values[known].max())


def test_filling_carries_a_plane_across_a_hole() -> None:
    truth = plane((96, 192), np.array([0.2, 0.05, -0.6])) + 0.0
    weight = np.ones(truth.shape)
    weight[40:60, 85:110] = 0.0
    filled = fill_with_planes(np.where(weight > 0, truth, 9.0), weight, np.full((*truth.shape, 3), 0.5))
    np.testing.assert_allclose(filled[40:60, 85:110], truth[40:60, 85:110], rtol=0.03)


def test_filling_stops_at_edges_of_the_image() -> None:
    guide = np.zeros((*SMALL, 3))
    guide[:, 30:60] = 1.0
    weight = np.zeros(SMALL)
    weight[10:40:6, 5:95:6] = 1.0
    filled = fill_with_planes(np.where(guide[..., 0] > 0, 0.8, 0.1), weight, guide)
    assert abs(np.median(filled[12:36, 32:58]) - 0.8) < 0.08
    assert abs(np.median(filled[12:36, 64:90]) - 0.1) < 0.08


def test_filling_has_no_seam() -> None:
    values, guide = RNG.random(SMALL), RNG.random((*SMALL, 3))
    weight = (RNG.random(SMALL) < 0.2).astype(float)
    before = fill_with_planes(values, weight, guide)
    after = fill_with_planes(np.roll(values, 40, axis=1), np.roll(weight, 40, axis=1), np.roll(guide, 40, axis=1))
    # directions turn with the columns, a plane fit does not mind
    np.testing.assert_allclose(np.roll(before, 40, axis=1), after, atol=2e-3)


def test_filling_from_nothing_is_zero() -> None:
    assert not fill_with_planes(np.ones(SMALL), np.full(SMALL, 0.5), np.zeros((*SMALL, 3))).any()


def test_speckles_go_and_surfaces_stay_also_across_the_seam() -> None:
    values, known = np.full(SMALL, 0.5), np.ones(SMALL, bool)
    values[20:22, 20:22] = 2.0
    values[30:34, :4] = values[30:34, -4:] = 2.0
    kept = remove_speckles(values, known)
    assert not kept[20:22, 20:22].any()
    assert kept[30:34, :4].all()
    assert kept.sum() == known.sum() - 4


def test_upsampling_keeps_constants_and_moves_edges_to_the_image() -> None:
    guide = np.zeros((96, 192, 3), np.float32)
    guide[:, 101:160] = 1.0
    low_guide = guide.reshape(48, 2, 96, 2, 3).mean(axis=(1, 3))
    low = np.where(np.arange(96) < 49, 0.2, 1.0) * np.ones((48, 1))
    low[:, 80:] = 0.2
    high = joint_upsample(low, low_guide, guide)
    np.testing.assert_allclose(joint_upsample(np.full((48, 96), 0.3), low_guide, guide), 0.3, rtol=1e-5)
    np.testing.assert_allclose(high[:, 90:100], 0.2, rtol=1e-4)
    np.testing.assert_allclose(high[:, 102:158], 1.0, rtol=1e-4)


def test_sky_needs_the_zenith_and_texture() -> None:
    sin_elevation, solid_angle = pixel_directions(*SMALL)[..., 1], solid_angles(*SMALL)
    inverse_depth = np.where(sin_elevation > 0.1, 0.0, 0.5)
    valid = RNG.random(SMALL) < 0.3
    np.testing.assert_array_equal(find_sky(inverse_depth, valid, sin_elevation, solid_angle), sin_elevation > 0.1)
    assert not find_sky(inverse_depth, np.zeros(SMALL, bool), sin_elevation, solid_angle).any()
    window = np.where((sin_elevation > 0.2) & (sin_elevation < 0.5), 0.0, 0.5)
    assert not find_sky(window, valid, sin_elevation, solid_angle).any()


@pytest.mark.parametrize("size", [(48, 96), (50, 100), (3, 6)])
def test_support_knows_no_seam_at_any_width(size: tuple[int, int]) -> None:
    mask = RNG.random(size) < 0.1
    for columns in (1, size[1] // 2):
        rolled = _smoothed_support(np.roll(mask, columns, axis=1))
        np.testing.assert_allclose(rolled, np.roll(_smoothed_support(mask), columns, axis=1), atol=1e-5)


@pytest.mark.parametrize("size", [(6, 12), (8, 16), (24, 48)])
def test_resizing_averages_over_the_area_of_a_new_pixel(size: tuple[int, int]) -> None:
    image = RNG.random((12, 24)).astype(np.float32)
    fine = np.kron(image, np.ones((4, 4)))
    factor = 48 // size[0]
    blocks = fine.reshape(size[0], factor, size[1], factor).mean(axis=(1, 3))
    np.testing.assert_allclose(resize_area(image, size), blocks, rtol=1e-5)


@pytest.mark.parametrize("name", OPENINGS)
def test_nothing_is_beyond_the_floor_nor_unless_the_sky_is_open_the_ceiling(name: str) -> None:
    """Of level planes the first, which is the best supported one, is taken; walls bound nothing."""
    grid = rectify(room(Pose.identity())[0], room(OPENINGS[name])[0], SMALL).grid
    wall = np.cross(grid.up, [0.3, 0.5, 0.8])
    planes = np.array([wall, 2.0 * grid.up, 0.5 * grid.up, -1.5 * grid.up])
    for is_sky_open in (False, True):
        bound = _floor_and_ceiling_bound(grid, planes, is_sky_open=is_sky_open)
        for normal in (-1.5 * grid.up, 2.0 * grid.up):
            inverse_depth = grid.directions @ normal
            is_bounded = not (is_sky_open and normal @ grid.up > 0)
            steep = (grid.disparity(inverse_depth) > 4.0) & (np.sin(grid.polar_angle) > 0.5)
            farther, same = (grid.disparity(share * inverse_depth) < bound for share in (0.5, 1.0))
            assert (farther[steep] == is_bounded).all()
            assert not same[inverse_depth > 0].any()


FALLBACK_WEIGHT, TILT_RIDGE = 1e-3, 0.05
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
DIRECTIONS = pixel_directions(8, 16)


def solved(sums: np.ndarray, fallback: np.ndarray) -> np.ndarray:
    """The same with matrices."""
    matrix = np.empty((*fallback.shape, 3, 3))
    for k, (i, j) in enumerate(PAIRS):
        matrix[..., i, j] = matrix[..., j, i] = sums[..., k]
    amount = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
    along = DIRECTIONS[..., :, None] * DIRECTIONS[..., None, :]
    matrix += FALLBACK_WEIGHT * along + (TILT_RIDGE * amount + 1e-9) * (np.eye(3) - along)
    vector = sums[..., 6:] + FALLBACK_WEIGHT * fallback[..., None] * DIRECTIONS
    return (np.linalg.solve(matrix, vector[..., None])[..., 0] * DIRECTIONS).sum(axis=-1)


@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_a_fit_is_that_of_the_solver(share: float) -> None:
    """Nothing known, little and everything, summed over all pixels and over each alone."""
    rng = np.random.default_rng(7)
    values, fallback = rng.random((2, 8, 16))
    weight = rng.random((8, 16)) * (rng.random((8, 16)) < share)
    own = normal_equations(values, weight, DIRECTIONS)
    everywhere = np.broadcast_to(own.sum(axis=(0, 1)), own.shape)
    for sums in (own, np.ascontiguousarray(everywhere)):
        found = fitted_values(sums, fallback, DIRECTIONS, FALLBACK_WEIGHT, TILT_RIDGE)
        np.testing.assert_allclose(found, solved(sums.astype(np.float64), fallback), rtol=1e-6, atol=1e-9)
    if share == 0.0:
        np.testing.assert_allclose(found, fallback, rtol=1e-9)


def test_a_plane_is_found_from_all_of_its_pixels() -> None:
    values, weight = DIRECTIONS @ np.array([0.3, -0.2, 0.5]), np.ones((8, 16))
    sums = normal_equations(values, weight, DIRECTIONS)
    np.testing.assert_allclose(sums[..., 6:], values[..., None] * DIRECTIONS, rtol=1e-6)
    everywhere = np.ascontiguousarray(np.broadcast_to(sums.sum(axis=(0, 1)), sums.shape))
    found = fitted_values(everywhere, np.zeros((8, 16)), DIRECTIONS, 1e-9, 0.0)
    np.testing.assert_allclose(found, values, atol=1e-6)
