"""Colours on demand are those of the whole picture, of 8 bits too; what a panorama says about points; edge pixels."""

import numpy as np
import pytest
from render_samples import CUTS, POSES, make_renderer, random_pose, rough, smooth

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import direction_tables, pixel_directions
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.render.renderer import MeshRenderer, RendererInputs
from omnisyn_cli.render.shade import Reprojector, Shader
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.types import EDGE_PIXEL_MULTIPLE, EDGE_TILE_COLUMNS, EdgePixels

SIZE = (40, 80)


def renderer(image: np.ndarray, threads: int = 1) -> MeshRenderer:
    surface_confidence = np.random.default_rng(3).uniform(0.2, 1.0, (16, 32))
    return MeshRenderer(RendererInputs(image, None, rough(16, 32), surface_confidence, SIZE, None, threads))


def samples(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(4).integers(0, 256, (height, width, 3), np.uint8)


@pytest.mark.parametrize("name", RENDERERS)
def test_rows_and_crossings_are_those_of_the_whole(name: str) -> None:
    surface_confidence = np.random.default_rng(3).uniform(0.2, 1.0, (16, 32))
    draw = make_renderer(
        name, np.float32(samples(64, 128) / 255), None, rough(16, 32), surface_confidence, SIZE, None, 2
    )
    pose = random_pose(60, 0.4)
    seen = draw(pose)
    assert seen.target_from_source is pose
    colour, out = seen.colour, np.full((7, SIZE[1], 4), np.nan, np.float32)
    for top in (0, 11, 33):
        seen.colour_rows(top, top + 7, out)
        np.testing.assert_allclose(out, colour[top : top + 7], atol=1e-6)
    which = np.array([0, 3, 4, 39]), np.array([1, 2, 50, 79])
    np.testing.assert_allclose(seen.subsampled_colours(*which), colour[np.ix_(*which)], atol=1e-6)


def test_colours_on_demand_are_those_of_the_whole_shader() -> None:
    draw, pose = renderer(samples(64, 128)), random_pose(60, 0.4)
    seen, shader = draw(pose), Shader(SIZE, 2)
    np.testing.assert_allclose(
        seen.colour, shader(seen.inverse_depth, draw.confidence_map, draw.texture, pose), atol=1e-6
    )


@pytest.mark.parametrize("height", [20, 40, 64, 90, 160])
def test_samples_of_eight_bits_look_like_the_numbers_they_stand_for(height: int) -> None:
    """Magnified, as they are and minified: mip levels are rounded by half a level each, places between texels too."""
    image, pose = samples(height, 2 * height), random_pose(61, 0.3)
    exact, rounded = (renderer(each)(pose).colour for each in (np.float32(image / 255.0), image))
    np.testing.assert_allclose(rounded, exact, atol=0.51 / 255)
    if height <= SIZE[0] // 2:
        np.testing.assert_allclose(rounded, exact, atol=0.3 / 255)
        np.testing.assert_allclose(rounded.mean(), exact.mean(), atol=0.01 / 255)


def test_an_alpha_of_samples_is_that_of_numbers() -> None:
    mask = np.random.default_rng(5).random((64, 128)) > 0.3
    image = samples(64, 128)
    whole, small = make_texture(np.float32(image / 255.0), mask), make_texture(image, mask)
    np.testing.assert_allclose(small.texels / 255.0, whole.texels, atol=0.51 / 255)
    assert small.texels.nbytes * 4 == whole.texels.nbytes


def test_rows_that_are_infinitely_far_are_those_of_the_whole_sphere() -> None:
    shader, texture = Shader(SIZE, 1), make_texture(samples(30, 60))
    turn = Pose(random_pose(62, 0.0).rotation, np.zeros(3))
    whole = shader.shade_at_infinity(texture, turn)
    np.testing.assert_allclose(shader.rows_at_infinity(texture, turn, 5, 17), whole[5:17], atol=1e-6)


TARGET_SIZE = (64, 128)
POSE = Pose(rotation_from_heading(0.7, 0.1, -0.2), np.array([0.3, -0.1, 0.4]))


def picture(size=TARGET_SIZE):
    """Smooth, so that how it is read between pixels hardly matters."""
    return (0.5 + 0.4 * np.sin(3.0 * pixel_directions(*size) + 0.3)).astype(np.float32)


def towards(points, size=TARGET_SIZE):
    """Directions in the panorama's frame of points around the target: ``Rᵀ(r − ρ·t)``, not of length 1."""
    away = pixel_directions(*size) - points[..., None] * POSE.position
    return away @ POSE.rotation


def source_sampler(rho=0.2):
    surface = np.full((32, 64), rho)
    return Reprojector(lambda: make_texture(picture()), surface, Shader(TARGET_SIZE, 1)).sampler(POSE)


@pytest.mark.parametrize("size", [TARGET_SIZE, (32, 64)])
def test_a_point_has_the_colour_that_the_photograph_shows_in_its_direction(size):
    points = np.random.default_rng(0).uniform(0.0, 1.0, size).astype(np.float32)
    points[3:6, 5:50] = -1.0
    found = source_sampler().sample(points)
    expected = sample_bilinear(picture().astype(float), towards(points, size))
    is_asked = points >= 0
    np.testing.assert_allclose(found[is_asked, :3], expected[is_asked], atol=0.02)
    np.testing.assert_allclose(found[..., 3], is_asked, atol=1e-6)
    assert not found[~is_asked].any()


def test_rows_are_those_of_the_whole():
    points = np.random.default_rng(1).uniform(-0.3, 1.0, TARGET_SIZE).astype(np.float32)
    asked, out = source_sampler(), np.empty((20, TARGET_SIZE[1], 4), np.float32)
    asked.sample_rows(points[10:30], 10, out)
    np.testing.assert_array_equal(out, asked.sample(points)[10:30])


def test_a_surface_is_nearer_or_farther_than_points():
    """Of a surface that differs everywhere, written out in NumPy; at the seam and at the poles as well."""
    rng = np.random.default_rng(2)
    surface, points = rng.uniform(0.05, 1.0, (32, 64)), rng.uniform(-0.2, 1.0, TARGET_SIZE).astype(np.float32)
    asked = Reprojector(lambda: make_texture(picture()), surface, Shader(TARGET_SIZE, 1)).sampler(POSE)
    found = asked.occlusion(points, 0.1)
    moved = towards(np.maximum(points, 0))
    expected = np.maximum(points, 0) / np.linalg.norm(moved, axis=-1)
    seen = sample_nearest(surface, moved)
    share = (seen - expected) / np.maximum(np.maximum(seen, expected), 0.1)
    assert (np.abs(found - np.where(points >= 0, share, 0)) < 1e-3).mean() > 0.995  # the rest lies between two pixels
    assert not found[points < 0].any()


def test_what_nobody_sees_far_away_does_not_count():
    points = np.zeros(TARGET_SIZE, np.float32)
    assert np.abs(source_sampler(1e-6).occlusion(points, 1e-3)).max() < 2e-3
    assert source_sampler(1.0).occlusion(points, 1e-3).min() == 1.0


@pytest.mark.parametrize("name", RENDERERS)
def test_every_renderer_can_be_asked(name):
    surface = np.full((32, 64), 0.25)
    shown = make_renderer(name, picture(), None, surface, None, TARGET_SIZE, threads=1)(POSE)
    points = np.full(TARGET_SIZE, 0.5, np.float32)
    np.testing.assert_allclose(shown.source_sampler.sample(points), source_sampler().sample(points), atol=1e-6)
    assert np.median(shown.source_sampler.occlusion(shown.inverse_depth, 1e-3)) == pytest.approx(0.0, abs=0.01)


ODD_SIZE = (30, 61)  # An odd number of columns: tiles and vectors end inside of rows.


def edge_pixels_of(marks: np.ndarray, top: int, bottom: int, known: np.ndarray | None = None) -> EdgePixels:
    """Of the marked pixels of some rows; samples that are ``known`` (one for each pixel) are not to be found."""
    sin_table, cos_table = (table.astype(np.float32) for table in direction_tables(*(2 * n for n in marks.shape))[2:])
    cols, edges = [], range(0, marks.shape[1] + EDGE_TILE_COLUMNS, EDGE_TILE_COLUMNS)
    tile_begins = np.empty((bottom - top, -(-marks.shape[1] // EDGE_TILE_COLUMNS) + 1), np.int32)
    unknown_counts, is_sought = np.empty_like(tile_begins), []
    for row in range(top, bottom):
        there = np.flatnonzero(marks[row])
        sought = np.full(len(there), True) if known is None else known[row, there] < 0
        tile_begins[row - top] = [len(cols) + np.searchsorted(there, edge) for edge in edges][: tile_begins.shape[1]]
        unknown_counts[row - top] = [sum(is_sought) + sought[: np.searchsorted(there, edge)].sum() for edge in edges][
            : tile_begins.shape[1]
        ]
        cols += [*there, *[-1] * (-len(there) % EDGE_PIXEL_MULTIPLE)]
        is_sought += [*sought, *[False] * (-len(there) % EDGE_PIXEL_MULTIPLE)]
        tile_begins[row - top, -1] = len(cols)
    cols = np.array(cols, np.int32)
    double = (2 * np.maximum(cols, 0)[:, None] + [0, 1]).ravel()
    start = np.full((2, len(double)), -1.0, np.float32)
    return EdgePixels(top, cols, tile_begins, unknown_counts, start, sin_table[double], cos_table[double])


def at_edge_pixels(image: np.ndarray, edge_pixels: EdgePixels) -> np.ndarray:
    """What a picture of twice the size shows at the samples that are not padding: ``(2, samples, ...)``."""
    rows = edge_pixels.top + np.repeat(
        np.arange(len(edge_pixels.tile_begins)), np.diff([0, *edge_pixels.tile_begins[:, -1]])
    )
    cols = (2 * edge_pixels.cols[:, None] + [0, 1]).ravel()
    return np.stack([image[np.repeat(2 * rows + half, 2), cols] for half in range(2)])[:, cols >= 0]


def renderers(cut: str, path_end: np.ndarray | None = None) -> tuple[MeshRenderer, MeshRenderer]:
    """Of one size and of twice that."""
    rng = np.random.default_rng(5)
    image, surface_confidence = rng.random((64, 128, 3)).astype(np.float32), rng.uniform(0.2, 1.0, (16, 32))
    sizes = ODD_SIZE, (2 * ODD_SIZE[0], 2 * ODD_SIZE[1])
    rho = rough(16, 32) if cut != "whole" else smooth(16, 32)
    inputs = (RendererInputs(image, None, rho, surface_confidence, size, CUTS[cut], 1, path_end) for size in sizes)
    one, two = map(MeshRenderer, inputs)
    return one, two


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
@pytest.mark.parametrize("cut", CUTS)
def test_samples_are_the_pixels_of_twice_the_size(cut: str, pose: Pose) -> None:
    """At every pixel, and at a few: the seam, the poles and quads of any size are among them."""
    one, two = renderers(cut)
    seen, fine = one(pose), two(pose)
    for share, (top, bottom) in ((1.0, (0, ODD_SIZE[0])), (0.2, (0, 11)), (0.1, (11, ODD_SIZE[0]))):
        edge_pixels = edge_pixels_of(np.random.default_rng(6).random(ODD_SIZE) < share, top, bottom)
        rho, colour = seen.edge_samples(edge_pixels)
        real = np.repeat(edge_pixels.cols >= 0, 2)
        np.testing.assert_allclose(rho[:, real], at_edge_pixels(fine.inverse_depth, edge_pixels), rtol=2e-3, atol=2e-5)
        expected = at_edge_pixels(fine.colour, edge_pixels)
        near = np.abs(colour[:, real] - expected).max(axis=-1) < 5e-3
        assert near.mean() > 0.995, "a sample on the border of two quarters may have the confidence of either"


def test_a_simplified_surface_has_the_samples_of_that_surface() -> None:
    one, two = renderers("whole", np.array([0.0, 0.0, -0.5]))
    pose, two.quads = Pose(np.eye(3), np.array([0.0, 0.0, 0.2])), one.quads
    seen, fine = one(pose), two(pose)
    edge_pixels = edge_pixels_of(np.ones(ODD_SIZE, bool), 3, 20)
    rho, _ = seen.edge_samples(edge_pixels)
    real = np.repeat(edge_pixels.cols >= 0, 2)
    np.testing.assert_allclose(rho[:, real], at_edge_pixels(fine.inverse_depth, edge_pixels), rtol=2e-3)


def test_known_samples_stay_and_the_others_are_found() -> None:
    one, two = renderers("default")
    pose = POSES["forward"]
    seen, fine = one(pose), two(pose)
    rng = np.random.default_rng(7)
    known = np.where(np.arange(ODD_SIZE[1]) < 32, 9.0, -1.0) * np.ones(ODD_SIZE)  # nearer than anything
    edge_pixels = edge_pixels_of(rng.random(ODD_SIZE) < 0.5, 0, ODD_SIZE[0], known)
    is_known = np.repeat((edge_pixels.cols >= 0) & (edge_pixels.cols < 32), 2)
    edge_pixels.inverse_depth[:, is_known] = 9.0
    rho, _ = seen.edge_samples(edge_pixels)
    assert (rho[:, is_known] == 9.0).all()
    real = np.repeat(edge_pixels.cols >= 32, 2)
    expected = np.full((2, len(real)), -1.0, np.float32)
    expected[:, np.repeat(edge_pixels.cols >= 0, 2)] = at_edge_pixels(fine.inverse_depth, edge_pixels)
    np.testing.assert_allclose(rho[:, real], expected[:, real], rtol=2e-3, atol=2e-5)
    assert (edge_pixels.inverse_depth[:, real] == -1.0).all(), "edge pixels are not changed"
