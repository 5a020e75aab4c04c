"""Height above the floor: furniture, several pairs, cameras of different heights, and nothing below."""

from dataclasses import replace

import numpy as np
import pytest
from registration_samples import street_image, street_poses

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.poses.floor import FLOOR_SIZE, floor_heights, height_in_depth
from omnisyn_cli.scenes import generate_scene
from omnisyn_cli.types import DepthEstimate, View

HEIGHT, TABLE_HEIGHT, TILE = 1.5, 0.75, 0.07
COLOURS = np.random.default_rng(5).uniform(0.15, 0.85, (256, 256, 3)).astype(np.float32)


def view(x: float, rise: float = 0.0, table: tuple[float, float] | None = None, *, has_floor: bool = True) -> View:
    """A camera over speckled tiles under an even sky; a table stands between two values of x, 1.2 m deep."""
    pose = Pose(rotation_from_heading(3.0 * x), np.array([x, HEIGHT + rise, 0.0]))
    rays = pixel_directions(*FLOOR_SIZE) @ pose.rotation.T
    image = np.full((*FLOOR_SIZE, 3), 0.7, np.float32)
    for level, ends in ((0.0, None), (TABLE_HEIGHT, table)):
        if (level == 0.0 and not has_floor) or (level > 0.0 and ends is None):
            continue
        reach = (pose.position[1] - level) / np.maximum(-rays[..., 1], 1e-3)
        across, along = (pose.position[k] + reach * rays[..., k] for k in (0, 2))
        shown = (rays[..., 1] < -0.1) & (reach < 8.0)
        if ends is not None:
            shown &= (across > ends[0]) & (across < ends[1]) & (np.abs(along) < 0.6)
        cells = (np.floor(np.stack([across, along]) / TILE + 100.0 * level)).astype(int) % 256
        image[shown] = COLOURS[cells[0], cells[1]][shown]
    return View(image, pose)


def test_the_ground_of_a_street_is_as_far_below_as_it_is():
    ground, views = generate_scene("street", 101).ground, [View(street_image(k), street_poses()[k]) for k in range(2)]
    height = float(np.mean([ground[:3] @ each.pose.position - ground[3] for each in views]))
    assert floor_heights([(views[0], views[1])]) == pytest.approx([height], rel=0.03)


def test_the_floor_is_found_below_a_table():
    first, second = (view(x, table=(0.8, 2.0)) for x in (0.0, 1.0))
    assert floor_heights([(first, second)]) == pytest.approx([HEIGHT], rel=0.02)


def test_of_a_set_the_level_that_most_pairs_see_is_the_floor():
    """The second pair sees a table and no floor: alone it takes the one for the other, in the set it does not count."""
    on_table = tuple(view(x, table=(-9.0, 9.0), has_floor=False) for x in (1.0, 1.6))
    others = [tuple(view(x + k) for x in (0.0, 0.8)) for k in range(2)]
    assert floor_heights([on_table]) == pytest.approx([HEIGHT - TABLE_HEIGHT], rel=0.02)
    assert floor_heights([others[0], on_table, others[1]]) == pytest.approx([HEIGHT, HEIGHT], rel=0.02)


def test_of_cameras_of_different_heights_the_mean_counts():
    assert floor_heights([(view(0.0), view(1.0, rise=0.2))]) == pytest.approx([HEIGHT + 0.1], rel=0.02)


def depth_of(pose: Pose, level: float) -> DepthEstimate:
    """What a camera measures of a floor at a level, with a box of 0.8 m in front, up to the horizon."""
    rays = pixel_directions(*FLOOR_SIZE) @ pose.rotation.T
    box = (np.abs(rays[..., 0]) < 0.3) & (rays[..., 2] < 0.0)
    below = pose.position[1] - np.where(box, level + 0.8, level)
    inverse_depth = (np.maximum(-rays[..., 1], 0.0) / below).astype(np.float32)
    return DepthEstimate(inverse_depth, np.ones(FLOOR_SIZE, np.float32))


def test_depth_shows_the_floor_if_both_panoramas_agree():
    poses = [Pose(rotation_from_rotation_vector(np.array([0.2, k, 0.1])), np.array([0.0, y, 0.0])) for k, y in
             enumerate((1.5, 1.7))]  # fmt: skip
    first, second, lower = depth_of(poses[0], 0.0), depth_of(poses[1], 0.0), depth_of(poses[1], -0.4)
    assert height_in_depth(tuple(poses), (first, second)) == pytest.approx(1.6, rel=0.01)
    assert height_in_depth(tuple(poses), (first, lower)) is None
    unknown = replace(second, confidence=np.zeros_like(second.confidence))
    assert height_in_depth(tuple(poses), (first, unknown)) is None


def test_without_a_floor_there_is_no_height():
    assert floor_heights([(view(0.0, has_floor=False), view(1.0, has_floor=False))]) == []
    assert floor_heights([(view(0.0), view(0.0))]) == []
