"""Photographs of any shape, as textures for procedural scenes."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.decode import decode_image
from omnisyn_cli.io.images import colour_and_alpha, unit_range, upright

SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"})

LONGEST = 768
"""Pixels of the longer side that are kept: two megabytes a photograph, with its mip levels."""

MOST = 1000
"""Photographs in a folder: two gigabytes."""


def list_photographs(folder: Path) -> list[Path]:
    """All photographs in a folder and below, in an order that depends on their names alone.

    InputError: there is no such folder, or no photograph in it, or too many.
    """
    if not folder.is_dir():
        raise InputError(f"expected a folder of photographs at {folder}, found none; check the name")
    paths = [path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file()]
    if not paths:
        known = ", ".join(sorted(SUFFIXES))
        raise InputError(f"expected photographs ({known}) in {folder}, found none; put some into it")
    if len(paths) > MOST:
        raise InputError(f"expected at most {MOST} photographs in {folder}, found {len(paths)}; name a smaller folder")
    return sorted(paths, key=lambda path: path.relative_to(folder).as_posix())


def read_photographs(folder: Path) -> list[UInt8[np.ndarray, "height width 3"]]:
    """All photographs of a folder, upright, sRGB, at most :data:`LONGEST` pixels long; alpha is ignored.

    Raises:
        InputError: as :func:`list_photographs`.
        ImageError: one of them cannot be read; the message names it.
    """
    return [_read(path) for path in list_photographs(folder)]


def _read(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    header, samples = decode_image(path)
    colour, _ = colour_and_alpha(header, upright(samples, header.orientation))
    image = np.clip(unit_range(colour, path), 0.0, 1.0)
    scale = min(1.0, LONGEST / max(image.shape[:2]))
    if scale < 1.0:
        import cv2  # loaded only here: a plan needs this package, and no more

        size = (max(1, round(scale * image.shape[1])), max(1, round(scale * image.shape[0])))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    return np.ascontiguousarray(np.rint(image * 255.0).astype(np.uint8))
