"""Depth is metres, exactly, with infinity for nothing."""

from pathlib import Path

import numpy as np
import pytest
from io_samples import write_with

from omnisyn_cli.errors import ImageError, OutputPathError
from omnisyn_cli.io import read_depth, read_inverse_depth, write_depth, write_image


def some_depth() -> np.ndarray:
    depth = np.random.default_rng(0).uniform(0.1, 80, (8, 16)).astype(np.float32)
    depth[0] = np.inf
    return depth


def test_depth_comes_back_exactly_infinity_included(tmp_path: Path) -> None:
    write_depth(tmp_path / "d.exr", some_depth())
    np.testing.assert_array_equal(read_depth(tmp_path / "d.exr"), some_depth())
    np.testing.assert_array_equal(read_inverse_depth(tmp_path / "d.exr"), 1 / some_depth())


def test_png_holds_millimetres_and_zero_is_nothing(tmp_path: Path) -> None:
    millimetres = np.full((4, 8), 1500, np.uint16)
    millimetres[1, 2] = 0
    write_image(tmp_path / "d.png", millimetres)
    depth = read_depth(tmp_path / "d.png")
    assert np.isinf(depth[1, 2])
    np.testing.assert_allclose(np.delete(depth.ravel(), 10), 1.5, rtol=1e-6)


@pytest.mark.parametrize("names", [("Z",), ("anything",), ("A", "Z"), ("View.Combined.R", "View.Depth.Z")])
def test_depth_is_the_channel_z_or_the_only_one(tmp_path: Path, names: tuple[str, ...]) -> None:
    samples = np.stack([some_depth()] * len(names), axis=-1)
    samples[..., :-1] = -7
    write_with(tmp_path / "d.exr", samples, names=names)
    np.testing.assert_array_equal(read_depth(tmp_path / "d.exr"), some_depth())


def test_a_renderers_far_away_is_infinity(tmp_path: Path) -> None:
    write_with(tmp_path / "d.exr", np.full((4, 8, 1), 1e10, np.float32), names=("Z",))
    assert np.isinf(read_depth(tmp_path / "d.exr")).all()


def test_undefined_and_negative_depths_are_counted(tmp_path: Path) -> None:
    depth = some_depth()
    depth[1, 1:3] = np.nan
    depth[2, 2] = -1
    write_with(tmp_path / "d.exr", depth[..., None], names=("Z",))
    with pytest.raises(ImageError, match="2 NaN and 1 negative of 128 pixels"):
        read_depth(tmp_path / "d.exr")


def test_what_is_no_depth_is_an_image_error(tmp_path: Path) -> None:
    write_image(tmp_path / "rgb.png", np.zeros((4, 8, 3), np.uint8))
    write_image(tmp_path / "grey.png", np.zeros((4, 8), np.uint8))
    write_with(tmp_path / "rgb.exr", np.zeros((4, 8, 3), np.float32))
    write_depth(tmp_path / "square.exr", np.ones((8, 8), np.float32))
    for name, words in [
        ("rgb.png", "channel Z"),
        ("grey.png", "16-bit"),
        ("rgb.exr", "channel Z"),
        ("square.exr", "8×8"),
    ]:
        with pytest.raises(ImageError, match=words):
            read_depth(tmp_path / name)


def test_only_depth_is_written_as_depth(tmp_path: Path) -> None:
    with pytest.raises(OutputPathError, match=r"\.exr"):
        write_depth(tmp_path / "d.png", some_depth())
    for wrong in (np.full((4, 8), np.nan), np.full((4, 8), -1.0), np.zeros((4, 8, 1))):
        with pytest.raises(ValueError, match="expected"):
            write_depth(tmp_path / "d.exr", wrong)
    assert not list(tmp_path.iterdir())
