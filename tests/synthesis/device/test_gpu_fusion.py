"""Exposing, suppressing ghosts and filling: array by array what the numba kernels make of the same numbers."""

import numpy as np
import pytest
import torch
from gpu_samples import BRIGHTER

from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.ghosts import GhostRemover
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.fusion.photometry import ExposureMatcher
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.synthesis.device.pictures import change_colours, fill_holes, samples_of
from omnisyn_cli.types import Layer

SIZE = (60, 120)
OFFSETS = (np.array([0.2, -0.1, 0.4]), np.array([-0.3, 0.2, -0.5]))


def rendering(seed: int) -> Layer:
    """Any colours, some beyond [0, 1]; holes, masked pixels, infinity, weights of all sizes."""
    rng = np.random.default_rng(seed)
    colour = rng.uniform(-0.05, 1.2, (*SIZE, 4)).astype(np.float32)
    colour[..., 3] = np.clip(colour[..., 3], 0, 1) * (rng.random(SIZE) > 0.2)
    rho = (0.3 + 0.03 * rng.standard_normal(SIZE)).clip(0.0) * (rng.random(SIZE) > 0.1)
    hole = rng.random(SIZE) < 0.3
    colour[hole], rho[hole] = 0.0, -1.0
    return Layer.from_arrays(rho.astype(np.float32), colour, Pose(np.eye(3), OFFSETS[seed]))


def on_device(view: Layer) -> Layer:
    """In memory of its own."""
    colour = torch.tensor(view.colour)

    def colour_rows(begin: int, end: int, out: torch.Tensor) -> None:
        out[:] = colour[begin:end]

    return Layer(
        torch.tensor(view.inverse_depth), colour_rows, lambda rows, cols: colour[rows][:, cols],
        view.target_from_source, colour,
    )  # fmt: skip


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
    views = rendering(0), rendering(1)
    found = ExposureMatcher(BRIGHTER, change_colours)(*map(on_device, views), t)
    for there, here in zip(found, ExposureMatcher(BRIGHTER)(*views, t), strict=True):
        colour, seen = torch.empty((*SIZE, 4)), here.colour[..., 3] > 0
        there.colour_rows(0, SIZE[0], colour)
        np.testing.assert_allclose(colour.numpy()[seen], here.colour[seen], atol=2e-6)
        assert (colour.numpy()[~seen][:, 3] == 0.0).all()


def ball(size: tuple[int, int], row: int, col: int, radius: float) -> np.ndarray:
    directions = pixel_directions(*size)
    return directions @ directions[row, col % size[1]] > np.cos(radius)


def wall(size: tuple[int, int]) -> np.ndarray:
    waves = np.array([[1, 0.5, 0.2], [0.1, 1, 0.4], [0.6, 0.2, 1]])
    return (0.5 + 0.2 * np.sin(20 * pixel_directions(*size) @ waves)).astype(np.float32)


@pytest.mark.parametrize("size", [(128, 256), (250, 500), (640, 1280), (12, 24)])
@pytest.mark.parametrize("t", [0.1, 0.5, 0.8])
def test_suppressing_ghosts(size: tuple[int, int], t: float) -> None:
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
        weight = np.float32(1.0) - np.float32(0.97) * ball(size, half, half, 0.3)
        rho = np.where(where, np.float32(0.4), np.float32(0.3)) * ~ball(size, 1, 5, 0.05)
        pose = Pose(np.eye(3), OFFSETS[end] * 0.02)
        shown.append(Layer.from_arrays(rho.astype(np.float32), np.dstack([colour, weight]).astype(np.float32), pose))
    rule = BlendRule.at(t)
    there, here = LayerPair(*map(on_device, shown)), LayerPair(*shown)
    there = there.with_step(GhostRemover(size)(there.first, there.second, rule))
    here = here.with_step(GhostRemover(size, threads=1)(*shown, rule))
    colours, expected = torch.empty((2, *size, 4)), np.empty((2, *size, 4), np.float32)
    for top, bottom in ((0, 7), (7, size[0])):
        there.shade_rows(top, bottom, colours[:, top:bottom])
    here.shade_rows(0, size[0], expected)
    np.testing.assert_allclose(colours.numpy(), expected, atol=1e-4)
    changed = [(colour[..., 3] < view.colour[..., 3]).any() for colour, view in zip(expected, shown, strict=True)]
    assert any(changed) == (size[0] > 12)


def test_rounding() -> None:
    values = torch.tensor([[[-0.1, 0.0, 0.4999 / 255], [0.5001 / 255, 0.5, 254.4 / 255], [254.6 / 255, 1.0, 7.0]]])
    expected = [[[0, 0, 0], [1, 128, 254], [255, 255, 255]]]
    np.testing.assert_array_equal(samples_of(values).numpy(), expected)
