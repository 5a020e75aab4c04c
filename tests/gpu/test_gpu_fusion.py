"""Exposing, silencing ghosts, blending and filling: array by array what the numba kernels make of the same numbers."""

import numpy as np
import pytest
import torch
from gpu_samples import BRIGHTER, CPU

from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.ghosts import GhostRemover
from omnisyn_cli.fusion.kernels import blend_rows
from omnisyn_cli.fusion.options import BlendOptions
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables, pixel_directions
from omnisyn_cli.gpu.blending import BlendRule, Exposure, Shown, blend, expose, samples_of
from omnisyn_cli.gpu.filling import fill_holes
from omnisyn_cli.gpu.ghosts import GpuGhosts
from omnisyn_cli.photometry import ExposureMatcher
from omnisyn_cli.photometry.matching import loss_of_white
from omnisyn_cli.types import Rendering

SIZE = (60, 120)
OFFSETS = (np.array([0.2, -0.1, 0.4]), np.array([-0.3, 0.2, -0.5]))


def rendering(seed: int) -> Rendering:
    """Any colours, some beyond [0, 1]; holes, masked pixels, infinity, worths of all sizes."""
    rng = np.random.default_rng(seed)
    colour = rng.uniform(-0.05, 1.2, (*SIZE, 4)).astype(np.float32)
    colour[..., 3] = np.clip(colour[..., 3], 0, 1) * (rng.random(SIZE) > 0.2)
    rho = (0.3 + 0.03 * rng.standard_normal(SIZE)).clip(0.0) * (rng.random(SIZE) > 0.1)
    hole = rng.random(SIZE) < 0.3
    colour[hole], rho[hole] = 0.0, -1.0
    return Rendering(rho.astype(np.float32), colour, Pose(np.eye(3), OFFSETS[seed]))


def on_device(view: Rendering) -> Shown:
    """In memory of its own."""
    offset = torch.from_numpy(view.target_from_source.position.astype(np.float32))
    return Shown(torch.tensor(view.colour), torch.tensor(view.inverse_depth), offset)


@pytest.mark.parametrize("t", [0.0, 0.3, 1.0])
def test_blending(t: float) -> None:
    first, second = rendering(0), rendering(1)
    image, weight = np.empty((*SIZE, 3), np.float32), np.empty(SIZE, np.float32)
    tables = tuple(table.astype(np.float32) for table in direction_tables(*SIZE))
    views = [(v.colour, v.inverse_depth, v.target_from_source.position.astype(np.float32)) for v in (first, second)]
    rule = (np.float32(t), np.float32(0.06), np.float32(0.003))
    blend_rows(*views[0], *views[1], *rule, *tables, image, weight, 0, SIZE[0])
    rays = torch.from_numpy(pixel_directions(*SIZE).astype(np.float32))
    found, found_weight = blend(on_device(first), on_device(second), rays, BlendRule(t, 0.06, 0.003))
    seen = weight > 0
    np.testing.assert_array_equal(found_weight.numpy() > 0, seen)
    np.testing.assert_allclose(found.numpy()[seen], image[seen], atol=2e-5)
    np.testing.assert_allclose(found_weight.numpy()[seen], weight[seen], rtol=1e-4)
    assert 0.05 < 1 - seen.mean() < 0.5


@pytest.mark.parametrize("size", [(1, 2), (7, 14), (31, 62), (64, 128)])
@pytest.mark.parametrize("holes", [0.0, 0.3, 0.95, 1.0])
def test_filling(size: tuple[int, int], holes: float) -> None:
    rng = np.random.default_rng(5)
    image = rng.random((*size, 3)).astype(np.float32)
    weight = (rng.uniform(0.01, 1, size) * (rng.random(size) >= holes)).astype(np.float32)
    weight[:, -size[1] // 4 :] *= rng.random() > 0.5  # a wide hole at the seam
    found, found_weight = torch.tensor(image), torch.tensor(weight)
    fill_holes(found, found_weight)
    HoleFiller(size, 1)(image, weight)
    np.testing.assert_allclose(found.numpy(), image, atol=1e-5)


@pytest.mark.parametrize("t", [0.0, 0.4, 1.0])
def test_exposing(t: float) -> None:
    first, second = rendering(0), rendering(1)
    found = []
    for end, view in enumerate((first, second)):
        table = BRIGHTER.table(t, of_second=end == 1)
        exposure = None if t == end else Exposure(torch.from_numpy(table), float(loss_of_white(table)))
        found.append(expose(torch.tensor(view.colour), exposure).numpy())
    ExposureMatcher(BRIGHTER, 1)(first, second, t)
    for colour, view in zip(found, (first, second), strict=True):
        seen = view.colour[..., 3] > 0
        np.testing.assert_allclose(colour[seen], view.colour[seen], atol=2e-6)
        assert (colour[~seen][:, 3] == 0.0).all()


def ball(size: tuple[int, int], row: int, col: int, radius: float) -> np.ndarray:
    directions = pixel_directions(*size)
    return directions @ directions[row, col % size[1]] > np.cos(radius)


def wall(size: tuple[int, int]) -> np.ndarray:
    waves = np.array([[1, 0.5, 0.2], [0.1, 1, 0.4], [0.6, 0.2, 1]])
    return (0.5 + 0.2 * np.sin(20 * pixel_directions(*size) @ waves)).astype(np.float32)


@pytest.mark.parametrize("size", [(128, 256), (250, 500), (640, 1280), (12, 24)])
@pytest.mark.parametrize("t", [0.1, 0.5, 0.8])
def test_silencing_ghosts(size: tuple[int, int], t: float) -> None:
    """Things in one picture only: at the seam, near a pole, a ring, and one of the second view, hardly trusted."""
    things = [np.zeros(size, bool), np.zeros(size, bool)]
    half = size[0] // 2
    balls = ((0, half, 0, 0.2), (1, half, half, 0.25), (0, 3, 50, 0.3), (1, size[0] - 2, 70, 0.1))
    for which, row, col, radius in balls:
        things[which] |= ball(size, row, col, radius)
    things[0] |= ball(size, half, -half, 0.5) & ~ball(size, half, -half, 0.3)
    shown = []
    for end, where in enumerate(things):
        colour = np.where(where[..., None], np.float32([0.9, 0.05, 0.1]), wall(size))
        worth = np.float32(1.0) - np.float32(0.97) * ball(size, half, half, 0.3)
        rho = np.where(where, np.float32(0.4), np.float32(0.3)) * ~ball(size, 1, 5, 0.05)
        pose = Pose(np.eye(3), OFFSETS[end] * 0.02)
        shown.append(Rendering(rho.astype(np.float32), np.dstack([colour, worth]).astype(np.float32), pose))
    first, second = (on_device(view) for view in shown)
    ghosts = GpuGhosts(size, CPU)
    small = [
        Shown(view.colour[ghosts.rows][:, ghosts.cols], view.inverse_depth[ghosts.rows][:, ghosts.cols], view.offset)
        for view in (first, second)
    ]
    losers = ghosts.losers(*small, t, 1.0)
    for rows in (slice(0, 7), slice(7, size[0])):
        ghosts.silence(first.colour[rows], second.colour[rows], losers, rows.start)
    untouched = [view.colour[..., 3].copy() for view in shown]
    GhostRemover(size, threads=1)(*shown, t, 1.0)
    for found, expected in zip((first, second), shown, strict=True):
        np.testing.assert_allclose(found.colour.numpy(), expected.colour, atol=1e-4)
    changed = [(view.colour[..., 3] < before).any() for view, before in zip(shown, untouched, strict=True)]
    assert any(changed) == (size[0] > 12)


def test_rounding() -> None:
    values = torch.tensor([[[-0.1, 0.0, 0.4999 / 255], [0.5001 / 255, 0.5, 254.4 / 255], [254.6 / 255, 1.0, 7.0]]])
    expected = [[[0, 0, 0], [1, 128, 254], [255, 255, 255]]]
    np.testing.assert_array_equal(samples_of(values).numpy(), expected)


def test_the_rule_is_that_of_the_fuser() -> None:
    assert BlendOptions() == GeometricFuser(SIZE).options
