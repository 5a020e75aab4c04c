"""Which part of a panorama may be used: what no mask forbids, outside of the cap around its nadir."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.cap import outside_nadir
from omnisyn_cli.io.decode import MAX_PIXELS
from omnisyn_cli.io.images import read_mask

__all__ = ["check_mask_size", "usable_part"]

Mask = Bool[np.ndarray, "height width"]


def usable_part(
    own: Mask | None, size: tuple[int, ...], masks: Iterable[Path | None], nadir: float,
    *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS,
) -> Mask | None:  # fmt: skip
    """True where a panorama may be used; None where all of it may.

    Args:
        own: mask that came with the picture, its alpha channel.
        size: height and width of the panorama.
        masks: images that are black where it must not be used; None says nothing.
        nadir: radians around straight down that must not be used either.
        allow_aspect: see :func:`omnisyn_cli.io.read_mask`.
        max_pixels: see :func:`omnisyn_cli.io.read_mask`.

    Raises:
        ImageError: a mask cannot be read.
        InputError: it has another size, or forbids everything.
    """
    parts = [] if own is None else [own]
    for path in (path for path in masks if path is not None):
        mask = read_mask(path, allow_aspect=allow_aspect, max_pixels=max_pixels)
        check_mask_size(path, mask.shape, size)
        if not mask.any():
            raise InputError(
                f"{path}: expected white where the panorama may be used, got a mask that forbids all of it; brightness "
                "goes from 0 to 255 or 65535, not from 0 to 1"
            )
        parts.append(mask)
    if nadir > 0.0:
        parts.append(outside_nadir((size[0], size[1]), nadir))
    return np.logical_and.reduce(parts) if parts else None


def check_mask_size(path: Path, size: tuple[int, ...], expected: tuple[int, ...]) -> None:
    """Refuse a mask of another height and width than its panorama.

    Raises:
        InputError: it has.
    """
    if size != expected:
        raise InputError(
            f"{path}: expected a mask of {expected[1]}×{expected[0]} pixels, got {size[1]}×{size[0]}; "
            "give it the size of its panorama"
        )
