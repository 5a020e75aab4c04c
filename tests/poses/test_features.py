"""Features and the zenith on pictures; the floor below cameras; what may not be used is not looked at."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from registration_samples import street_image, street_matches, street_poses, street_truth, unit

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, rotation_angle, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import sample_bicubic
from omnisyn_cli.geometry.sphere import UP, direction_to_pixel, pixel_directions
from omnisyn_cli.io import write_image
from omnisyn_cli.io.images import outside_nadir
from omnisyn_cli.poses.estimation import PictureOptions, check_poses, estimate_poses
from omnisyn_cli.poses.file import PosedPanorama, PoseFile
from omnisyn_cli.poses.floor import (
    FLOOR_SIZE,
    floor_heights,
    height_above_points,
    height_in_depth,
    level_of_points,
    spread_above,
)
from omnisyn_cli.poses.gravity import find_lines, find_vertical
from omnisyn_cli.poses.registration.features import Matches, find_features, grey_of, match_features
from omnisyn_cli.poses.registration.least_squares import angle_between, direction_error, rotation_error
from omnisyn_cli.poses.registration.robust import estimate_relative_pose
from omnisyn_cli.poses.registration.scan import scan_panorama
from omnisyn_cli.scenes import generate_scene
from omnisyn_cli.types import DepthEstimate, View


@pytest.mark.parametrize("vector", [(0.0, 1.0, 0.0), (1.5, 0.3, -0.4)], ids=["yaw", "poles on the horizon"])
def test_turned_pictures_match_as_they_were_turned(vector):
    image, rotation = street_image(0), rotation_from_rotation_vector(np.array(vector))
    turned = sample_bicubic(image, pixel_directions(*image.shape[:2]) @ rotation.T)
    matches = match_features(*(find_features(grey_of(each)) for each in (image, turned)))
    off = matches.first - matches.second @ rotation.T
    pixels = angle_between(matches.first, matches.second @ rotation.T) / matches.pixel
    assert len(matches) > 200
    assert np.median(pixels) < 0.25
    right = pixels < 1.0
    assert right.mean() > 0.9
    assert np.abs(off[right].mean(axis=0)).max() / matches.pixel < 0.05  # no bias of a part of a pixel
    cap = np.abs(matches.first[right][:, 1]) > np.cos(np.radians(30))
    seam = np.abs(direction_to_pixel(matches.first[right], image.shape[:2])[1] - image.shape[1] / 2) > 246
    assert cap.sum() >= 3
    assert seam.sum() >= 3


def test_a_mask_keeps_features_away():
    image = street_image(0)
    usable = np.zeros(image.shape[:2], bool)
    usable[:, 100:300] = True
    row, col = direction_to_pixel(find_features(grey_of(image), usable).direction, usable.shape)
    assert len(row) > 50
    assert col.min() >= 99.5
    assert col.max() <= 299.5


def test_the_number_of_threads_changes_nothing():
    one, two = (find_features(grey_of(street_image(0)), threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one.direction, two.direction)
    np.testing.assert_array_equal(one.descriptor, two.descriptor)


def test_an_empty_picture_has_no_matches():
    nothing = find_features(grey_of(np.full((64, 128, 3), 0.5)))
    assert nothing.direction.shape == (0, 3)
    assert len(match_features(nothing, find_features(grey_of(street_image(0))))) == 0


def test_the_pose_of_a_generated_pair_is_found():
    """Cameras that are tilted and look different ways, exact truth."""
    estimate = estimate_relative_pose(street_matches())
    assert rotation_error(estimate.first_from_second, street_truth()) < np.radians(0.15)
    assert direction_error(estimate.first_from_second, street_truth()) < np.radians(0.5)


@pytest.mark.parametrize("seed", range(3))
def test_vertical_lines_are_found_among_twice_as_many_others(seed):
    rng = np.random.default_rng(seed)
    up = unit(UP + np.array([0.3, 0.0, -0.2]))
    vertical = unit(np.cross(up, rng.normal(size=(60, 3))))
    noisy = unit(vertical + rng.normal(size=vertical.shape) * np.radians(0.2))
    lines = np.concatenate([noisy, unit(rng.normal(size=(120, 3)))]) * rng.uniform(0.05, 0.3, (180, 1))
    found = find_vertical(lines)
    assert found.is_certain
    assert angle_between(found.up, up) < min(5 * found.std, np.radians(0.2))


def test_lines_that_agree_on_nothing_are_not_certain():
    lines = unit(np.random.default_rng(4).normal(size=(200, 3))) * 0.1
    assert not find_vertical(lines).is_certain
    assert not find_vertical(lines[:3]).is_certain
    np.testing.assert_array_equal(find_vertical(lines[:0]).up, UP)


def test_the_zenith_of_a_tilted_picture():
    found, up = find_vertical(find_lines(grey_of(street_image(0, (512, 1024))))), street_poses()[0].rotation.T @ UP
    assert found.is_certain
    assert angle_between(found.up, up) < np.radians(0.5)


def test_lines_where_a_panorama_may_not_be_used_do_not_count():
    grey = grey_of(street_image(0))
    assert len(find_lines(grey, np.zeros(grey.shape, bool))) == 0


HEIGHT, TABLE_HEIGHT, TILE = 1.5, 0.75, 0.07
COLOURS = np.random.default_rng(5).uniform(0.15, 0.85, (256, 256, 3)).astype(np.float32)


def floor_view(
    x: float, rise: float = 0.0, table: tuple[float, float] | None = None, *, has_floor: bool = True
) -> View:
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
    first, second = (floor_view(x, table=(0.8, 2.0)) for x in (0.0, 1.0))
    assert floor_heights([(first, second)]) == pytest.approx([HEIGHT], rel=0.02)


def test_of_a_set_the_level_that_most_pairs_see_is_the_floor():
    """The second pair sees a table and no floor: alone it takes the one for the other, in the set it does not count."""
    on_table = tuple(floor_view(x, table=(-9.0, 9.0), has_floor=False) for x in (1.0, 1.6))
    others = [tuple(floor_view(x + k) for x in (0.0, 0.8)) for k in range(2)]
    assert floor_heights([on_table]) == pytest.approx([HEIGHT - TABLE_HEIGHT], rel=0.02)
    assert floor_heights([others[0], on_table, others[1]]) == pytest.approx([HEIGHT, HEIGHT], rel=0.02)


def test_of_cameras_of_different_heights_the_mean_counts():
    assert floor_heights([(floor_view(0.0), floor_view(1.0, rise=0.2))]) == pytest.approx([HEIGHT + 0.1], rel=0.02)


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


@pytest.mark.parametrize(
    ("floor", "table", "height"), [(40, 60, HEIGHT), (12, 60, None), (0, 60, HEIGHT - TABLE_HEIGHT), (4, 4, None)]
)
def test_points_tell_the_lowest_level_that_has_none_below(floor: int, table: int, height: float | None) -> None:
    """A table is no floor where some points lie below it; reflections of lamps lie far below any floor."""
    rng = np.random.default_rng(6)
    levels = np.repeat([0.0, TABLE_HEIGHT, -3.0], [floor, table, 10])
    points = np.column_stack([rng.uniform(-2.0, 2.0, len(levels)), levels, rng.uniform(-2.0, 2.0, len(levels))])
    poses = [Pose(np.eye(3), np.array([x, HEIGHT, 0.0])) for x in (0.0, 1.0)]
    first, second = (each - pose.position for each, pose in ((points, poses[0]), (points, poses[1])))
    rays = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (first, second))
    level = level_of_points(height_above_points(*poses, Matches(*rays, pixel=0.003)))
    assert (level and level[0]) == (height and pytest.approx(height, rel=0.01))


def test_the_level_of_points_is_told_within_5_percent_or_not_at_all():
    off = np.random.default_rng(7).normal(size=400)
    assert level_of_points(1.6 * np.exp(0.02 * off)) == (pytest.approx(1.6, rel=0.01), pytest.approx(0.0135, rel=0.2))
    assert level_of_points(1.6 * np.exp(0.042 * off)) is None


def test_a_plane_with_few_points_is_a_floor_if_none_of_them_lies_below():
    points = np.array([1.3, 1.35, 1.5, 1.55, 8.0, 0.4])  # the last two are a reflection and a bin
    assert spread_above(1.6, points) == pytest.approx(0.109, abs=0.001)
    assert spread_above(1.6, points[1:]) is None
    assert spread_above(1.6, np.append(points, 1.9)) is None


def test_without_a_floor_there_is_no_height():
    assert floor_heights([(floor_view(0.0, has_floor=False), floor_view(1.0, has_floor=False))]) == []
    assert floor_heights([(floor_view(0.0), floor_view(0.0))]) == []


ROOF_SIZE = (256, 512)
ROOF = math.radians(60)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Two panoramas of a street with one roof below both cameras, and its mask."""
    folder = tmp_path_factory.mktemp("roof")
    texture = np.random.default_rng(0).random((128, 256, 3), np.float32)
    roof = cv2.resize(texture, ROOF_SIZE[::-1], interpolation=cv2.INTER_CUBIC).clip(0.0, 1.0)
    is_street = outside_nadir(ROOF_SIZE, ROOF)[..., None]
    paths = [folder / name for name in ("a.png", "b.png", "mask.png")]
    for index, path in enumerate(paths[:2]):
        write_image(path, np.where(is_street, street_image(index, ROOF_SIZE), roof).astype(np.float32))
    write_image(paths[2], np.repeat(is_street, 3, axis=2).astype(np.float32))
    return paths


def found_pose(found):
    first, second = (found.panoramas[name].pose for name in ("a.png", "b.png"))
    return first.inverse() @ second


def test_without_a_mask_the_roof_says_that_nobody_has_moved(photographs):
    first, second, _ = photographs
    assert not found_pose(estimate_poses((first, second), (1.0,), PictureOptions(threads=1))).position.any()


@pytest.mark.parametrize("how", ["nadir", "masks"])
def test_what_may_not_be_used_is_not_looked_at(photographs, how):
    first, second, mask = photographs
    options = PictureOptions(threads=1, **({"nadir": ROOF} if how == "nadir" else {"masks": (mask, mask)}))
    found, truth = found_pose(estimate_poses((first, second), (1.0,), options)), street_truth()
    direction = truth.position / np.linalg.norm(truth.position)
    assert np.degrees(np.arccos(min(1.0, found.position @ direction))) < 2.0
    assert np.degrees(rotation_angle(found.rotation.T @ truth.rotation)) < 0.2


def test_masks_and_the_cap_reach_poses_that_are_checked(photographs, monkeypatch):
    first, second, mask = photographs
    looked_at = []

    def find_features(image, usable, threads):
        looked_at.append(usable)
        raise InterruptedError

    monkeypatch.setattr("omnisyn_cli.poses.estimation.find_features", find_features)
    poses = PoseFile(first.parent / "poses.json", dict.fromkeys(("a.png", "b.png"), PosedPanorama(street_truth())))
    with pytest.raises(InterruptedError):
        next(check_poses((first, second), poses, PictureOptions(masks=(mask, mask), nadir=ROOF / 2)))
    np.testing.assert_array_equal(looked_at[0], outside_nadir(ROOF_SIZE, ROOF))


def test_another_number_of_masks_is_refused(photographs):
    first, second, mask = photographs
    with pytest.raises(InputError, match="expected one mask for each of 2 panoramas, got 1"):
        estimate_poses((first, second), (1.0,), PictureOptions(masks=(mask,)))


@pytest.mark.parametrize(
    ("columns", "is_masked", "meets"), [(512, False, True), (300, False, False), (300, True, True)]
)
def test_edges_that_do_not_meet_tell_a_part_of_the_sphere(columns, is_masked, meets):
    """Unless those that may not be used are among them."""
    image = street_image(0)[: columns // 2, :columns]
    usable = np.arange(columns) > 0 if is_masked else np.ones(columns, bool)
    assert scan_panorama(image, np.tile(usable, (len(image), 1)), threads=1).meets_at_seam == meets
