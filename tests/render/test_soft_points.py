"""Soft points against plain loops over every pixel and every point, in numba and in torch."""

import math

import numpy as np
import pytest
import torch
from render_samples import POSES, moved, random_pose, rough, smooth, sphere, turn

from omnisyn_cli.baselines.soft_points import MIN_DIVISOR_OPACITY, Cloud, even_points, list_visible, splat
from omnisyn_cli.baselines.soft_points_torch import splat_torch
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions


def noise(height: int, width: int, channels: int = 3, seed: int = 50) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width, channels)).astype(np.float32)


def kept(height: int, width: int) -> list[list[bool]]:
    """Which pixels are points: where a length that grows by a pixel's share of the equator reaches a whole number."""
    rows = []
    for row in range(height):
        share, length, points = math.sin((row + 0.5) / height * math.pi), row * (math.sqrt(5) - 1) / 2 % 1, []
        for _ in range(width):
            length += share
            points.append(length >= 1)
            length %= 1
        rows.append(points)
    return rows


def reference(clouds: list[Cloud], size: tuple[int, int], radius: float) -> np.ndarray:
    """Every pixel against every point, in float64."""
    points = []
    for cloud in clouds:
        height, width = cloud.inverse_depth.shape
        directions, even = pixel_directions(height, width), kept(height, width)
        for row in range(height):
            for col in range(width):
                if not even[row][col] or (cloud.mask is not None and not cloud.mask[row, col]):
                    continue
                rho, pose = float(cloud.inverse_depth[row, col]), cloud.target_from_source
                vector = pose.rotation @ directions[row, col] + rho * pose.position
                length = math.sqrt(vector @ vector)
                if length > 1e-9:
                    points.append((rho / length, vector / length, cloud.features[row, col].astype(float)))
    points.sort(key=lambda point: -point[0])
    rim, out = 2 * math.sin(0.5 * radius * math.pi / size[0]), np.zeros((*size, clouds[0].features.shape[-1] + 1))
    for row, rays in enumerate(pixel_directions(*size)):
        for col, ray in enumerate(rays):
            left = 1.0
            for _, direction, feature in points:
                square = ((ray - direction) @ (ray - direction)) / rim**2
                if square <= 1.0:
                    alpha = 1.0 - math.sqrt(max(square, MIN_DIVISOR_OPACITY))
                    out[row, col, :-1] += left * alpha * feature
                    left *= 1.0 - alpha
            out[row, col, -1] = 1.0 - left
    return out


def on_torch(clouds: list[Cloud], size: tuple[int, int], dtype=torch.float64, **options) -> np.ndarray:
    made = splat_torch(
        [torch.from_numpy(cloud.features.transpose(2, 0, 1).copy()).to(dtype) for cloud in clouds],
        [torch.from_numpy(cloud.inverse_depth).to(dtype) for cloud in clouds],
        [cloud.target_from_source for cloud in clouds],
        size,
        **options,
    )
    return made.permute(1, 2, 0).numpy()


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
@pytest.mark.parametrize("radius", [1.0, 2.5])
def test_agrees_with_plain_loops_at_seam_and_poles(pose, radius):
    clouds = [Cloud(noise(7, 14), rough(7, 14), pose)]
    expected = reference(clouds, (9, 18), radius)
    np.testing.assert_allclose(splat(clouds, (9, 18), radius=radius, most=200), expected, atol=1e-5)
    np.testing.assert_allclose(on_torch(clouds, (9, 18), radius=radius, most=200), expected, atol=1e-5)


def test_two_panoramas_are_one_list_of_points_and_masked_pixels_are_none():
    mask = np.random.default_rng(51).random((6, 12)) > 0.4
    clouds = [
        Cloud(noise(6, 12), rough(6, 12, 1), random_pose(52, 0.6), mask),
        Cloud(noise(8, 16, seed=53), rough(8, 16, 2), random_pose(54, 0.6)),
    ]
    np.testing.assert_allclose(splat(clouds, (7, 14), radius=2.0, most=200), reference(clouds, (7, 14), 2.0), atol=1e-5)


def test_torch_and_numba_agree_in_single_precision():
    clouds = [Cloud(noise(24, 48, 5, seed), smooth(24, 48, seed), random_pose(55 + seed, 1.0)) for seed in (0, 1)]
    made = splat(clouds, (32, 64), radius=2.0, most=16)
    np.testing.assert_allclose(on_torch(clouds, (32, 64), torch.float32, radius=2.0, most=16), made, atol=1e-4)


def test_gradients_are_those_of_finite_differences():
    """In double precision, to features and inverse depths of two panoramas, over the seam and both poles."""
    generator = torch.Generator().manual_seed(56)
    features = torch.rand(2, 2, 5, 10, generator=generator, dtype=torch.float64, requires_grad=True)
    depths = (0.2 + 0.3 * torch.rand(2, 5, 10, generator=generator, dtype=torch.float64)).requires_grad_()
    poses = [moved(0.3, 0.2, -0.4, rotation=turn(0.2, 2.0, 0.1)), moved(-0.3, 0.2, 0.4)]

    def blended(features, depths):
        return splat_torch(list(features), list(depths), poses, (5, 10), radius=1.3, most=60)

    assert torch.autograd.gradcheck(blended, (features, depths), eps=1e-7, atol=1e-5)


def test_gradients_are_finite_at_infinity_at_a_discs_centre_and_at_the_camera():
    depths = torch.zeros(6, 12, requires_grad=True)
    features = torch.rand(2, 6, 12, requires_grad=True)
    splat_torch([features], [depths], [Pose.identity()], (6, 12), radius=2.0).sum().backward()
    assert torch.isfinite(depths.grad).all()
    assert torch.isfinite(features.grad).all()
    here = (0.5 * torch.ones(6, 12)).requires_grad_()
    at_a_point = Pose(np.eye(3), -2.0 * pixel_directions(6, 12)[3, 4])
    splat_torch([features], [here], [at_a_point], (6, 12), radius=2.0).sum().backward()
    assert torch.isfinite(here.grad).all()


def test_a_nearer_depth_is_found_by_its_gradient():
    """Points on a sphere that is thought too far: descent brings them nearer."""
    pose, directions = moved(0.5, 0.0, 0.0), pixel_directions(16, 32)
    seen_from = sphere(np.zeros(3), 2.0, directions)
    pattern = np.sin(4 * directions @ np.ones((3, 1)) + [0.0]).astype(np.float32)
    truth = on_torch([Cloud(pattern, seen_from.astype(np.float32), pose)], (16, 32), radius=2.0)
    root = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    features = torch.from_numpy(pattern.transpose(2, 0, 1).copy()).double()
    made = splat_torch([features], [root * torch.ones(16, 32, dtype=torch.float64)], [pose], (16, 32), radius=2.0)
    (made.permute(1, 2, 0) - torch.from_numpy(truth)).abs().mean().backward()
    assert root.grad < 0


def test_turning_the_target_by_whole_columns_rolls_what_it_sees():
    clouds = [Cloud(noise(12, 24), smooth(12, 24), random_pose(57, 0.5))]
    turned = Pose(turn(0.0, -2 * math.pi * 5 / 28, 0.0), np.zeros(3)) @ clouds[0].target_from_source
    one, two = (
        splat([Cloud(noise(12, 24), smooth(12, 24), pose)], (14, 28)) for pose in (random_pose(57, 0.5), turned)
    )
    np.testing.assert_allclose(two, np.roll(one, 5, axis=1), atol=1e-5)


def test_discs_cover_more_columns_towards_the_poles_but_one_area():
    """A single point, seen without moving: the solid angle of its opacity does not depend on where it is."""
    sums = []
    for row in (2, 40, 64):
        mask = np.zeros((128, 256), bool)
        mask[row, np.flatnonzero(even_points(128, 256)[row])[0]] = True
        seen = splat([Cloud(noise(128, 256, 1), smooth(128, 256), Pose.identity(), mask)], (128, 256))[..., -1]
        sine = np.sin((np.arange(128) + 0.5) / 128 * math.pi)
        sums.append((seen * sine[:, None]).sum())
        assert (seen.max(axis=0) > 0).sum() == 256 if row == 2 else (seen.max(axis=0) > 0).sum() < 20
    np.testing.assert_allclose(sums, sums[-1], rtol=0.02)


def test_points_are_as_dense_at_the_poles_as_at_the_equator():
    even = even_points(64, 128)
    assert even[31:33].sum() >= 254
    assert even.any(axis=0).all()
    assert even.sum() == pytest.approx(64 * 128 * 2 / math.pi, rel=0.02)
    assert 1 <= even[0].sum() <= 4


@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_nothing(threads):
    clouds = [Cloud(noise(16, 32), rough(16, 32), random_pose(58, 1.5))]
    np.testing.assert_array_equal(splat(clouds, (31, 62), threads=threads), splat(clouds, (31, 62), threads=1))


def test_the_nearest_come_first_and_no_more_than_asked_for():
    lists = list_visible([rough(12, 24)], [random_pose(59, 1.0)], (12, 24), radius=3.0, most=5)
    depth = np.where(lists.found >= 0, lists.points[lists.found, 3], -1.0)
    assert lists.found.shape == (12, 24, 5)
    assert (np.diff(depth, axis=-1) <= 0).all()
    every = list_visible([rough(12, 24)], [random_pose(59, 1.0)], (12, 24), radius=3.0, most=300).found[..., :5]
    np.testing.assert_array_equal(lists.found, every)


def test_the_same_place_shows_the_same_picture_with_soft_edges():
    """What is blended are neighbours: a smooth picture stays nearly what it was, and nothing is left open."""
    directions = pixel_directions(48, 96)
    smooth_picture = (0.5 + 0.3 * directions).astype(np.float32)
    made = splat([Cloud(smooth_picture, smooth(48, 96), Pose.identity())], (48, 96), radius=2.0)
    np.testing.assert_allclose(made[..., :3] / made[..., 3:], smooth_picture, atol=0.05)
    assert made[..., 3].min() > 0.8
