"""Where the rasteriser changes from one way of drawing a quad to another: widths, seam, steep planes, bands."""

import numpy as np
import pytest
from render_samples import WHOLE, is_unambiguous, moved, random_pose, rough, smooth, turn

from omnisyn_cli.compute.trigonometry import LOG2_ERROR, log2_fast
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render import quad_kernels
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.quad_blocks import QUARTER_DIRECTIONS, QUARTER_INVERSE_DEPTHS
from omnisyn_cli.render.rasterize import rasterize
from reference_rasterizer import rasterize_reference


@pytest.mark.parametrize("width", [1, 3, 4, 7, 8, 9, 15, 16, 17, 33])
def test_targets_narrower_than_a_vector_and_just_wider_agree_with_the_oracle(width):
    mesh, pose, size = build_mesh(rough(7, 13)), random_pose(20, 0.9), (9, width)
    triangles = mesh.triangles()
    found, expected = rasterize(mesh, pose, size), rasterize_reference(triangles, pose, size)
    where = is_unambiguous(triangles, pose, size)
    np.testing.assert_array_equal(found.face[where], expected.face[where])
    np.testing.assert_allclose(found.inverse_depth[where], expected.inverse_depth[where], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("size", [(24, 48), (48, 96), (96, 192), (192, 384)])
def test_quads_of_any_width_in_pixels_cover_the_sphere(size):
    """Two, four, eight and sixteen columns per quad: narrow boxes, wide ones and several vectors per row."""
    mesh = build_mesh(smooth(24, 48), WHOLE)
    for pose in (Pose.identity(), random_pose(21, 0.3), moved(0.1, 0.0, 0.2, rotation=turn(0.0, 0.0, 0.5))):
        assert rasterize(mesh, pose, size).visibility.all()


def test_planes_seen_nearly_edge_on_keep_their_inverse_depth():
    """A floor that the camera has come close to, up to half a degree below the horizon; closed form."""
    height, near, size = 1.6, 0.15, (1000, 16)
    ground = (np.maximum(0.0, -pixel_directions(64, 128)[..., 1]) / height).astype(np.float32)
    mesh, pose = build_mesh(ground, WHOLE), moved(0.0, height - near, 0.0)
    found = rasterize(mesh, pose, size)
    expected = -pixel_directions(*size)[..., 1] / near
    where = (found.face >= 8 * 33 * 128) & (found.face < 8 * mesh.quads.size) & (expected > 0)
    assert where.mean() > 0.3
    assert expected[where].min() < 1 / (quad_kernels.MAX_FLOAT32_SLOPE * near)
    np.testing.assert_allclose(found.inverse_depth[where], expected[where], rtol=1e-4)


@pytest.mark.parametrize("threads", [2, 5])
def test_bands_see_the_same_at_sizes_that_fill_vectors(threads):
    mesh, pose = build_mesh(rough(40, 80)), random_pose(22, 0.7)
    one, many = (rasterize(mesh, pose, (64, 128), n) for n in (1, threads))
    np.testing.assert_array_equal(many.face, one.face)
    np.testing.assert_array_equal(many.inverse_depth, one.inverse_depth)


def test_edges_overlap_by_less_than_the_tests_allow():
    assert quad_kernels.EDGE_OVERLAP_RADIANS * np.sqrt(3) < 1e-6


def test_points_of_a_quarter_are_weighted_means_of_its_quad():
    for weights in (QUARTER_DIRECTIONS, QUARTER_INVERSE_DEPTHS):
        np.testing.assert_allclose(weights.sum(axis=-1), 1.0)


def test_the_fast_logarithm_is_as_exact_as_it_says():
    from numba import njit  # the kernel is only ever inlined into loops

    @njit
    def all_of(x):
        return np.array([log2_fast(value) for value in x])

    near_one = np.linspace(0.5, 2.0, 10_001).astype(np.float32)
    np.testing.assert_allclose(all_of(near_one), np.log2(near_one.astype(float)), atol=LOG2_ERROR)
    anything = np.exp(np.linspace(-40, 40, 1001)).astype(np.float32)
    np.testing.assert_allclose(all_of(anything), np.log2(anything.astype(float)), atol=1e-5)
