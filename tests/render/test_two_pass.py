import math

import numpy as np
import pytest
from render_samples import WHOLE, moved, random_pose, rough, smooth, sphere, turn

from omnisyn_cli.baselines.two_pass import rasterize_two_pass, triangles_without_caps
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.rasterize import Fragments, rasterize


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


@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_nothing(threads):
    one, many = (two_pass(rough(16, 32), random_pose(51, 1.0), (31, 62), n) for n in (1, threads))
    np.testing.assert_array_equal(many.face, one.face)
    np.testing.assert_array_equal(many.inverse_depth, one.inverse_depth)
