"""Samples of edge pixels are the pixels of a target of twice the size: inverse depth and colours, whatever is drawn."""

import numpy as np
import pytest
from render_samples import CUTS, POSES, rough, smooth

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.render.renderer import MeshRenderer, RendererInputs
from omnisyn_cli.types import EDGE_PIXEL_MULTIPLE, EDGE_TILE_COLUMNS, EdgePixels

SIZE = (30, 61)
"""An odd number of columns: tiles and vectors end inside of rows."""


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
    sizes = SIZE, (2 * SIZE[0], 2 * SIZE[1])
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
    assert seen.edge_samples is not None
    for share, (top, bottom) in ((1.0, (0, SIZE[0])), (0.2, (0, 11)), (0.1, (11, SIZE[0]))):
        edge_pixels = edge_pixels_of(np.random.default_rng(6).random(SIZE) < share, top, bottom)
        rho, colour = seen.edge_samples(edge_pixels)
        real = np.repeat(edge_pixels.cols >= 0, 2)
        np.testing.assert_allclose(rho[:, real], at_edge_pixels(fine.inverse_depth, edge_pixels), rtol=2e-3, atol=2e-5)
        expected = at_edge_pixels(fine.colour, edge_pixels)
        near = np.abs(colour[:, real] - expected).max(axis=-1) < 5e-3
        assert near.mean() > 0.995, "a sample on the border of two quarters may have the confidence of either"


def test_a_simplified_surface_has_the_samples_of_that_surface() -> None:
    one, two = renderers("whole", np.array([0.0, 0.0, -0.5]))
    pose, two._quads = Pose(np.eye(3), np.array([0.0, 0.0, 0.2])), one._quads
    seen, fine = one(pose), two(pose)
    edge_pixels = edge_pixels_of(np.ones(SIZE, bool), 3, 20)
    rho, _ = seen.edge_samples(edge_pixels)
    real = np.repeat(edge_pixels.cols >= 0, 2)
    np.testing.assert_allclose(rho[:, real], at_edge_pixels(fine.inverse_depth, edge_pixels), rtol=2e-3)


def test_known_samples_stay_and_the_others_are_found() -> None:
    one, two = renderers("default")
    pose = POSES["forward"]
    seen, fine = one(pose), two(pose)
    rng = np.random.default_rng(7)
    known = np.where(np.arange(SIZE[1]) < 32, 9.0, -1.0) * np.ones(SIZE)  # nearer than anything
    edge_pixels = edge_pixels_of(rng.random(SIZE) < 0.5, 0, SIZE[0], known)
    is_known = np.repeat((edge_pixels.cols >= 0) & (edge_pixels.cols < 32), 2)
    edge_pixels.inverse_depth[:, is_known] = 9.0
    rho, _ = seen.edge_samples(edge_pixels)
    assert (rho[:, is_known] == 9.0).all()
    real = np.repeat(edge_pixels.cols >= 32, 2)
    expected = np.full((2, len(real)), -1.0, np.float32)
    expected[:, np.repeat(edge_pixels.cols >= 0, 2)] = at_edge_pixels(fine.inverse_depth, edge_pixels)
    np.testing.assert_allclose(rho[:, real], expected[:, real], rtol=2e-3, atol=2e-5)
    assert (edge_pixels.inverse_depth[:, real] == -1.0).all(), "edge pixels are not changed"
