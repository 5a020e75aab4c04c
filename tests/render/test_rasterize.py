"""Drawing against plain loops and closed forms: panoramas, perspective pictures, both eyes."""

import math

import numpy as np
import pytest
from render_samples import CUTS, POSES, WHOLE, is_unambiguous, moved, random_pose, rough, smooth, sphere, turn

from omnisyn_cli.geometry.perspective import PerspectiveSize, cell_directions, target_tables
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render import quad_kernels
from omnisyn_cli.render.eyes import EYE_DISTANCE, top_bottom
from omnisyn_cli.render.mesh import Mesh, build_mesh
from omnisyn_cli.render.quad_blocks import FACES_PER_QUAD
from omnisyn_cli.render.rasterize import Rasterizer, rasterize
from omnisyn_cli.render.simplify import simplify
from reference_rasterizer import rasterize_reference


def assert_equal_to_the_oracle(mesh: Mesh, pose: Pose, size: tuple[int, int], *, clear: float = 0.8) -> None:
    """Same faces and inverse depths wherever there is only one right answer, which is nearly everywhere."""
    triangles = mesh.triangles()
    found, expected = rasterize(mesh, pose, size), rasterize_reference(triangles, pose, size)
    where = is_unambiguous(triangles, pose, size)
    assert where.mean() >= clear
    np.testing.assert_array_equal(found.face[where], expected.face[where])
    np.testing.assert_allclose(found.inverse_depth[where], expected.inverse_depth[where], rtol=1e-4, atol=1e-5)


class TestOracle:
    @pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
    @pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
    def test_agrees_for_rough_surfaces(self, cut, pose):
        assert_equal_to_the_oracle(build_mesh(rough(6, 12), cut), pose, (17, 38))

    @pytest.mark.parametrize("seed", range(12))
    def test_agrees_for_random_surfaces_masks_and_poses(self, seed):
        rng = np.random.default_rng(seed)
        height, width = rng.integers(2, 10), rng.integers(2, 14)
        mask = rng.random((height, width)) > 0.2
        mesh = build_mesh(rough(height, width, seed), list(CUTS.values())[seed % len(CUTS)], mask)
        assert_equal_to_the_oracle(mesh, random_pose(seed, rng.uniform(0, 4)), (15, 28))

    @pytest.mark.parametrize("width", [1, 3, 4, 7, 8, 9, 15, 16, 17, 33])
    def test_agrees_for_targets_narrower_than_a_vector_and_just_wider(self, width):
        assert_equal_to_the_oracle(build_mesh(rough(7, 13)), random_pose(20, 0.9), (9, width), clear=0.0)

    @pytest.mark.parametrize("shape", [(2, 2), (2, 3), (3, 2), (4, 8)])
    @pytest.mark.parametrize("size", [(1, 1), (1, 2), (7, 5), (9, 64), (33, 8)])
    def test_agrees_for_tiny_meshes_and_odd_targets(self, shape, size):
        assert_equal_to_the_oracle(build_mesh(smooth(*shape)), random_pose(5, 0.5), size, clear=0.0)

    def test_agrees_for_a_target_much_finer_than_the_mesh(self):
        assert_equal_to_the_oracle(build_mesh(smooth(4, 8), WHOLE), random_pose(6, 0.8), (60, 120))


class TestClosedForms:
    @pytest.mark.parametrize("seed", range(4))
    def test_a_sphere_seen_from_inside(self, seed):
        """Vertices on a sphere of 5 m; faces are flat, so the surface lies at most their sagitta inside it."""
        pose = random_pose(seed, 3.0)
        found = rasterize(build_mesh(np.full((128, 256), 0.2, np.float32)), pose, (40, 80)).inverse_depth
        expected = sphere(pose.position, 5.0, pixel_directions(40, 80))
        assert (found >= expected * (1 - 1e-5)).all()
        np.testing.assert_allclose(found, expected, rtol=2e-3)

    def test_a_plane_is_exact_however_large_its_triangles_are(self):
        """Ground 1.6 m below, on a mesh of 8 rows only: inverse depth is linear in the ray, and edges are straight."""
        height = 1.6
        ground = np.maximum(0.0, -pixel_directions(8, 16)[..., 1]) / height
        pose = moved(0.7, 0.4, -1.1, rotation=turn(0.2, 1.0, -0.3))
        mesh = build_mesh(ground.astype(np.float32), WHOLE)
        target_up = pose.rotation @ [0.0, 1.0, 0.0]
        below = -pixel_directions(64, 128) @ target_up
        expected = below / (height - target_up @ pose.position)
        found = rasterize(mesh, pose, (64, 128))
        first_ground_quad = 4 * 16  # those above it reach up to the sky
        where = (found.face >= FACES_PER_QUAD * first_ground_quad) & (found.face < FACES_PER_QUAD * mesh.quads.size)
        assert where.mean() > 0.2
        np.testing.assert_allclose(found.inverse_depth[where], expected[where], rtol=1e-5)


class TestSymmetry:
    @pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
    def test_the_identity_pose_returns_the_inverse_depths_without_holes(self, cut):
        rho = rough(16, 32)
        found = rasterize(build_mesh(rho, cut), Pose.identity(), rho.shape)
        assert found.visibility.all()
        np.testing.assert_allclose(found.inverse_depth[1:-1], rho[1:-1], rtol=1e-5, atol=1e-6)
        for row in (0, -1):  # a ring of pixels on the edge of a cap whose flat wedges are as far as a neighbour
            neighbours = np.stack([np.roll(rho[row], shift) for shift in (-1, 0, 1)])
            assert np.isclose(found.inverse_depth[row], neighbours, atol=1e-6).any(axis=0).all()

    @pytest.mark.parametrize("shift", [1, 7, 20])
    def test_turning_the_target_rolls_the_image(self, shift):
        mesh, pose = build_mesh(smooth(16, 32)), random_pose(9, 0.6)
        turned = Pose(turn(0.0, -2 * math.pi * shift / 40, 0.0), np.zeros(3)) @ pose
        one, two = (rasterize(mesh, p, (20, 40)).inverse_depth for p in (pose, turned))
        np.testing.assert_allclose(two, np.roll(one, shift, axis=1), rtol=1e-4)

    @pytest.mark.parametrize("seed", range(20))
    def test_a_surface_seen_from_within_has_no_holes_at_seam_and_poles_for_any_rotation(self, seed):
        mesh, pose = build_mesh(smooth(24, 48, seed), WHOLE), random_pose(seed, 0.4)
        assert rasterize(mesh, pose, (50, 100)).visibility.all()

    @pytest.mark.parametrize("columns", [16, 24, 40])
    def test_edges_that_bulge_beyond_the_rows_of_their_ends_leave_no_holes(self, columns):
        """An arc between two vertices of one row comes closer to the pole than they are, here by up to two pixels."""
        mesh = build_mesh(np.full((8, columns), 0.5, np.float32), WHOLE)
        for pose in (Pose.identity(), moved(0.0, 0.1, 0.0)):
            assert rasterize(mesh, pose, (300, 600)).visibility.all()

    @pytest.mark.parametrize("axis", np.eye(3))
    def test_rays_exactly_through_vertices_and_edges_see_a_surface(self, axis):
        """Quarter turns put vertices, edges and the poles of the mesh onto pixel centres."""
        mesh = build_mesh(np.full((9, 20), 0.5, np.float32), WHOLE)
        for quarters in range(1, 4):
            pose = moved(0.0, 0.0, 0.0, rotation=turn(*(axis * quarters * math.pi / 2)))
            assert rasterize(mesh, pose, (45, 100)).visibility.all()

    @pytest.mark.parametrize("size", [(31, 62), (64, 128)])
    @pytest.mark.parametrize("threads", [2, 3, 8])
    def test_the_number_of_threads_changes_nothing(self, threads, size):
        mesh, pose = build_mesh(rough(20, 40)), random_pose(10, 1.5)
        one, many = (rasterize(mesh, pose, size, n) for n in (1, threads))
        np.testing.assert_array_equal(many.face, one.face)
        np.testing.assert_array_equal(many.inverse_depth, one.inverse_depth)

    def test_a_rasterizer_remembers_nothing_of_the_frame_before(self):
        mesh, reused = build_mesh(rough(12, 24)), Rasterizer((20, 40))
        for pose in POSES.values():
            found = reused(mesh.blocks, pose)
            np.testing.assert_array_equal(found, rasterize(mesh, pose, (20, 40)).inverse_depth)


class TestVisibility:
    def test_cuts_open_holes_and_whole_meshes_do_not(self):
        rho = np.full((32, 64), 0.1, np.float32)
        rho[8:24, 24:40] = 0.5
        pose = moved(0.6, 0.0, 0.0)
        assert (~rasterize(build_mesh(rho), pose, (64, 128)).visibility).mean() > 0.005
        between = rasterize(build_mesh(rho, WHOLE), pose, (64, 128)).inverse_depth
        assert ((between > 0.15) & (between < 0.3)).any()

    def test_masked_pixels_leave_a_hole_of_their_own_shape(self):
        mask = np.ones((16, 32), bool)
        mask[4:10, 8:14] = False
        found = rasterize(build_mesh(smooth(16, 32), mask=mask), Pose.identity(), (160, 320))
        expected = np.kron(mask, np.ones((10, 10), bool))
        assert (found.visibility == expected).mean() > 0.999  # but for pixels on the border, as great circles bulge
        assert not found.visibility[42:98, 82:138].any()

    def test_a_mesh_that_is_masked_away_is_seen_nowhere(self):
        mesh = build_mesh(smooth(8, 16), mask=np.zeros((8, 16), bool))
        assert mesh.face_count() == 0
        assert not rasterize(mesh, Pose.identity(), (8, 16)).visibility.any()

    @pytest.mark.parametrize("distance", [1.999, 2.0, 2.001, 100.0])
    def test_a_camera_that_crosses_the_surface_sees_numbers(self, distance):
        for direction in (np.eye(3)[0], np.eye(3)[1], pixel_directions(16, 32)[3, 4]):
            mesh = build_mesh(np.full((16, 32), 0.5, np.float32))
            found = rasterize(mesh, Pose(np.eye(3), -distance * direction), (20, 40))
            assert np.isfinite(found.inverse_depth).all()
            assert ((found.inverse_depth >= 0) == found.visibility).all()


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


def test_edges_overlap_by_less_than_the_tests_allow():
    assert quad_kernels.EDGE_OVERLAP_RADIANS * np.sqrt(3) < 1e-6


def rays_of(size: PerspectiveSize, fov: float) -> np.ndarray:
    """Rays of length 1 along the axis, from the definition of a pinhole camera with pixel centres at ½."""
    height, width = size
    step = 2 * math.tan(fov / 2) / width
    x, y = (np.arange(width) + 0.5 - width / 2) * step, (height / 2 - np.arange(height) - 0.5) * step
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1)


def assert_equal_in_perspective(mesh: Mesh, pose: Pose, shape: tuple[int, int], fov: float) -> None:
    """Nearly everywhere the same face; there the same inverse distance along the axis."""
    size = PerspectiveSize(*shape, fov)
    drawn = np.empty(shape[0] * shape[1], np.int32)
    inverse_depth = Rasterizer(size, threads=2)(mesh.blocks, pose, drawn)
    expected = rasterize_reference(mesh.triangles(), pose, shape, rays_of(size, fov))
    is_same = mesh.face_numbers(drawn).reshape(shape) == expected.face
    assert is_same.mean() > 0.97
    np.testing.assert_allclose(inverse_depth[is_same], expected.inverse_depth[is_same], rtol=1e-3, atol=2e-5)


@pytest.mark.parametrize("fov", [0.6, 1.6, 2.4])
@pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
def test_rough_surfaces(cut, fov):
    assert_equal_in_perspective(build_mesh(rough(6, 12), cut), random_pose(3, 0.7), (27, 48), fov)


@pytest.mark.parametrize("seed", range(10))
def test_random_surfaces_and_poses(seed):
    """Also from far outside of the middle, with large quads beside and behind the camera."""
    rng = np.random.default_rng(seed)
    mesh = build_mesh(rough(*rng.integers(2, 14, 2), seed), list(CUTS.values())[seed % len(CUTS)])
    assert_equal_in_perspective(mesh, random_pose(seed, rng.uniform(0, 3)), (18, 32), rng.uniform(0.5, 2.5))


@pytest.mark.parametrize("shape", [(1, 1), (5, 3), (9, 64)])
def test_tiny_and_odd_pictures(shape):
    assert_equal_in_perspective(build_mesh(smooth(4, 8), WHOLE), random_pose(6, 0.3), shape, 1.2)


def test_simplified_surfaces_have_no_gaps():
    mesh, pose = build_mesh(smooth(32, 64), WHOLE), Pose(np.eye(3), np.array([0.2, 0.1, 0.5]))
    quads, count = simplify(mesh, -pose.position, 400)
    assert count < mesh.face_count()
    assert (Rasterizer(PerspectiveSize(90, 160, 1.6))(quads, pose) > 0).all()


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
