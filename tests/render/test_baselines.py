"""Baselines: soft points against plain loops, in numba and in torch; point clouds; the rasteriser in two passes."""

import math

import numpy as np
import pytest
import torch
from render_samples import POSES, WHOLE, moved, random_pose, rough, smooth, sphere, turn

from omnisyn_cli.baselines.points import PointRenderer
from omnisyn_cli.baselines.soft_points import MIN_DIVISOR_OPACITY, Cloud, even_points, list_visible, splat
from omnisyn_cli.baselines.two_pass import rasterize_two_pass, triangles_without_caps
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.rasterize import Fragments, rasterize
from omnisyn_cli.render.renderer import RendererInputs
from omnisyn_cli.training.synsin import splat_torch


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


def test_turning_the_target_by_whole_columns_rolls_what_it_sees():
    pose = random_pose(57, 0.5)
    turned = Pose(turn(0.0, -2 * math.pi * 5 / 28, 0.0), np.zeros(3)) @ pose
    one, two = (splat([Cloud(noise(12, 24), smooth(12, 24), each)], (14, 28)) for each in (pose, turned))
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


SIZE = (64, 128)


def seen(rho: np.ndarray, position: tuple[float, float, float], mask: np.ndarray | None = None) -> np.ndarray:
    """Red is the pixel's inverse depth, so that it says which point is seen; then confidence and inverse depth."""
    image = np.zeros((*SIZE, 3), np.float32)
    image[..., 0] = rho
    layer = PointRenderer(RendererInputs(image, mask, rho, None, SIZE))(Pose(np.eye(3), np.array(position)))
    return np.concatenate([layer.colour, layer.inverse_depth[..., None]], axis=-1)


def test_from_its_own_place_a_panorama_is_what_it_was() -> None:
    rho = np.random.default_rng(5).uniform(0.3, 0.31, SIZE).astype(np.float32)
    found = seen(rho, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(found[24:40, :, 0], rho[24:40], atol=0.01)
    np.testing.assert_allclose(found[..., 4], rho, atol=0.01)
    assert (found[..., 3] > 0.99).all()


def test_what_is_near_hides_what_is_far() -> None:
    rho = np.full(SIZE, 0.1, np.float32)
    rho[24:40, 56:72] = 1.0
    found = seen(rho, (0.3, 0.0, 0.0))  # the points move to the right, those nearby further
    np.testing.assert_allclose(found[30:34, 66:72, 0], 1.0, atol=0.1)
    np.testing.assert_allclose(found[30:34, 20:40, 0], 0.1, atol=0.01)


def test_points_come_apart_where_the_camera_comes_closer_and_masked_ones_are_none() -> None:
    rho = np.full(SIZE, 0.5, np.float32)
    closer = seen(rho, (0.0, 0.0, 1.6))  # a fifth of the radius is left ahead
    assert (closer[24:40, 56:72, 4] < 0.0).mean() > 0.3
    assert (closer[closer[..., 4] < 0.0][:, :4] == 0.0).all()
    mask = np.ones(SIZE, bool)
    mask[:, :64] = False
    assert (seen(rho, (0.0, 0.0, 0.0), mask)[8:56, 4:58, 3] == 0.0).all()


def two_pass(rho: np.ndarray, pose: Pose, size: tuple[int, int], threads: int | None = None) -> Fragments:
    return rasterize_two_pass(triangles_without_caps(build_mesh(rho, WHOLE)), pose, size, threads)


def test_equals_the_exact_rasteriser_for_fine_meshes_away_from_the_poles():
    rho, pose = smooth(128, 256), random_pose(50, 0.7)
    found, expected = two_pass(rho, pose, (40, 80)), rasterize(build_mesh(rho, WHOLE), pose, (40, 80))
    middle = slice(4, -4)
    both = found.visibility[middle] & expected.visibility[middle]
    assert both.mean() > 0.97  # not where the poles of the source are
    np.testing.assert_allclose(found.inverse_depth[middle][both], expected.inverse_depth[middle][both], rtol=5e-3)


def test_the_seam_is_closed_by_the_second_pass():
    for shift in range(0, 40, 7):
        turned = moved(0.1, 0.0, -0.2, rotation=turn(0.0, -2 * math.pi * shift / 40 + 0.01, 0.0))
        assert two_pass(smooth(16, 32), turned, (20, 40)).visibility[2:-2].all()


def test_the_identity_pose_returns_the_inverse_depths():
    rho = rough(16, 32)
    found = two_pass(rho, Pose.identity(), (16, 32)).inverse_depth
    np.testing.assert_allclose(found[1:-1], rho[1:-1], atol=1e-5)


def test_straight_lines_bend_where_triangles_are_large_and_those_of_the_exact_rasteriser_do_not():
    """A coarse sphere's error grows with its faces' size twice over: once for being flat, once for being drawn flat."""
    pose, size = moved(0.0, 0.0, 2.0), (64, 128)
    rho = np.full((8, 16), 0.2, np.float32)
    middle = slice(8, -8)
    exact = rasterize(build_mesh(rho), pose, size)
    flat = two_pass(rho, pose, size)
    assert np.abs(flat.inverse_depth - exact.inverse_depth)[middle].max() > 1e-3
    expected = sphere(pose.position, 5.0, pixel_directions(*size))[middle]
    assert (exact.inverse_depth[middle] >= expected * (1 - 1e-5)).all()


def test_holes_at_the_poles_are_what_the_method_costs():
    rho, pose = smooth(32, 64), moved(0.0, 0.0, 0.0, rotation=turn(0.7, 0.0, 0.0))
    assert not two_pass(rho, pose, (64, 128)).visibility.all()
    assert rasterize(build_mesh(rho), pose, (64, 128)).visibility.all()


def test_backs_of_faces_are_culled():
    found = two_pass(np.full((64, 128), 0.2, np.float32), moved(0.0, 0.0, -12.0), (64, 128))
    assert not found.visibility[:, :32].any()
    assert (1.0 / found.inverse_depth[found.visibility] > 10.5).all()
