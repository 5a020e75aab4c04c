"""Simplified meshes against the mesh they stand for, against closed forms and against the bound they promise."""

import numpy as np
import pytest
from render_samples import WHOLE, make_renderer, moved, random_pose, rough, smooth, turn

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import Cut, build_mesh
from omnisyn_cli.render.rasterize import Rasterizer, rasterize
from omnisyn_cli.render.simplify import MAX_SHIFT_PIXELS, simplify

WAY = np.array([0.4, 0.1, -0.7])
HIGHEST, LOWEST = np.array([3.0, 1.1, 4.0]), np.array([-2.0, -1.6, -3.0])


def room(directions: np.ndarray, position: np.ndarray | None = None) -> np.ndarray:
    """Inverse distance to the walls of a box, closed form."""
    position = np.zeros(3) if position is None else position
    return np.maximum(directions / (HIGHEST - position), directions / (LOWEST - position)).max(axis=-1)


def room_mesh(height: int = 64):
    return build_mesh(room(pixel_directions(height, 2 * height)).astype(np.float32), WHOLE)


def seen(mesh, path, pose: Pose, size: tuple[int, int], threads: int = 1, **options) -> np.ndarray:
    return Rasterizer(size, threads)(simplify(mesh, path, size[0], threads=threads, **options)[0], pose)


def pose_at(path: np.ndarray, share: float, rotation: np.ndarray | None = None) -> Pose:
    """Target from source, of a target at a share of the way."""
    rotation = np.eye(3) if rotation is None else rotation
    return Pose(rotation, -rotation @ (share * path))


def source_directions(rho: np.ndarray, pose: Pose) -> np.ndarray:
    found = (pixel_directions(*rho.shape) - rho[..., None] * pose.position) @ pose.rotation
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a / np.linalg.norm(a, axis=-1, keepdims=True) - b / np.linalg.norm(b, axis=-1, keepdims=True),
                          axis=-1)  # fmt: skip


@pytest.mark.parametrize("surface", ["room", "smooth", "far"])
@pytest.mark.parametrize("tolerance", [MAX_SHIFT_PIXELS, 1.0])
def test_no_vertex_is_seen_further_aside_than_promised_from_anywhere_on_the_way(surface, tolerance):
    """Brute force: their inverse depth at every vertex, both points seen from 21 places on the way."""
    height, rows = 64, 256
    directions = pixel_directions(height, 2 * height)
    rho = {"room": room(directions), "smooth": smooth(height, 2 * height), "far": 0.01 * smooth(height, 2 * height)}
    mesh = build_mesh(rho[surface].astype(np.float32), WHOLE)
    quads, kept = simplify(mesh, WAY, rows, tolerance)
    found = Rasterizer((height, 2 * height), 1)(quads, Pose.identity())
    aside = [angles(directions - s * found[..., None] * WAY, directions - s * mesh.inverse_depth[..., None] * WAY)
             for s in np.linspace(0, 1, 21)]  # fmt: skip
    inner = np.max(aside, axis=0)[1:-1]  # first and last row are rims of the caps
    assert inner.max() <= tolerance * np.pi / rows * 1.02
    if surface != "smooth":
        assert kept < 0.5 * mesh.face_count()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("size", [(50, 100), (150, 300)])
def test_a_closed_room_has_no_cracks_at_any_share_of_the_way_and_in_any_orientation(seed, size):
    rng = np.random.default_rng(seed)
    mesh = room_mesh()
    quads, kept = simplify(mesh, WAY, size[0])
    assert kept < mesh.face_count() / 3
    for share in (0.0, rng.random(), 1.0):
        pose = pose_at(WAY, share, turn(*rng.normal(size=3) * 1.5))
        found = Rasterizer(size, 1)(quads, pose)
        assert (found >= 0).all()


@pytest.mark.parametrize("seed", range(6))
def test_fine_and_coarse_parts_beside_each_other_leave_no_cracks(seed):
    """Bumps of all sizes on a closed surface: quads of every size meet."""
    rng = np.random.default_rng(seed)
    rho = np.full((64, 128), 0.3)
    for _ in range(6):
        i, j, reach = rng.integers(10, 54), rng.integers(0, 120), rng.integers(1, 9)
        rho[i - reach : i + reach, j : j + reach] += rng.uniform(0.0, 0.01, (2 * reach, min(reach, 128 - j)))
    mesh = build_mesh(rho.astype(np.float32), WHOLE)
    quads, _ = simplify(mesh, WAY, 200)
    for share in (0.3, 1.0):
        found = Rasterizer((200, 400), 1)(quads, pose_at(WAY, share, turn(*rng.normal(size=3))))
        assert (found >= 0).all()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_room_looks_as_its_whole_mesh_does_within_the_tolerance(share):
    mesh, size = room_mesh(), (128, 256)
    pose = pose_at(WAY, share, turn(0.2, 1.0, -0.3))
    found, expected = seen(mesh, WAY, pose, size), rasterize(mesh, pose, size, 1).inverse_depth
    aside = angles(source_directions(found, pose), source_directions(expected, pose)) * size[0] / np.pi
    assert np.quantile(aside, 0.99) <= 0.3
    assert aside.max() < 1.0
    truth = room(pixel_directions(*size) @ pose.rotation, share * WAY)
    assert np.median(np.abs(found - truth) / truth) < 2e-3


def test_what_cannot_be_merged_is_drawn_as_the_whole_mesh_is():
    for cut in (Cut(), WHOLE):
        mesh = build_mesh(rough(16, 32), cut)
        for pose in (Pose.identity(), random_pose(70, 0.6), moved(0.3, 0.0, 0.2, rotation=turn(np.pi, 0.0, 0.0))):
            found = seen(mesh, np.array([0.0, 0.0, 50.0]), pose, (48, 96), tolerance=1e-6)
            expected = rasterize(mesh, pose, (48, 96), 1).inverse_depth
            assert np.isclose(found, expected, rtol=1e-3, atol=1e-5).mean() > 0.998


def test_surfaces_that_are_cut_apart_stay_apart_and_holes_open_where_they_did():
    rho = np.full((64, 128), 0.05, np.float32)
    rho[20:44, 40:72] = 0.5
    mesh, path, size = build_mesh(rho), np.array([0.6, 0.0, 0.0]), (128, 256)
    pose = pose_at(path, 1.0)
    found, expected = seen(mesh, path, pose, size), rasterize(mesh, pose, size, 1).inverse_depth
    assert (expected < 0).mean() > 0.005
    assert ((found < 0) == (expected < 0)).mean() > 0.999
    bound = MAX_SHIFT_PIXELS * np.pi / size[0] / 0.6
    assert np.isclose(found, expected, rtol=0.02, atol=1.2 * bound).mean() > 0.995


def test_masked_vertices_have_no_surface():
    mask = np.ones((32, 64), bool)
    mask[8:20, 16:28] = False
    mesh = build_mesh(smooth(32, 64), mask=mask)
    found = seen(mesh, 0.01 * WAY, Pose.identity(), (96, 192))
    np.testing.assert_array_equal(found >= 0, rasterize(mesh, Pose.identity(), (96, 192), 1).visibility)
    assert not (seen(build_mesh(smooth(8, 16), mask=np.zeros((8, 16), bool)), WAY, Pose.identity(), (8, 16)) >= 0).any()


def test_what_is_very_far_becomes_a_few_quads():
    quads, kept = simplify(build_mesh(np.zeros((64, 128), np.float32)), WAY, 64)
    assert kept < 0.06 * 4 * 64 * 128
    assert (Rasterizer((64, 128), 1)(quads, moved(3.0, 0.0, 0.0)) == 0).all()


@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize("surface", [lambda: room_mesh(40), lambda: build_mesh(rough(40, 80))], ids=["room", "rough"])
def test_the_number_of_threads_changes_nothing(threads, surface):
    pose, size = random_pose(71, 0.6), (64, 128)
    one, many = (seen(surface(), WAY, pose, size, n) for n in (1, threads))
    np.testing.assert_array_equal(many, one)


def test_a_renderer_with_a_way_shows_the_same_picture_and_says_how_many_triangles_it_draws():
    size, rows = (96, 192), 48
    rho = room(pixel_directions(rows, 2 * rows)).astype(np.float32)
    image = (0.5 + 0.4 * np.sin(3 * pixel_directions(*size))).astype(np.float32)
    confidence = np.where(np.arange(2 * rows) < rows, 0.5, 1.0) * np.ones((rows, 1), np.float32)
    every, few = (make_renderer("mesh", image, None, rho, confidence, size, WHOLE, 1, path) for path in (None, WAY))
    assert every.triangles[0] == every.triangles[1] == few.triangles[1] > 2 * few.triangles[0]
    pose = pose_at(WAY, 0.6, turn(0.1, 0.4, 0.2))
    expected, found = every(pose).colour, few(pose).colour
    assert np.abs(found - expected)[..., :3].max() < 0.02
    assert (np.abs(found - expected)[..., 3] < 1e-3).mean() > 0.99
