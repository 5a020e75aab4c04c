"""Fusing some rows at a time, rounded, is fusing whole pictures and rounding them."""

from dataclasses import replace

import numpy as np
import pytest

from omnisyn_cli.fusion import GeometricFuser
from omnisyn_cli.fusion.geometric import MOST_SAMPLED
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.types import Rendering, RowRendering

SIZE = (1024, 2048)


def rendering(seed: int, hole: tuple[slice, slice], offset: float) -> Rendering:
    """Smooth colours and distances, a trust that varies, a hole, and a red thing that is there for one view only."""
    rng, (row, col) = np.random.default_rng(seed), np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(np.float32)
    waves = [np.sin(k * col * (2 * np.pi / SIZE[1]) + row / 90) for k in (3, 5, 8)]
    colour = np.stack([0.5 + 0.4 * wave for wave in waves] + [np.full(SIZE, 1.0)], axis=-1).astype(np.float32)
    colour[..., :3] += rng.normal(0, 0.01, (*SIZE, 3)).astype(np.float32)
    rho = (0.2 + 0.1 * np.cos(col * (2 * np.pi / SIZE[1]) + 0.02 * seed)).astype(np.float32)
    colour[:, ::7, 3] = 0.25
    colour[hole], rho[hole] = 0.0, -1.0
    if seed == 1:
        colour[400:600, 300:500, :3] = (0.9, 0.1, 0.1)
        colour[400:600, :100, :3] = (0.9, 0.1, 0.1)
    return Rendering(rho, colour, Pose(np.eye(3), np.array([0.0, 0.0, offset])))


def by_rows(whole: Rendering) -> RowRendering:
    def colour_rows(begin: int, end: int, out: np.ndarray) -> None:
        out[:] = whole.colour[begin:end]

    def colour_at(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        return whole.colour[np.ix_(rows, cols)]

    return RowRendering(whole.inverse_depth, colour_rows, colour_at, whole.target_from_source)


VIEWS = (
    rendering(1, (slice(100, 300), slice(0, 900)), -0.5),
    rendering(2, (slice(200, 301), slice(700, 1501)), 0.5),
)


@pytest.mark.parametrize("t", [0.0, 0.03, 0.5, 0.8])
def test_rows_at_a_time_are_the_whole_picture_rounded(t: float) -> None:
    """Ghosts, holes of both views and trust included; arithmetic in another order may change a rounding."""
    made, fuser = np.empty((*SIZE, 3), np.uint8), GeometricFuser(SIZE, threads=2)
    assert fuser.takes_rows()
    fuser.samples(*map(by_rows, VIEWS), t, made)
    copies = [replace(view, colour=view.colour.copy()) for view in VIEWS]
    whole = GeometricFuser(SIZE, threads=1)(*copies, t)
    assert any((copy.colour[..., 3] != view.colour[..., 3]).any() for copy, view in zip(copies, VIEWS, strict=True))
    expected = np.rint(np.clip(whole, 0, 1) * 255)
    difference = np.abs(made.astype(float) - expected)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 1e-3


def test_what_nobody_sees_is_black_and_the_former_frame_does_not_show() -> None:
    made, fuser = np.empty((*SIZE, 3), np.uint8), GeometricFuser(SIZE, threads=1)
    fuser.samples(*map(by_rows, VIEWS), 0.5, made)
    nothing = Rendering(np.full(SIZE, -1, np.float32), np.zeros((*SIZE, 4), np.float32), VIEWS[0].target_from_source)
    fuser.samples(by_rows(nothing), by_rows(nothing), 0.5, made)
    assert not made.any()


def test_sizes_that_are_odd_or_small_are_fused_whole() -> None:
    assert not GeometricFuser((1025, 2050), threads=1).takes_rows()
    assert not GeometricFuser((256, 512), threads=1).takes_rows()
    assert 1 / 4 <= MOST_SAMPLED < 1
