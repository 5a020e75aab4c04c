"""One way to a picture: band by band or at once, held or on demand, as numbers or as samples, it is the same."""

import numpy as np
import pytest
from fusion_samples import asked

from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.ghost_grid import ghost_sample_step
from omnisyn_cli.fusion.layer_pair import TILE_ROWS, LayerPair, LayerPairShader
from omnisyn_cli.fusion.residual import ResidualFuser
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.types import Layer

# Cells of some pixels and of all, even and odd, of many bands and of one.
SIZES = [(1024, 2048), (901, 1799), (131, 261), (64, 128), (1, 2)]
RED = (0.9, 0.1, 0.1)


def rendering(seed: int, size: tuple[int, int], offset: float) -> Layer:
    """Smooth colours and distances, confidence that varies, a hole, and a red thing that is there for one view only."""
    rng, (height, width) = np.random.default_rng(seed), size
    row, col = np.mgrid[0:height, 0:width].astype(np.float32)
    waves = [np.sin(k * col * (2 * np.pi / width) + 11 * row / height) for k in (3, 5, 8)]
    colour = np.stack([0.5 + 0.4 * wave for wave in waves] + [np.full(size, 1.0)], axis=-1).astype(np.float32)
    colour[..., :3] += rng.normal(0, 0.01, (*size, 3)).astype(np.float32)
    rho = (0.2 + 0.1 * np.cos(col * (2 * np.pi / width) + 0.02 * seed)).astype(np.float32)
    colour[:, ::7, 3] = 0.25
    hole = np.s_[height // 8 * seed : height // 3, width // 3 * (seed - 1) : width * seed // 2]
    colour[hole], rho[hole] = 0.0, -1.0
    if seed == 1:
        colour[2 * height // 5 : 3 * height // 5, width // 7 : width // 4, :3] = RED
        colour[2 * height // 5 : 3 * height // 5, : width // 20, :3] = RED
    return asked(Layer.from_arrays(rho, colour, Pose(np.eye(3), np.array([0.0, 0.0, offset]))))


def on_demand(view: Layer) -> Layer:
    return asked(Layer(view.inverse_depth, view.colour_rows, view.subsampled_colours, view.target_from_source))


def pair(size: tuple[int, int]) -> tuple[Layer, Layer]:
    return rendering(1, size, -0.5), rendering(2, size, 0.5)


def correct(planes: np.ndarray) -> np.ndarray:
    return np.full_like(planes[:4], 0.1)


FUSERS = {"geometric": GeometricFuser, "network": lambda size, threads: ResidualFuser(size, correct, 128, threads)}


@pytest.mark.parametrize(
    ("size", "t"), [*((size, 0.03) for size in SIZES), *((size, t) for size in SIZES[2:] for t in (0.0, 0.5))]
)
@pytest.mark.parametrize("fusion", FUSERS)
def test_samples_are_the_numbers_rounded(size: tuple[int, int], fusion: str, t: float) -> None:
    """From renderings of either kind, which stay as they are; ghosts, holes and confidence included."""
    views, fuser = pair(size), FUSERS[fusion](size, threads=2)
    before = [view.colour.copy() for view in views]
    numbers = fuser(*views, t).copy()
    made, confidence = np.empty((*size, 3), np.uint8), [np.full(size, np.nan, np.float32) for _ in range(2)]
    assert FUSERS[fusion](size, threads=1)(*map(on_demand, views), t, made, confidence[0]) is made
    expected = np.clip(numbers, 0, 1) * 255
    assert np.abs(made - expected).max() <= (0.501 if fusion == "geometric" else 1.01)  # candidates are rounded twice
    fuser(*views, t, None, confidence[1])
    np.testing.assert_array_equal(*confidence)
    for view, colour in zip(views, before, strict=True):
        np.testing.assert_array_equal(view.colour, colour)


def test_ghosts_are_suppressed_in_what_is_blended() -> None:
    for size in SIZES[:2]:
        found = GeometricFuser(size, threads=2)(*pair(size), 0.4)
        middle = found[size[0] // 2, size[1] // 7 + size[1] // 40 : size[1] // 4 - size[1] // 40]
        apart = np.abs(middle - RED).max(axis=-1)
        assert (apart < 0.1).mean() > 0.9


@pytest.mark.parametrize("height", [1, 31, 32, 33, 100])
def test_bands_cover_every_row_once_in_order_of_their_steps(height: int) -> None:
    size, seen, told = (height, 4), np.zeros(height, int), []
    first, second = (
        Layer.from_arrays(np.zeros(size, np.float32), np.full((*size, 4), k, np.float32), Pose.identity())
        for k in (1, 2)
    )

    def double(a: np.ndarray, b: np.ndarray, top: int) -> None:
        told.append(top)
        a *= 2

    def add(a: np.ndarray, b: np.ndarray, top: int) -> None:
        b += a

    def use(top: int, bottom: int, a: np.ndarray, b: np.ndarray) -> None:
        seen[top:bottom] += 1
        assert (a == 2).all()
        assert (b == 4).all()
        assert a.shape == (bottom - top, 4, 4)

    LayerPairShader(size, 3)(LayerPair(first, second).with_step(double).with_step(None).with_step(add), use)
    assert (seen == 1).all()
    assert sorted(told) == list(range(0, height, TILE_ROWS))


def test_what_nobody_sees_is_black_and_the_former_frame_does_not_show() -> None:
    size = SIZES[0]
    made, fuser = np.empty((*size, 3), np.uint8), GeometricFuser(size, threads=1)
    fuser(*pair(size), 0.5, made)
    nothing = Layer.from_arrays(np.full(size, -1, np.float32), np.zeros((*size, 4), np.float32), Pose.identity())
    fuser(nothing, nothing, 0.5, made)
    assert not made.any()


def test_small_cells_are_looked_at_wholly() -> None:
    assert [ghost_sample_step((rows, 2 * rows)) for rows in (64, 896, 897, 1024, 2048)] == [1, 1, 2, 2, 4]
