import math

import numpy as np
import pytest
from render_samples import CUTS, POSES, WHOLE, is_unambiguous, moved, random_pose, rough, smooth, sphere, turn

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import Mesh, build_mesh
from omnisyn_cli.render.quad_blocks import FACES_PER_QUAD
from omnisyn_cli.render.rasterize import NO_FACE, Fragments, Rasterizer, rasterize
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

    def test_infinity_stays_where_it_is_when_the_camera_moves(self):
        sky = np.zeros((6, 12), np.float32)
        still, far = (rasterize(build_mesh(sky), moved(*at), (20, 40)) for at in ((0, 0, 0), (1e3, -2e3, 5e2)))
        np.testing.assert_array_equal(far.face, still.face)
        assert (far.inverse_depth == 0).all()

    def test_the_sky_is_behind_everything(self):
        rho = np.zeros((16, 32), np.float32)
        rho[6:10, 12:20] = 0.2
        found = rasterize(build_mesh(rho), Pose.identity(), (16, 32)).inverse_depth
        np.testing.assert_allclose(found, rho, atol=1e-6)

    def test_scaling_the_world_changes_nothing_but_the_unit(self):
        pose = random_pose(7, 0.6)
        one = rasterize(build_mesh(rough(8, 16)), pose, (24, 48))
        ten = rasterize(build_mesh(rough(8, 16) / 8), Pose(pose.rotation, pose.position * 8), (24, 48))
        np.testing.assert_array_equal(ten.face, one.face)
        np.testing.assert_array_equal(ten.inverse_depth[one.visibility] * 8, one.inverse_depth[one.visibility])


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

    @pytest.mark.parametrize("shift", [1, 5, 16, 31])
    def test_rolling_the_mesh_and_turning_the_camera_back_changes_nothing(self, shift):
        rho, pose = smooth(16, 32), random_pose(8, 0.6)
        turned = turn(0.0, -2 * math.pi * shift / 32, 0.0)
        rolled_pose = Pose(pose.rotation @ turned.T, pose.position)
        one = rasterize(build_mesh(rho), pose, (25, 50)).inverse_depth
        two = rasterize(build_mesh(np.roll(rho, shift, axis=1)), rolled_pose, (25, 50)).inverse_depth
        np.testing.assert_allclose(two, one, rtol=1e-4)

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

    @pytest.mark.parametrize("threads", [2, 3, 8])
    def test_the_number_of_threads_changes_nothing(self, threads):
        mesh, pose = build_mesh(rough(20, 40)), random_pose(10, 1.5)
        one, many = (rasterize(mesh, pose, (31, 62), n) for n in (1, threads))
        np.testing.assert_array_equal(many.face, one.face)
        np.testing.assert_array_equal(many.inverse_depth, one.inverse_depth)

    def test_a_rasterizer_remembers_nothing_of_the_frame_before(self):
        mesh, reused = build_mesh(rough(12, 24)), Rasterizer((20, 40))
        for pose in POSES.values():
            found = reused(mesh.blocks, pose)
            np.testing.assert_array_equal(found, rasterize(mesh, pose, (20, 40)).inverse_depth)

    def test_inverse_depth_alone_is_that_of_the_fragments(self):
        mesh = build_mesh(rough(24, 48))
        for pose in POSES.values():
            alone = Rasterizer((40, 80))(mesh.blocks, pose)
            np.testing.assert_array_equal(alone, rasterize(mesh, pose, (40, 80)).inverse_depth)


class TestVisibility:
    def test_backs_of_faces_are_culled(self):
        """From outside a sphere only the inside of its far half is seen."""
        pose = moved(0.0, 0.0, -12.0)
        found = rasterize(build_mesh(np.full((64, 128), 0.2, np.float32)), pose, (65, 128))
        assert not found.visibility[:, :32].any()
        distance = 1.0 / found.inverse_depth[found.visibility]
        assert distance.min() > math.sqrt(12**2 - 5**2) - 0.05
        assert distance.max() == pytest.approx(17.0, rel=1e-3)

    def test_the_nearest_surface_wins(self):
        rho = np.full((32, 64), 0.1, np.float32)
        rho[8:24, 24:40] = 0.5
        found = rasterize(build_mesh(rho), moved(0.0, 0.0, 1.0), (32, 64))
        assert found.inverse_depth[16, 32] == pytest.approx(1.0, rel=1e-2)

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

    def test_fragments_say_where_nothing_is_seen(self):
        fragments = Fragments(np.array([[-1.0, 0.0]], np.float32), np.array([[NO_FACE, 3]], np.int32))
        assert fragments.visibility.tolist() == [[False, True]]
