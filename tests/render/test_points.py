import math

import numpy as np
import pytest
from render_samples import POSES, moved, random_pose, rough, smooth, sphere, turn

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.render.points import LEAST_RADIUS, RADIUS, SAME_SURFACE, render_points


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(40).random((height, width, 4)).astype(np.float32)


def reference(rho: np.ndarray, pose: Pose, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Every pixel against every point: inverse depth and index of the chosen one."""
    points = pixel_directions(*rho.shape).reshape(-1, 3) @ pose.rotation.T + rho.reshape(-1, 1) * pose.position
    length = np.linalg.norm(points, axis=-1)
    seen = rho.ravel() / length
    cosine = pixel_directions(*size) @ (points / length[:, None]).T
    covers = cosine >= math.cos(math.pi * max(RADIUS / rho.shape[0], LEAST_RADIUS / size[0]))
    nearest = np.where(covers, seen, -1.0).max(axis=-1)
    candidates = covers & (seen >= SAME_SURFACE * nearest[..., None])
    face = np.where(candidates, cosine, -2.0).argmax(axis=-1)
    empty = ~covers.any(axis=-1)
    return np.where(empty, -1.0, seen[face]), np.where(empty, -1, face)


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
@pytest.mark.parametrize("size", [(15, 31), (24, 48)])
def test_agrees_with_brute_force_at_seam_and_poles(pose, size):
    rho, image = rough(9, 18), noise(9, 18)
    fragments, colour = render_points(image, rho, pose, size)
    inverse_depth, face = reference(rho, pose, size)
    agree = fragments.face == face
    assert agree.mean() > 0.97  # the rest lies exactly on the rim of a disc or between two centres
    np.testing.assert_allclose(fragments.inverse_depth[agree], inverse_depth[agree], rtol=1e-5)
    np.testing.assert_array_equal(colour[agree & (face >= 0)], image.reshape(-1, 4)[face[agree & (face >= 0)]])
    assert (colour[~fragments.visibility] == 0).all()


def test_the_identity_pose_returns_the_image():
    image, rho = noise(16, 32), smooth(16, 32)
    fragments, colour = render_points(image, rho, Pose.identity(), (16, 32))
    np.testing.assert_array_equal(colour, image)
    np.testing.assert_allclose(fragments.inverse_depth, rho, rtol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_turning_the_camera_opens_no_holes(seed):
    fragments, _ = render_points(noise(24, 48), smooth(24, 48), random_pose(seed, 0.0), (50, 100))
    assert fragments.visibility.all()


def test_a_sphere_seen_from_inside():
    pose = random_pose(41, 1.0)
    fragments, _ = render_points(noise(64, 128), np.full((64, 128), 0.2, np.float32), pose, (32, 64))
    expected = sphere(pose.position, 5.0, pixel_directions(32, 64))
    np.testing.assert_allclose(fragments.inverse_depth, expected, rtol=0.03)


def test_points_come_apart_where_the_camera_comes_near():
    image, rho = noise(32, 64), np.full((32, 64), 0.2, np.float32)
    poses = (moved(0.0, 0.0, metres) for metres in (0.0, 3.0, 4.0))
    seen = [render_points(image, rho, pose, (64, 128))[0].visibility.mean() for pose in poses]
    assert seen[0] == 1.0
    assert seen == sorted(seen, reverse=True)
    assert seen[-1] < 0.9


@pytest.mark.parametrize("shift", [1, 11])
def test_turning_the_target_rolls_the_image(shift):
    image, rho, pose = noise(16, 32), smooth(16, 32), random_pose(42, 0.5)
    turned = Pose(turn(0.0, -2 * math.pi * shift / 40, 0.0), np.zeros(3)) @ pose
    one, two = (render_points(image, rho, p, (20, 40))[1] for p in (pose, turned))
    assert (np.roll(one, shift, axis=1) == two).all(axis=-1).mean() > 0.99


@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_nothing(threads):
    image, rho, pose = noise(16, 32), rough(16, 32), random_pose(43, 1.5)
    (one, one_colour), (many, many_colour) = (
        render_points(image, rho, pose, (31, 62), threads=n) for n in (1, threads)
    )
    np.testing.assert_array_equal(many.face, one.face)
    np.testing.assert_array_equal(many_colour, one_colour)


def test_masked_pixels_are_no_points_and_a_point_at_the_camera_is_none():
    mask = np.random.default_rng(44).random((16, 32)) > 0.5
    rho, image = np.full((16, 32), 0.5, np.float32), noise(16, 32)
    fragments, _ = render_points(image, rho, Pose.identity(), (16, 32), mask=mask)
    assert mask.ravel()[fragments.face[fragments.visibility]].all()
    inside = Pose(np.eye(3), -2.0 * pixel_directions(16, 32)[3, 4])
    fragments, colour = render_points(image, rho, inside, (16, 32))
    assert np.isfinite(fragments.inverse_depth).all()
    assert np.isfinite(colour).all()


def test_the_closest_of_many_small_points_is_shown():
    """Where single precision cannot tell the cosines of neighbours apart."""
    size = (1024, 2048)
    turned = Pose(rotation_from_rotation_vector(np.array([0.3, 0.7, -0.2])), np.zeros(3))
    image, infinitely_far = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    fragments, _ = render_points(image, infinitely_far, turned, size)
    rays, rows = pixel_directions(*size), np.arange(256, 768, 8)
    own, face = rays[rows] @ turned.rotation, fragments.face[rows]
    chosen = np.linalg.norm(rays.reshape(-1, 3)[face] - own, axis=-1)
    row, col = (np.rint(x).astype(int) for x in direction_to_pixel(own, size))
    is_off = np.zeros(face.shape, bool)
    for down in (-1, 0, 1):
        for across in (-2, -1, 0, 1, 2):
            other = rays[np.clip(row + down, 0, size[0] - 1), (col + across) % size[1]]
            is_off |= np.linalg.norm(other - own, axis=-1) < chosen - 1e-6
    assert is_off.mean() < 1e-4
