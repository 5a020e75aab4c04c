"""Textures are read as geometry reads them, minified ones are means; vectors against numpy, lane by lane."""

import math

import numpy as np
import pytest
from numba import njit
from render_samples import POSES, WHOLE, moved, noise, rough, shade, smooth, turn

from omnisyn_cli.compute.jit import kernel
from omnisyn_cli.compute.trigonometry import ATAN2_ERROR, LOG2_ERROR, atan2_fast, log2_fast
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bicubic
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render import simd
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


def checkerboard(shape: tuple[int, int]) -> np.ndarray:
    return np.repeat((np.indices(shape).sum(axis=0) % 2).astype(np.float32)[..., None], 3, axis=2)


def test_a_minified_checkerboard_is_grey():
    board = checkerboard((128, 256))
    found = shaded(board, smooth(16, 32), Pose.identity(), (16, 32))
    np.testing.assert_allclose(found[..., :3], 0.5, atol=1e-3)
    approached = shaded(board, np.full((16, 32), 0.5, np.float32), moved(0.0, 0.0, -1.9), (128, 256))
    far_side = approached[60:68, 120:136, :3]
    assert np.abs(far_side - 0.5).max() < 0.3 < np.abs(board[60:68, 120:136] - 0.5).max()


@pytest.mark.parametrize("shape", [(129, 258), (130, 260), (127, 254)])
def test_a_minified_checkerboard_of_an_odd_size_is_grey(shape):
    found = shaded(checkerboard(shape), smooth(16, 32), Pose.identity(), (16, 32))
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


def test_a_sky_at_infinity_only_turns():
    image, shader, rotation = noise(16, 32), Shader((24, 48)), turn(0.3, -0.2, 1.0)
    found = shader.shade_at_infinity(make_texture(image), moved(5.0, -3.0, 2.0, rotation=rotation))
    expected = sample_bicubic(image, pixel_directions(24, 48) @ rotation)
    np.testing.assert_allclose(found[..., :3], expected, atol=1e-4)


@njit
def atan2_of(y, x):
    return np.array([atan2_fast(y[k], x[k]) for k in range(len(y))])


@njit
def log2_of(x):
    return np.array([log2_fast(value) for value in x])


def test_fast_functions_are_as_exact_as_they_say():
    """They are only ever inlined into loops."""
    y, x = np.random.default_rng(21).normal(size=(2, 20_000)).astype(np.float32)
    y[:4], x[:4] = [0, 0, 1, -1], [1, -1, 0, 0]
    np.testing.assert_allclose(atan2_of(y, x), np.arctan2(y.astype(float), x.astype(float)), atol=ATAN2_ERROR)
    assert atan2_of(np.zeros(1, np.float32), np.zeros(1, np.float32)) == [0.0]
    near_one = np.linspace(0.5, 2.0, 10_001).astype(np.float32)
    np.testing.assert_allclose(log2_of(near_one), np.log2(near_one.astype(float)), atol=LOG2_ERROR)
    anything = np.exp(np.linspace(-40, 40, 1001)).astype(np.float32)
    np.testing.assert_allclose(log2_of(anything), np.log2(anything.astype(float)), atol=1e-5)


def test_the_first_level_is_the_image_with_a_wrapped_border():
    image = noise(8, 16)
    texture = make_texture(image)
    level = texture.texels[: 12 * 20 * 4].reshape(12, 20, 4)
    np.testing.assert_array_equal(level[2:-2, 2:-2, :3], image)
    np.testing.assert_array_equal(level[2:-2, 1, :3], image[:, -1])
    np.testing.assert_array_equal(level[2:-2, -2, :3], image[:, 0])
    np.testing.assert_array_equal(level[1, 2:-2, :3], np.roll(image[0], 8, axis=0))
    np.testing.assert_array_equal(level[-1, 2:-2, :3], np.roll(image[-2], 8, axis=0))


@pytest.mark.parametrize(("shape", "levels"), [((64, 128), 4), ((8, 16), 1), ((9, 18), 2), ((20, 40), 3), ((2, 4), 1)])
def test_levels_end_at_eight_rows(shape, levels):
    assert len(make_texture(noise(*shape)).layout) == levels


@kernel(cache=False)
def arithmetic(a, b, out):
    x, y = simd.load(a, 1), simd.load(b, 1)
    simd.store(out, 0, x + y)
    simd.store(out, 8, x - y)
    simd.store(out, 16, x * y)
    simd.store(out, 24, x / y)
    simd.store(out, 32, simd.to_float32(simd.to_float64(x) * simd.to_float64(y)))


@kernel(cache=False)
def choices(a, b, flags, bits, out):
    x, y, one, zero = simd.load(a, 0), simd.load(b, 0), simd.broadcast(np.float32(1.0)), simd.broadcast(np.float32(0.0))
    simd.store(out, 0, simd.where(x >= y, one, zero))
    simd.store(out, 8, simd.where(x > y, one, zero))
    simd.store(out, 16, simd.where((x >= y) & (y > zero), one, zero))
    simd.store(out, 24, simd.where((x > y) | (y > x), one, zero))
    simd.store(out, 32, simd.where(simd.has_bits(flags, 3, bits), one, zero))


@kernel(cache=False)
def halves(a, out, numbers):
    x = simd.load_halves(a, 2, 11)
    simd.store(out, 0, x)
    simd.store(out, 16, simd.pair(np.float32(3.0), np.float32(4.0)))
    simd.store_halves(out, 36, 28, x)
    simd.store_halves(numbers, 4, 0, simd.load_halves(numbers, 0, 4))


@pytest.fixture
def two() -> np.ndarray:
    return np.random.default_rng(0).uniform(0.5, 2.0, (2, 32)).astype(np.float32)


def test_arithmetic_is_numpy_s(two):
    a, b, out = *two, np.zeros(5 * simd.LANES, np.float32)
    arithmetic(a, b, out)
    x, y = two[:, 1:9]
    exact = (x.astype(float) * y.astype(float)).astype(np.float32)
    np.testing.assert_array_equal(out.reshape(5, simd.LANES), [x + y, x - y, x * y, x / y, exact])


def test_masks_choose_lane_by_lane(two):
    a, b, out = *two, np.zeros(5 * simd.LANES, np.float32)
    b[:4] = a[:4]
    b[7] = -1.0
    flags, bits = np.arange(32, dtype=np.uint8), np.uint8(6)
    choices(a, b, flags, bits, out)
    x, y = a[:8], b[:8]
    expected = [x >= y, x > y, (x >= y) & (y > 0), x != y, (flags[3:11] & bits) != 0]
    np.testing.assert_array_equal(out.reshape(5, simd.LANES), expected)


def test_comparisons_with_nan_are_false(two):
    a, b, out = *two, np.zeros(5 * simd.LANES, np.float32)
    a[:8] = np.nan
    choices(a, b, np.zeros(32, np.uint8), np.uint8(1), out)
    assert not out.any()


def test_halves_come_from_and_go_to_different_places(two):
    a, out, numbers = two[0], np.zeros(40, np.float32), np.arange(8, dtype=np.int32)
    halves(a, out, numbers)
    lower, upper = a[2:6], a[11:15]
    expected = [lower, upper, [0] * 4, [0] * 4, [3] * 4, [4] * 4, [0] * 4, upper, [0] * 4, lower]
    np.testing.assert_array_equal(out.reshape(10, 4), expected)
    assert numbers.tolist() == [4, 5, 6, 7, 0, 1, 2, 3]


@kernel(cache=False)
def sums(texels, of_rows, of_columns, once, twice, out):
    simd.prefetch(texels, 1 << 20)
    rows = simd.load_texels(texels, 4) * simd.broadcast_weight(of_rows, 1) + simd.load_texels(
        texels, 24
    ) * simd.broadcast_weight(of_rows, 2)
    simd.store_texel_sum(out, 0, rows * simd.load_four_weights(of_columns, 2), twice, np.float32(0.5), np.float32(3.0))
    pairs = simd.load_texel_pairs(texels, 4, 28) * simd.load_four_weights(of_columns, 1)
    simd.store_texel_sum(out, 4, pairs, once, np.float32(0.0), np.float32(1.0))


def test_texels_are_weighted_and_summed():
    """To rounding as numbers; as integers to a 32nd of a level for each product, which are cut off."""
    rng = np.random.default_rng(1)
    texels, weights, out = rng.integers(0, 256, 48), rng.uniform(-0.1, 0.7, 8), np.zeros(8, np.float32)
    rows = texels[4:20] * weights[1] + texels[24:40] * weights[2]
    pairs = np.concatenate([texels[4:12], texels[28:36]])
    four = (weights[2:6] @ rows.reshape(4, 4)) * [1, 1, 1, 3] + [0.5, 0.5, 0.5, 0]
    expected = np.concatenate([four, weights[1:5] @ pairs.reshape(4, 4)])
    one = np.float32(1.0)
    sums(texels.astype(np.float32), *[weights.astype(np.float32)] * 2, one, one, out)
    np.testing.assert_allclose(out, expected, rtol=1e-5)
    fixed, once = np.rint(weights * simd.FIXED_POINT_UNIT).astype(np.int16), np.float32(2.0 / simd.FIXED_TEXEL)
    sums(texels.astype(np.uint8), np.repeat(fixed, 2).view(np.int32), fixed, once, 2 * once, out)
    errors = (expected - out) / [1, 1, 1, 3, 1, 1, 1, 1]
    assert ((errors > 0) & (errors < 6 / 32)).all()
