import math

import numpy as np
import pytest
from render_samples import POSES, WHOLE, moved, noise, rough, shade, smooth, turn

from omnisyn_cli.compute.trigonometry import ATAN2_ERROR, atan2_fast
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bicubic
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.rasterize import rasterize
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture


def shaded(image: np.ndarray, rho: np.ndarray, pose: Pose, size: tuple[int, int], threads: int = 1) -> np.ndarray:
    mesh = build_mesh(rho, WHOLE)
    return shade(rasterize(mesh, pose, size).inverse_depth, mesh, make_texture(image), pose, threads)


@pytest.mark.parametrize("shape", [(2, 4), (4, 8), (9, 18), (32, 64)])
def test_the_identity_pose_returns_the_image(shape):
    image = noise(*shape)
    found = shaded(image, rough(*shape), Pose.identity(), shape)
    np.testing.assert_allclose(found[..., :3], image, atol=2e-5)
    even = shaded(image, np.full(shape, 0.3), Pose.identity(), shape)
    np.testing.assert_allclose(even[..., 3], 1.0, atol=1e-6)


@pytest.mark.parametrize("pose", [pose for name, pose in POSES.items() if name != "outside"])
def test_magnified_textures_are_read_as_geometry_reads_them(pose):
    """At the direction ``Rᵀ(r − ρ·t)``, across seam and poles."""
    image, size = noise(8, 16), (24, 48)
    mesh = build_mesh(smooth(8, 16), WHOLE)
    fragments = rasterize(mesh, pose, size)
    found = shade(fragments.inverse_depth, mesh, make_texture(image), pose)
    rays = pixel_directions(*size) - fragments.inverse_depth[..., None] * pose.position
    directions = rays @ pose.rotation
    magnified = fragments.visibility & (np.linalg.norm(directions, axis=-1) > 8 / 24)
    assert magnified.any()
    np.testing.assert_allclose(found[magnified, :3], sample_bicubic(image, directions)[magnified], atol=1e-4)


def test_a_magnified_ramp_is_reproduced():
    ramp = np.repeat(np.linspace(0, 1, 32, dtype=np.float32)[:, None, None], 64, axis=1) * np.ones(3, np.float32)
    expected = np.interp((np.arange(96) + 0.5) / 3 - 0.5, np.arange(32), np.linspace(0, 1, 32))
    found = shaded(ramp, smooth(8, 16), Pose.identity(), (96, 192))
    np.testing.assert_allclose(found[6:-6, :, 0], np.broadcast_to(expected[6:-6, None], (84, 192)), atol=1e-5)


def test_a_minified_checkerboard_is_grey():
    board = np.repeat((np.indices((128, 256)).sum(axis=0) % 2).astype(np.float32)[..., None], 3, axis=2)
    found = shaded(board, smooth(16, 32), Pose.identity(), (16, 32))
    np.testing.assert_allclose(found[..., :3], 0.5, atol=1e-3)
    approached = shaded(board, np.full((16, 32), 0.5, np.float32), moved(0.0, 0.0, -1.9), (128, 256))
    far_side = approached[60:68, 120:136, :3]
    assert np.abs(far_side - 0.5).max() < 0.3 < np.abs(board[60:68, 120:136] - 0.5).max()


@pytest.mark.parametrize("shape", [(129, 258), (130, 260), (127, 254)])
def test_a_minified_checkerboard_of_an_odd_size_is_grey(shape):
    board = np.repeat((np.indices(shape).sum(axis=0) % 2).astype(np.float32)[..., None], 3, axis=2)
    found = shaded(board, smooth(16, 32), Pose.identity(), (16, 32))
    assert found[..., :3].std() < 0.02
    assert found[..., :3].mean() == pytest.approx(0.5, abs=0.01)


def test_a_minified_image_keeps_its_mean():
    image = noise(64, 128)
    found = shaded(image, smooth(8, 16), Pose.identity(), (16, 32))
    assert found[..., :3].mean() == pytest.approx(image.mean(), abs=2e-3)
    assert found[..., :3].std() < 0.4 * image.std()


@pytest.mark.parametrize("ratio", [2, 3, 4])
def test_a_minified_image_that_is_read_between_its_texels_stays_sharp(ratio):
    """Half a pixel aside three quarters remain of a wave of four pixels; of the level itself 0.64 to 0.72 would."""
    cols = 256
    waves = np.cos(np.arange(ratio * cols) * (2 * math.pi / (4 * ratio)) + 1.0).astype(np.float32)
    image = np.broadcast_to(0.5 + 0.5 * waves[None, :, None], (len(waves) // 2, len(waves), 3))
    pose = Pose(turn(0.0, math.pi / cols, 0.0), np.zeros(3))
    found = shaded(image, np.zeros((8, 16), np.float32), pose, (cols // 2, cols))[cols // 4, :, 0] - 0.5
    amplitude = 2.0 / cols * np.abs(found @ np.exp(0.5j * math.pi * np.arange(cols)))
    assert 0.75 < 2.0 * amplitude < 1.0


def test_alpha_is_the_mask_and_trust_multiplies_it():
    mask = np.ones((16, 32), bool)
    mask[:, :8] = False
    confidence = np.full((16, 32), 0.25, np.float32)
    mesh = build_mesh(smooth(16, 32), WHOLE, confidence=confidence)
    fragments = rasterize(mesh, Pose.identity(), (16, 32))
    found = shade(fragments.inverse_depth, mesh, make_texture(noise(16, 32), mask), Pose.identity())[..., 3]
    quads = fragments.face < 8 * mesh.quads.size
    np.testing.assert_allclose(found[quads & mask], 0.25, atol=1e-4)
    np.testing.assert_allclose(found[~mask], 0.0, atol=1e-4)


def test_what_sees_nothing_is_zero():
    mesh, pose = build_mesh(np.full((16, 32), 0.5, np.float32)), moved(0.0, 0.0, -5.0)
    fragments = rasterize(mesh, pose, (16, 32))
    found = shade(fragments.inverse_depth, mesh, make_texture(noise(16, 32)), pose)
    assert not fragments.visibility.all()
    assert (found[~fragments.visibility] == 0).all()
    assert np.isfinite(found).all()


@pytest.mark.parametrize("shift", [1, 9])
def test_rolling_image_and_mesh_and_turning_the_camera_back_changes_nothing(shift):
    image, rho = noise(16, 32), smooth(16, 32)
    back = turn(0.0, 2 * math.pi * shift / 32, 0.0)
    pose = moved(0.2, 0.1, -0.4, rotation=turn(0.3, 0.2, 0.1))
    one = shaded(image, rho, pose, (20, 40))
    rolled = Pose(pose.rotation @ back, pose.position)
    two = shaded(np.roll(image, shift, axis=1), np.roll(rho, shift, axis=1), rolled, (20, 40))
    np.testing.assert_allclose(two, one, atol=2e-3)


@pytest.mark.parametrize("threads", [2, 5])
def test_the_number_of_threads_changes_nothing(threads):
    image, rho, pose = noise(32, 64), smooth(16, 32), moved(0.3, 0.2, -0.5)
    one, many = (shaded(image, rho, pose, (31, 62), threads=n) for n in (1, threads))
    np.testing.assert_array_equal(many, one)


def test_a_sky_at_infinity_only_turns():
    image, shader, rotation = noise(16, 32), Shader((24, 48)), turn(0.3, -0.2, 1.0)
    found = shader.shade_at_infinity(make_texture(image), moved(5.0, -3.0, 2.0, rotation=rotation))
    expected = sample_bicubic(image, pixel_directions(24, 48) @ rotation)
    np.testing.assert_allclose(found[..., :3], expected, atol=1e-4)


def test_the_fast_arctangent_is_as_exact_as_it_says():
    y, x = np.random.default_rng(21).normal(size=(2, 20_000)).astype(np.float32)
    y[:4], x[:4] = [0, 0, 1, -1], [1, -1, 0, 0]
    from numba import njit  # the kernel is only ever inlined into loops

    @njit
    def all_of(y, x):
        return np.array([atan2_fast(y[k], x[k]) for k in range(len(y))])

    np.testing.assert_allclose(all_of(y, x), np.arctan2(y.astype(float), x.astype(float)), atol=ATAN2_ERROR)
    assert all_of(np.zeros(1, np.float32), np.zeros(1, np.float32)) == [0.0]
