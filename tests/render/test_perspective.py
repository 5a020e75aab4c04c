"""Perspective pictures show what plain loops over their rays show; both eyes are as far apart as they should be."""

import math

import numpy as np
import pytest
from render_samples import CUTS, WHOLE, random_pose, rough, smooth

from omnisyn_cli.geometry.perspective import PerspectiveSize, cell_directions, target_tables
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.eyes import EYE_DISTANCE, top_bottom
from omnisyn_cli.render.mesh import Mesh, build_mesh
from omnisyn_cli.render.rasterize import PerspectiveRasterizer
from omnisyn_cli.render.simplify import simplify
from reference_rasterizer import rasterize_reference


def rays_of(size: PerspectiveSize, fov: float) -> np.ndarray:
    """Rays of length 1 along the axis, from the definition of a pinhole camera with pixel centres at ½."""
    height, width = size
    step = 2 * math.tan(fov / 2) / width
    x, y = (np.arange(width) + 0.5 - width / 2) * step, (height / 2 - np.arange(height) - 0.5) * step
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1)


def assert_equal_to_the_oracle(mesh: Mesh, pose: Pose, shape: tuple[int, int], fov: float) -> None:
    """Nearly everywhere the same face; there the same inverse distance along the axis."""
    size = PerspectiveSize(*shape, fov)
    drawn = np.empty(shape[0] * shape[1], np.int32)
    inverse_depth = PerspectiveRasterizer(size, threads=2)(mesh.blocks, pose, drawn)
    expected = rasterize_reference(mesh.triangles(), pose, shape, rays_of(size, fov))
    is_same = mesh.face_numbers(drawn).reshape(shape) == expected.face
    assert is_same.mean() > 0.97
    np.testing.assert_allclose(inverse_depth[is_same], expected.inverse_depth[is_same], rtol=1e-3, atol=2e-5)


@pytest.mark.parametrize("fov", [0.6, 1.6, 2.4])
@pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
def test_rough_surfaces(cut, fov):
    assert_equal_to_the_oracle(build_mesh(rough(6, 12), cut), random_pose(3, 0.7), (27, 48), fov)


@pytest.mark.parametrize("seed", range(10))
def test_random_surfaces_and_poses(seed):
    """Also from far outside of the middle, with large quads beside and behind the camera."""
    rng = np.random.default_rng(seed)
    mesh = build_mesh(rough(*rng.integers(2, 14, 2), seed), list(CUTS.values())[seed % len(CUTS)])
    assert_equal_to_the_oracle(mesh, random_pose(seed, rng.uniform(0, 3)), (18, 32), rng.uniform(0.5, 2.5))


@pytest.mark.parametrize("shape", [(1, 1), (5, 3), (9, 64)])
def test_tiny_and_odd_pictures(shape):
    assert_equal_to_the_oracle(build_mesh(smooth(4, 8), WHOLE), random_pose(6, 0.3), shape, 1.2)


def test_simplified_surfaces_have_no_gaps():
    mesh, pose = build_mesh(smooth(32, 64), WHOLE), Pose(np.eye(3), np.array([0.2, 0.1, 0.5]))
    quads, count = simplify(mesh, -pose.position, 400)
    assert count < mesh.face_count()
    assert (PerspectiveRasterizer(PerspectiveSize(90, 160, 1.6))(quads, pose) > 0).all()


def test_tables_and_cells_are_the_rays_of_a_pinhole():
    size = PerspectiveSize(18, 32, 1.5)
    sin_p, cos_p, sin_a, cos_a = target_tables(size)
    rays = np.stack(np.broadcast_arrays(sin_p[:, None] * sin_a, cos_p[:, None], -sin_p[:, None] * cos_a), axis=-1)
    np.testing.assert_allclose(rays, rays_of(size, 1.5), atol=1e-12)
    np.testing.assert_allclose(
        cell_directions(size, (9, 16)), rays.reshape(9, 2, 16, 2, 3).mean(axis=(1, 3)), atol=1e-12
    )
    np.testing.assert_array_equal(cell_directions((18, 36), (9, 18)), pixel_directions(9, 18))


@pytest.mark.parametrize("distance", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_the_disparity_at_the_horizon_is_that_of_the_distance(distance, dtype):
    """A bright bar on the inside of a sphere: its middle in either eye, in columns."""
    height, width = 64, 4096
    image = np.zeros((height, width, 3), dtype)
    image[:, 1000:1012] = 200
    eyes = top_bottom(image, np.full((height, width), 1 / distance, np.float32), threads=1)
    assert eyes.dtype == dtype
    middles = [eye[height // 2, :, 0].astype(float) @ np.arange(width) / eye[height // 2, :, 0].astype(float).sum()
               for eye in (eyes[:height], eyes[height:])]  # fmt: skip
    expected = 2 * math.asin(EYE_DISTANCE / 2 / distance) * width / (2 * math.pi)
    assert middles[0] - middles[1] == pytest.approx(expected, rel=0.05)
    assert sum(middles) / 2 == pytest.approx(1005.5, abs=0.1)


def test_near_things_hide_far_ones_and_what_opens_behind_them_is_far():
    """A red pillar at 0.6 m before a wall of white and grey at 6 m, across the seam too."""
    height, width = 8, 1024
    image = np.where(np.arange(width) % 2 == 0, 255, 128).astype(np.uint8)[None, :, None].repeat(height, 0).repeat(3, 2)
    inverse_depth = np.full((height, width), 1 / 6, np.float32)
    for first in (400, 1010):
        cols = np.arange(first, first + 30) % width
        image[:, cols] = (255, 0, 0)
        inverse_depth[:, cols] = 1 / 0.6
    eyes = top_bottom(image, inverse_depth)
    red = (eyes[..., 0] > 200) & (eyes[..., 1] < 60)
    assert (abs(red.sum(axis=1) - 60) <= 4).all()
    others = eyes[~red].astype(int)
    assert (abs(others[:, 0] - others[:, 2]) < 130).all()  # nothing black, nothing of another colour


def test_unknown_distances_are_infinite():
    image = np.random.default_rng(1).integers(0, 256, (16, 32, 3), np.uint8)
    eyes = top_bottom(image, np.full((16, 32), -1, np.float32))
    np.testing.assert_array_equal(eyes, np.concatenate([image, image]))
