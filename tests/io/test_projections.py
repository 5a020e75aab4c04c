"""Pictures that are no panoramas are named as what they are, with the remedy; panoramas with black parts are read."""

import math

import numpy as np
import pytest

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io import read_mask, read_panorama, write_image

SIDE = 96


def seen(directions: np.ndarray) -> np.ndarray:
    """A world of waves and stripes, brighter above: x right, y up, −z forward."""
    x, y, z = np.moveaxis(directions / np.linalg.norm(directions, axis=-1, keepdims=True), -1, 0)
    red = 0.55 + 0.2 * y + 0.2 * np.sin(7 * x + 3 * z) * np.cos(5 * y)
    return np.stack([red, 0.5 + 0.3 * np.sin(9 * z - 4 * y), 0.6 + 0.3 * x * np.sin(6 * y)], axis=-1)


def sphere(height: int = SIDE) -> np.ndarray:
    polar = (np.arange(height)[:, None] + 0.5) / height * math.pi
    azimuth = (np.arange(2 * height)[None] + 0.5) / height * math.pi - math.pi
    axes = np.broadcast_arrays(np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth))
    return seen(np.stack(axes, axis=-1))


def square(half: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of pixels from the centre, to the right and up."""
    across = ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1) * half
    x, y = np.meshgrid(across, -across)
    return x, y


def fisheye(way: float) -> np.ndarray:
    """200° ahead or behind, in a disc."""
    x, y = square(1.0)
    angle = np.hypot(x, y) * math.radians(100)
    sine = np.sin(angle) / np.hypot(x, y)
    picture = seen(np.stack([way * sine * x, sine * y, -way * np.cos(angle)], axis=-1))
    picture[np.hypot(x, y) > 0.98] = 0.02
    return picture


def face(axis: int, way: float) -> np.ndarray:
    x, y = square(1.0)
    return seen(np.roll(np.stack([np.full_like(x, way), x, y], axis=-1), axis, axis=-1))


def margins(height: int, width: int, top: int = 0, left: int = 0) -> np.ndarray:
    picture = np.zeros((height, width, 3))
    picture[top : top + SIDE, left : left + 2 * SIDE] = sphere()
    return picture


def cylinder() -> np.ndarray:
    azimuth, up = np.meshgrid(np.arange(300) / 300 * 2 * math.pi, np.linspace(1, -1, 96))
    return seen(np.stack([np.sin(azimuth), up, -np.cos(azimuth)], axis=-1))


FACES = [face(axis, way) for axis in range(3) for way in (1.0, -1.0)]
BLANK = np.zeros_like(FACES[0])
CROSS = np.vstack(
    [np.hstack([FACES[0] if at in (4, 5, 6, 7, 1, 9) else BLANK for at in range(k, k + 4)]) for k in (0, 4, 8)]
)

NO_PANORAMAS = {
    "dual fisheye": (np.hstack([fisheye(1.0), fisheye(-1.0)]), "two fisheye pictures side by side .*; stitch it first"),
    "tiles of street view": (margins(118, 236), "black margins; crop it to 192×96 at column 0, row 0"),
    "letterbox": (margins(192, 192, top=48), "black margins; crop it to 192×96 at column 0, row 48"),
    "black below": (margins(120, 192), "got 192×120: a panorama with black margins; crop it to 192×96"),
    "strip": (np.hstack(FACES), "six faces of a cube in a row; convert it .*v360=c6x1:e"),
    "column": (np.vstack(FACES), "six faces of a cube in a column; convert it .*v360=c1x6:e"),
    "cross": (CROSS, "six faces of a cube in a cross; convert it"),
    "upright cross": (CROSS.swapaxes(0, 1), "six faces of a cube in a cross; convert it"),
    "cylinder": (cylinder(), "a full turn whose ends meet; say --hfov 360 .* convert a cylinder first"),
    "photograph": (FACES[0][:64], r"got 96×64; stitch it to 2:1, .*\(--hfov\)"),
}  # fmt: skip


@pytest.mark.parametrize("case", NO_PANORAMAS)
@pytest.mark.parametrize("suffix", ["png", "jpg", "exr"])
def test_what_is_no_panorama_is_named_with_its_remedy(tmp_path, case, suffix):
    picture, message = NO_PANORAMAS[case]
    path = tmp_path / f"a.{suffix}"
    write_image(path, picture.astype(np.float32) if suffix == "exr" else np.rint(picture * 255).astype(np.uint8))
    with pytest.raises(ImageError, match=f"a.{suffix}: expected an equirectangular panorama.*{message}") as caught:
        read_panorama(path)
    assert "\n" not in str(caught.value)
    assert read_panorama(path, allow_aspect=True).image.shape[1] == picture.shape[1] // 2 * 2


def test_panoramas_with_black_parts_are_panoramas(tmp_path):
    """Caps above and below, a dark night with lamps, nothing at all; and masks may be black wherever they like."""
    caps = sphere()
    caps[:16], caps[-20:] = 0, 0
    night = np.where(sphere()[..., :1] > 0.85, 1.0, 0.0) * np.ones(3)
    for picture in (sphere(), caps, night, np.zeros((SIDE, 2 * SIDE, 3))):
        write_image(tmp_path / "a.png", np.rint(picture * 255).astype(np.uint8))
        assert read_panorama(tmp_path / "a.png").mask is None
    write_image(tmp_path / "mask.png", np.where(margins(118, 236) > 0, 255, 0).astype(np.uint8))
    assert read_mask(tmp_path / "mask.png").any()
