"""Planes for encoders are what the standard's formulas say, to the nearest whole number."""

import numpy as np
import pytest

from omnisyn_cli.io.yuv import PlanarFrames


def planes_of(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """BT.709, items 3.2, 3.3 and 3.4 with the quantisation of item 4.6, in float64, before rounding.

    Chroma lies in the even columns: a quarter of either neighbour, across the seam, and half of the column itself.
    """
    red, green, blue = np.moveaxis(frame / 255.0, -1, 0)
    luma = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    differences = [((colour - luma) / scale) for colour, scale in ((blue, 1.8556), (red, 1.5748))]
    across = [0.5 * x + 0.25 * (np.roll(x, 1, axis=1) + np.roll(x, -1, axis=1)) for x in differences]
    means = [0.5 * (x[::2] + x[1::2])[:, ::2] for x in across]
    return 16 + 219 * luma, 128 + 224 * means[0], 128 + 224 * means[1]


def split(samples: np.ndarray, size: tuple[int, int]) -> list[np.ndarray]:
    height, width = size
    luma, rest = samples[: height * width], samples[height * width :]
    return [luma.reshape(size), *rest.reshape(2, height // 2, width // 2)]


@pytest.mark.parametrize("size", [(2, 4), (6, 12), (10, 1030), (4, 2048)])
def test_every_plane_is_within_half_a_code_of_the_formula(size):
    frame = np.random.default_rng(size[1]).integers(0, 256, (*size, 3), np.uint8)
    found = split(PlanarFrames(size)(frame), size)
    for plane, exact in zip(found, planes_of(frame), strict=True):
        assert np.abs(plane - exact).max() <= 0.5 + 1e-3


def test_black_white_and_primary_colours_have_the_codes_of_the_standard():
    """White is (235, 128, 128), black (16, 128, 128); pure blue and red reach the end of their scale, 240."""
    colours = np.array([[0, 0, 0], [255, 255, 255], [0, 0, 255], [255, 0, 0], [0, 255, 0]], np.uint8)
    frame = np.ascontiguousarray(np.broadcast_to(np.repeat(colours, 4, axis=0), (2, 20, 3)))
    luma, blue, red = split(PlanarFrames((2, 20))(frame), (2, 20))
    assert list(luma[0, ::4]) == [16, 235, 32, 63, 173]
    assert list(blue[0, 1::2]) == [128, 128, 240, 102, 42]
    assert list(red[0, 1::2]) == [128, 128, 118, 240, 26]


def test_chroma_lies_where_players_look_for_it():
    """Of a ramp it has the codes of the even columns, not of half a pixel beside them (H.264, figure E-1, type 0)."""
    ramp = np.arange(64, 192, dtype=np.uint8)
    frame = np.zeros((2, 128, 3), np.uint8)
    frame[..., 2] = ramp
    _, blue, _ = split(PlanarFrames((2, 128))(frame), (2, 128))
    exact = 128 + 224 * 0.5 * ramp[2:-1:2] / 255.0
    assert abs((blue[0, 1:] - exact).mean()) < 0.02


def test_the_memory_is_used_again():
    frames = PlanarFrames((2, 4))
    first = frames(np.zeros((2, 4, 3), np.uint8))
    second = frames(np.full((2, 4, 3), 255, np.uint8))
    assert first is second
    assert (second[:8] == 235).all()
