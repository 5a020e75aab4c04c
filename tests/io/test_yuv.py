"""Planes for encoders are what the standard's formulas say, to the nearest whole number."""

import numpy as np
import pytest

from omnisyn_cli.io.yuv import PlanarFrames


def planes_of(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """BT.709, items 3.2, 3.3 and 3.4 with the quantisation of item 4.6, in float64, before rounding."""
    red, green, blue = np.moveaxis(frame / 255.0, -1, 0)
    luma = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    height, width = luma.shape
    means = [
        ((colour - luma) / scale).reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
        for colour, scale in ((blue, 1.8556), (red, 1.5748))
    ]
    return 16 + 219 * luma, 128 + 224 * means[0], 128 + 224 * means[1]


def split(samples: np.ndarray, size: tuple[int, int]) -> list[np.ndarray]:
    height, width = size
    luma, rest = samples[: height * width], samples[height * width :]
    return [luma.reshape(size), *rest.reshape(2, height // 2, width // 2)]


@pytest.mark.parametrize("size", [(2, 4), (6, 12), (10, 1030), (4, 2048)])
def test_every_plane_is_within_half_a_code_of_the_formula(size: tuple[int, int]) -> None:
    frame = np.random.default_rng(size[1]).integers(0, 256, (*size, 3), np.uint8)
    found = split(PlanarFrames(size)(frame), size)
    for plane, exact in zip(found, planes_of(frame), strict=True):
        assert np.abs(plane - exact).max() <= 0.5 + 1e-3


def test_black_white_and_primary_colours_have_the_codes_of_the_standard() -> None:
    """White is (235, 128, 128), black (16, 128, 128); pure blue and red reach the end of their scale, 240."""
    colours = np.array([[0, 0, 0], [255, 255, 255], [0, 0, 255], [255, 0, 0], [0, 255, 0]], np.uint8)
    frame = np.ascontiguousarray(np.broadcast_to(np.repeat(colours, 2, axis=0), (2, 10, 3)))
    luma, blue, red = split(PlanarFrames((2, 10))(frame), (2, 10))
    assert list(luma[0, ::2]) == [16, 235, 32, 63, 173]
    assert list(blue[0]) == [128, 128, 240, 102, 42]
    assert list(red[0]) == [128, 128, 118, 240, 26]


def test_the_memory_is_used_again() -> None:
    frames = PlanarFrames((2, 4))
    first = frames(np.zeros((2, 4, 3), np.uint8))
    second = frames(np.full((2, 4, 3), 255, np.uint8))
    assert first is second
    assert (second[:8] == 235).all()
