"""Depth is metres, exactly, with infinity for nothing."""

from pathlib import Path

import numpy as np
import pytest
from io_samples import png_with_xmp, write_with, xmp_packet

from omnisyn_cli.errors import ImageError, OutputPathError
from omnisyn_cli.io import read_depth, read_header, read_inverse_depth, write_depth, write_image
from omnisyn_cli.io.depth_files import depth_size


def some_depth() -> np.ndarray:
    depth = np.random.default_rng(0).uniform(0.1, 80, (8, 16)).astype(np.float32)
    depth[0] = np.inf
    return depth


def test_depth_comes_back_exactly_infinity_included(tmp_path):
    write_depth(tmp_path / "d.exr", some_depth())
    np.testing.assert_array_equal(read_depth(tmp_path / "d.exr"), some_depth())
    np.testing.assert_array_equal(read_inverse_depth(tmp_path / "d.exr"), 1 / some_depth())


def test_png_holds_millimetres_and_zero_is_nothing(tmp_path):
    millimetres = np.full((4, 8), 1500, np.uint16)
    millimetres[1, 2] = 0
    write_image(tmp_path / "d.png", millimetres)
    depth = read_depth(tmp_path / "d.png")
    assert np.isinf(depth[1, 2])
    np.testing.assert_allclose(np.delete(depth.ravel(), 10), 1.5, rtol=1e-6)


@pytest.mark.parametrize("names", [("Z",), ("anything",), ("A", "Z"), ("View.Combined.R", "View.Depth.Z")])
def test_depth_is_the_channel_z_or_the_only_one(tmp_path, names):
    samples = np.stack([some_depth()] * len(names), axis=-1)
    samples[..., :-1] = -7
    write_with(tmp_path / "d.exr", samples, names=names)
    np.testing.assert_array_equal(read_depth(tmp_path / "d.exr"), some_depth())


def test_a_renderers_far_away_is_infinity(tmp_path):
    write_with(tmp_path / "d.exr", np.full((4, 8, 1), 1e10, np.float32), names=("Z",))
    assert np.isinf(read_depth(tmp_path / "d.exr")).all()


# Top, left, height and width of data windows within, around, across and beside :func:`some_depth`.
WINDOWS = [(2, 0, 5, 16), (0, 3, 8, 9), (3, 4, 1, 1), (-1, -2, 10, 20), (-2, 5, 6, 30), (6, -3, 4, 8), (9, 0, 2, 16)]


def write_windowed(path: Path, window: tuple[int, int, int, int], beyond: float = 5.0) -> np.ndarray:
    """:func:`some_depth` through a data window, ``beyond`` outside of the picture; where the window shows something."""
    top, left, height, width = window
    around, shown = np.full((28, 56), beyond, np.float32), np.zeros((28, 56), bool)
    around[10:18, 20:36] = some_depth()
    there = np.s_[10 + top : 10 + top + height, 20 + left : 20 + left + width]
    shown[there] = True
    write_with(path, around[there][..., None], names=("Z",), window=(top, left, 8, 16))
    return shown[10:18, 20:36]


@pytest.mark.parametrize("window", WINDOWS)
def test_a_data_window_is_the_whole_depth_inside_and_nothing_outside(tmp_path, window):
    """Whatever lies beyond the picture is cut off, numbers that are no depth included."""
    shown = write_windowed(tmp_path / "d.exr", window, beyond=np.nan)
    depth_size(read_header(tmp_path / "d.exr"))
    expected = np.where(shown, some_depth(), np.float32(np.inf))
    np.testing.assert_array_equal(read_depth(tmp_path / "d.exr"), expected)
    np.testing.assert_array_equal(read_inverse_depth(tmp_path / "d.exr"), 1 / expected)


def test_autocropped_depth_of_a_panorama_is_accepted(tmp_path):
    """Sky at the top, a car's roof at the bottom: Nuke and Blender leave away both."""
    write_with(tmp_path / "d.exr", np.full((200, 512, 1), 2.5, np.float32), names=("Z",), window=(30, 0, 256, 512))
    header = read_header(tmp_path / "d.exr")
    assert depth_size(header) == (256, 512)
    depth = read_depth(tmp_path / "d.exr")
    assert (depth[30:230] == 2.5).all()
    assert np.isinf(np.delete(depth, np.s_[30:230], axis=0)).all()


def test_cropped_millimetres_take_the_place_that_their_tags_say(tmp_path):
    tags = {
        "GPano:FullPanoWidthPixels": 16, "GPano:FullPanoHeightPixels": 8, "GPano:CroppedAreaImageWidthPixels": 6,
        "GPano:CroppedAreaImageHeightPixels": 3, "GPano:CroppedAreaLeftPixels": 9, "GPano:CroppedAreaTopPixels": 4,
    }  # fmt: skip
    plain = write_with(tmp_path / "d.png", np.full((3, 6, 1), 1500, np.uint16), names=("Z",)).read_bytes()
    (tmp_path / "d.png").write_bytes(png_with_xmp(plain, xmp_packet(tags, "elements")))
    expected = np.zeros((8, 16), np.float32)
    expected[4:7, 9:15] = 1 / 1.5
    np.testing.assert_allclose(read_inverse_depth(tmp_path / "d.png"), expected, rtol=1e-6)
    giant = tags | {"GPano:FullPanoWidthPixels": 2_000_000, "GPano:FullPanoHeightPixels": 1_000_000}
    (tmp_path / "d.png").write_bytes(png_with_xmp(plain, xmp_packet(giant, "elements")))
    with pytest.raises(ImageError, match="at most 268,435,456 pixels"):
        read_depth(tmp_path / "d.png")


def test_a_window_of_a_picture_that_is_not_2_to_1_is_refused(tmp_path):
    write_with(tmp_path / "d.exr", np.ones((4, 8, 1), np.float32), names=("Z",), window=(0, 0, 6, 8))
    for read in (read_depth, lambda path: depth_size(read_header(path))):
        with pytest.raises(ImageError, match="twice as wide as high, got 8×6"):
            read(tmp_path / "d.exr")


def test_undefined_and_negative_depths_are_counted(tmp_path):
    depth = some_depth()
    depth[1, 1:3] = np.nan
    depth[2, 2] = -1
    write_with(tmp_path / "d.exr", depth[..., None], names=("Z",))
    with pytest.raises(ImageError, match="2 NaN and 1 negative of 128 pixels"):
        read_depth(tmp_path / "d.exr")


def test_what_is_no_depth_is_an_image_error(tmp_path):
    write_image(tmp_path / "rgb.png", np.zeros((4, 8, 3), np.uint8))
    write_image(tmp_path / "grey.png", np.zeros((4, 8), np.uint8))
    write_with(tmp_path / "rgb.exr", np.zeros((4, 8, 3), np.float32))
    write_depth(tmp_path / "square.exr", np.ones((8, 8), np.float32))
    wrong = {"rgb.png": "channel Z", "grey.png": "16-bit", "rgb.exr": "channel Z", "square.exr": "8×8"}
    for name, words in wrong.items():
        with pytest.raises(ImageError, match=words):
            read_depth(tmp_path / name)


def test_only_depth_is_written_as_depth(tmp_path):
    with pytest.raises(OutputPathError, match=r"\.exr"):
        write_depth(tmp_path / "d.png", some_depth())
    for wrong in (np.full((4, 8), np.nan), np.full((4, 8), -1.0), np.zeros((4, 8, 1))):
        with pytest.raises(ValueError, match="expected"):
            write_depth(tmp_path / "d.exr", wrong)
    assert not list(tmp_path.iterdir())
