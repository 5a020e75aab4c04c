"""Descriptors in the costs of matches."""

from dataclasses import replace

import numpy as np
import pytest
from stereo_samples import OPENINGS, SIZE, room

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import rotated_directions, sample_nearest
from omnisyn_cli.runtime.image_networks import DescriptorSession
from omnisyn_cli.runtime.session import open_model
from omnisyn_cli.stereo.descriptor_costs import DESCRIPTOR_WEIGHT, HALF_COST_DISTANCE, add_to_volume, with_descriptors
from omnisyn_cli.stereo.disparity import MatchingOptions, match_all_disparities
from omnisyn_cli.stereo.rectify import rectify
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, DisparityRange

RNG = np.random.default_rng(0)
VIEWS = room(Pose.identity())[0], room(OPENINGS["oblique and turned"])[0]


@pytest.fixture(scope="module")
def shipped() -> DescriptorSession:
    return DescriptorSession(open_model("descriptors", threads=1))


def noise(view):
    return replace(view, image=RNG.random(view.image.shape, dtype=np.float32))


def test_the_cost_of_windows_and_distances_of_descriptors_are_mixed_where_there_is_a_second_image():
    pair = rectify(*VIEWS, (16, 32))
    usable = RNG.random((16, 32)) < 0.8
    own, other = RNG.normal(0.0, 1.0, (2, 16, 32, 5)).astype(np.float32)
    disparities = DisparityRange.from_bounds(RNG.integers(0, 3, (16, 32)).astype(np.int32), 6)
    windows = RNG.integers(0, FIXED_POINT_SCALE, disparities.offsets[-1]).astype(np.uint16)
    cost = windows.copy()
    add_to_volume(cost, replace(pair, second_usable=usable, descriptors=(own, other)), disparities)
    for row, col in np.ndindex(16, 32):
        begin, end = disparities.offsets[row * 32 + col : row * 32 + col + 2]
        for k in range(begin, end):
            target = row + disparities.lowest[row, col] + k - begin
            expected = float(windows[k])
            if target < 16 and usable[target, col]:
                distance = float(np.square(own[row, col] - other[target, col]).sum())
                of_descriptors = FIXED_POINT_SCALE * distance / (distance + HALF_COST_DISTANCE)
                expected += DESCRIPTOR_WEIGHT * (of_descriptors - expected)
            assert abs(float(cost[k]) - expected) < 0.6


def test_descriptors_find_what_windows_do_not():
    """Pictures of noise have nothing to compare; descriptors made of the true geometry have."""
    first, second = room(Pose.identity())[0], room(OPENINGS["level"])[0]
    size = SIZE[0] // 2, SIZE[1] // 2
    pair, plain = rectify(first, second, size), rectify(noise(first), noise(second), size)
    known = [np.concatenate([4.0 * each, np.square(2.0 * each)], axis=-1) for each in (pair.first, pair.second)]
    exact = match_all_disparities(pair, MatchingOptions()).disparity
    for descriptors, least, most in ((None, 0.0, 0.2), ((known[0], known[1]), 0.7, 1.0)):
        found = match_all_disparities(replace(plain, descriptors=descriptors), MatchingOptions()).disparity
        assert least <= np.mean(np.abs(found - exact) < 1.5) <= most


def test_swapping_the_inputs_swaps_the_descriptors(shipped):
    size = SIZE[0] // 2, SIZE[1] // 2
    forth = with_descriptors(rectify(*VIEWS, size), *VIEWS, shipped)
    back = with_descriptors(rectify(*VIEWS[::-1], size), *VIEWS[::-1], shipped).reversed()
    for one, other in zip(forth.descriptors, back.descriptors, strict=True):
        assert one.shape == (*size, 24)
        assert np.abs(one - other).mean() < 0.01 * np.abs(one).mean()


def test_more_of_a_room_is_matched_with_the_shipped_network(shipped):
    """From ends that are farther apart than the walls, in other light."""
    pose = Pose(np.eye(3), np.array([2.5, 0.2, -3.5]))
    (first, truth), second = room(Pose.identity()), room(pose)[0]
    views = first, replace(second, image=(0.7 * second.image) ** 1.1)
    pair = rectify(*views, (SIZE[0] // 2, SIZE[1] // 2))
    directions = rotated_directions(pair.size, np.eye(3), pair.world_from_frame)
    exact = pair.grid.disparity(sample_nearest(truth, directions) * pair.baseline)
    shares = [
        np.mean(np.abs(match_all_disparities(each, MatchingOptions()).disparity - exact) < 1.5)
        for each in (pair, with_descriptors(pair, *views, shipped))
    ]
    assert shares[1] > shares[0] + 0.03
