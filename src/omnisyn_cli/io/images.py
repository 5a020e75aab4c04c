"""Panoramas and masks read from files: upright, complete spheres, RGB in [0, 1], W = 2H."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Shaped

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io.decode import MAX_PIXELS, ImageHeader, check_pixel_count, decode_image
from omnisyn_cli.io.placement import Placement, placement_of

__all__ = ["INTEGER_PEAKS", "Panorama", "read_mask", "read_panorama", "sphere_size"]

INTEGER_PEAKS = {"uint8": 255, "uint16": 65535}
"""Samples of white, by their type."""

FLOATS = frozenset({"float16", "float32", "float64"})

LEAST_HEIGHT = 2
"""Rows of the smallest panorama that a surface can be made of."""

USABLE_ALPHA = 0.5
"""Pixels that are less opaque than this are not usable."""


@dataclass(frozen=True)
class Panorama:
    """An equirectangular image that covers the whole sphere.

    Attributes:
        image: ``(height, width, 3)`` RGB in [0, 1], width = 2·height; floating-point files may exceed 1.
        mask: ``(height, width)``, True where the image is usable; None means everywhere.
        original: ``(height, width, 3)`` uint8 or uint16 with exactly the samples of the file, upright and completed
            like ``image``; None for floating-point files and where samples had to be resampled or divided by alpha.
        path: the file it came from.
    """

    image: Float[np.ndarray, "height width 3"]
    mask: Bool[np.ndarray, "height width"] | None
    original: Shaped[np.ndarray, "height width 3"] | None
    path: Path


def read_panorama(path: Path | str, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS) -> Panorama:
    """Read a panorama, turn it upright and complete it to the whole sphere.

    EXIF orientation is applied; a cropped panorama (GPano tags, OpenEXR data window) is put in its place in the full
    sphere and the rest is masked; grey becomes RGB; alpha becomes the mask.

    Args:
        path: JPEG, PNG, TIFF, EXR or WebP; samples are taken as they are, no colour space is converted.
        allow_aspect: resample images that are not 2:1, as if their pixels were not square.
        max_pixels: refuse larger images before decoding them.

    Raises:
        ImageError: missing, empty, damaged, too large or too small, not 2:1, not equirectangular, or with NaN or
            infinite samples.
    """
    header, samples = decode_image(path, max_pixels=max_pixels)
    size = sphere_size(header, allow_aspect=allow_aspect, max_pixels=max_pixels)
    colour, alpha = colour_and_alpha(header, upright(samples, header.orientation))
    panorama = _panorama(header, colour, alpha, placement_of(header))
    return panorama if panorama.image.shape[:2] == size else _resampled(panorama, size)


def sphere_size(header: ImageHeader, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS) -> tuple[int, int]:
    """Height and width of the panorama that :func:`read_panorama` makes of a file.

    Raises:
        ImageError: too large or too small, not 2:1 where that is not allowed, or not equirectangular.
    """
    placement = placement_of(header)
    height, width = placement.full_height, placement.full_width
    check_pixel_count(header.path, height, width, max_pixels)
    if min(height, width // 2) < LEAST_HEIGHT:
        raise ImageError(
            f"{header.path}: expected a panorama of at least {2 * LEAST_HEIGHT}×{LEAST_HEIGHT} pixels, got "
            f"{width}×{height}; choose a larger image"
        )
    if width == 2 * height:
        return height, width
    if not allow_aspect:
        raise ImageError(
            f"{header.path}: expected an equirectangular panorama twice as wide as high, got {width}×{height}; "
            "stitch it to 2:1, or allow other aspect ratios (--allow-aspect) if the image does cover the whole sphere"
        )
    return width // 2, width // 2 * 2


def read_mask(
    path: Path | str, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS
) -> Bool[np.ndarray, "height width"]:
    """Read a mask ``(height, width)``: True (usable) where the first channel is at least half of white.

    Args:
        path: as for :func:`read_panorama`.
        allow_aspect: likewise.
        max_pixels: likewise.

    Raises:
        ImageError: as :func:`read_panorama`.
    """
    panorama = read_panorama(path, allow_aspect=allow_aspect, max_pixels=max_pixels)
    bright = panorama.image[..., 0] >= 0.5
    return bright if panorama.mask is None else bright & panorama.mask


def upright(samples: np.ndarray, orientation: int) -> np.ndarray:
    """Undo an EXIF orientation: ``(rows, cols, channels)`` as stored to ``(height, width, channels)`` as seen.

    Source: Exif 2.32, tag 0x0112.
    """
    match orientation:
        case 2:
            return samples[:, ::-1]
        case 3:
            return samples[::-1, ::-1]
        case 4:
            return samples[::-1]
        case 5:
            return samples.swapaxes(0, 1)
        case 6:
            return samples[::-1].swapaxes(0, 1)
        case 7:
            return samples[::-1, ::-1].swapaxes(0, 1)
        case 8:
            return samples[:, ::-1].swapaxes(0, 1)
    return samples


def unit_range(samples: np.ndarray, path: Path) -> Float[np.ndarray, "*shape"]:
    """Integer samples divided by their peak, floating-point samples kept; float32.

    Raises:
        ImageError: another sample type, or NaN or infinity among the samples.
    """
    name = str(samples.dtype)
    if name in INTEGER_PEAKS:
        unit: np.ndarray = np.divide(samples, np.float32(INTEGER_PEAKS[name]), dtype=np.float32)
        return unit
    if name not in FLOATS:
        raise ImageError(
            f"{path}: expected 8- or 16-bit or floating-point samples, got {name}; convert the image first"
        )
    finite = np.isfinite(samples)
    if not finite.all():
        raise ImageError(
            f"{path}: expected finite samples, got {np.count_nonzero(~finite)} that are NaN or infinite; "
            "repair or export the image anew"
        )
    return samples.astype(np.float32)


def _panorama(header: ImageHeader, colour: np.ndarray, alpha: np.ndarray | None, placement: Placement) -> Panorama:
    is_integer = str(colour.dtype) in INTEGER_PEAKS
    image, usable = unit_range(colour, header.path), None
    if alpha is not None:
        opacity = unit_range(alpha, header.path)
        usable = opacity >= USABLE_ALPHA
        if header.is_alpha_associated and bool(np.any(usable & (opacity < 1))):
            image = image / np.where(usable, opacity, np.float32(1))[..., None]
            is_integer = False
    if not placement.is_whole:
        usable = placement.put(np.ones(colour.shape[:2], bool) if usable is None else usable)
        image = placement.put(image)
        colour = placement.put(colour)
    return Panorama(
        image=np.ascontiguousarray(image),
        mask=None if usable is None or usable.all() else np.ascontiguousarray(usable),
        original=np.ascontiguousarray(colour) if is_integer else None,
        path=header.path,
    )


def colour_and_alpha(header: ImageHeader, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Samples of three colour channels ``(height, width, 3)`` and of alpha ``(height, width)``."""
    found = (_channel(header.channels, name) for name in "RGB")
    red_green_blue = [index for index in found if index is not None]
    alpha = header.alpha_channel if header.alpha_channel >= 0 else _channel(header.channels, "A")
    colours = [index for index in range(len(header.channels)) if index != alpha]
    if len(red_green_blue) == 3:
        chosen = red_green_blue
    elif len(colours) == 1:
        chosen = colours * 3
    elif len(colours) == 3:
        chosen = colours
    else:
        raise ImageError(
            f"{header.path}: expected grey or RGB channels, got {', '.join(header.channels)}; export an RGB image"
        )
    colour = samples if chosen == list(range(samples.shape[2])) else samples[..., chosen]
    return colour, None if alpha is None else samples[..., alpha]


def _channel(names: tuple[str, ...], wanted: str) -> int | None:
    """Index of a channel by its name, or by the last part of a layered name such as ``ViewLayer.Combined.R``."""
    if wanted in names:
        return names.index(wanted)
    return next((index for index, name in enumerate(names) if name.rpartition(".")[2] == wanted), None)


def _resampled(panorama: Panorama, size: tuple[int, int]) -> Panorama:
    """The same sphere with square pixels, in another height and width."""
    # OpenCV takes a while to import and is needed for odd images only.
    import cv2

    image = np.asarray(cv2.resize(panorama.image, size[::-1], interpolation=cv2.INTER_AREA), np.float32)
    mask = None
    if panorama.mask is not None:
        opacity = cv2.resize(panorama.mask.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA)
        mask = np.asarray(opacity > 1 - 1e-6, bool)
    return Panorama(image, mask, None, panorama.path)
