"""Panoramas and masks read from files: upright, complete spheres, RGB in [0, 1], W = 2H; photographs for textures."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt8

from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.io.colour import view_transform
from omnisyn_cli.io.decode import MAX_PIXELS, ImageHeader, check_pixel_count, decode_image
from omnisyn_cli.io.placement import DEFAULT_READING, TRANSPOSING_ORIENTATIONS, Placement, Reading, placement_of
from omnisyn_cli.io.projections import GENERAL_REMEDY, are_stacked_alike, described_shape, described_sphere, is_sphere

INTEGER_PEAKS = {"uint8": 255, "uint16": 65535}  # samples of white, by their type
FLOAT_TYPES = frozenset({"float16", "float32", "float64"})  # types of decoded pictures that are taken as they are
MIN_PANORAMA_HEIGHT = 2  # rows of the smallest panorama that a surface can be made of
MIN_USABLE_ALPHA = 0.5  # pixels that are less opaque than this are not usable
MIN_FRAME_WIDTH = 128  # pixels of the narrowest video frame: a pixel more or less of its height is no other shape


@dataclass(frozen=True)
class Panorama:
    """An equirectangular image that covers the whole sphere."""

    image: Float[np.ndarray, "height width 3"]  # RGB in [0, 1], width = 2·height; floating-point files may exceed 1
    # ``(height, width)``, True where the image is usable; None means everywhere
    mask: Bool[np.ndarray, "height width"] | None
    # uint8 or uint16 with exactly the samples of the file, upright and completed like ``image``, or reduced and
    # converted to sRGB; None for floating-point files and where samples had to be stretched or divided by alpha
    original: Shaped[np.ndarray, "height width 3"] | None
    path: Path  # the file it came from


def read_panorama(
    path: Path | str, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS, reading: Reading = DEFAULT_READING
) -> Panorama:
    """Read a panorama, turn it upright and complete it to the whole sphere.

    EXIF orientation is applied; a cropped panorama (GPano tags, OpenEXR data window, or as ``reading`` says) is put in
    its place in the full sphere and the rest is masked; grey becomes RGB; alpha becomes the mask; colours of an ICC
    profile become sRGB. Squeezed frames of 16:9 are stretched to 2:1.

    JPEG, PNG, TIFF, EXR, HDR, WebP, JPEG XL, HEIC and AVIF are read. With ``allow_aspect`` images that are not 2:1 are
    resampled, as if their pixels were not square. Larger images than ``max_pixels`` are refused before decoding.
    ImageError: missing, empty, damaged, too large or too small, not 2:1, not equirectangular, or with NaN or infinite
    samples.
    """
    limits: dict[str, Any] = {"allow_aspect": allow_aspect, "max_pixels": max_pixels, "reading": reading}
    return _read_sphere(path, is_photograph=True, **limits)


def _read_sphere(
    path: Path | str, *, is_photograph: bool, allow_aspect: bool, max_pixels: int, reading: Reading
) -> Panorama:
    """What :func:`read_panorama` says; photographs are looked at, whether they show a sphere."""
    header, samples = decode_image(path, max_pixels=max_pixels)
    size = sphere_size(header, allow_aspect=allow_aspect, max_pixels=max_pixels, reading=reading)
    colour, alpha = _upright_colour(header, samples, reading)
    placement = placement_of(header, reading)
    if is_photograph and placement.is_whole:
        _check_content(header.path, colour, placement, allow_aspect=allow_aspect)
    if reading.size is not None and reading.size < size:
        size = reading.size
        colour, alpha, placement = _reduced(header, colour, alpha, placement, size)
    if (profile := header.colour_profile) is not None and str(colour.dtype) in INTEGER_PEAKS:
        colour = profile.to_srgb(colour, INTEGER_PEAKS[str(colour.dtype)])
    if reading.view_transform and header.is_linear:
        colour = view_transform(unit_range(colour, header.path))
    panorama = _panorama(header, colour, alpha, placement)
    if panorama.image.shape[:2] == size:
        return panorama
    # the same sphere with square pixels, in another height and width
    mask = None if panorama.mask is None else _resized(panorama.mask.astype(np.float32), size) > 1.0 - 1e-6
    return Panorama(_resized(panorama.image, size), mask, None, panorama.path)


def sphere_size(
    header: ImageHeader, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS, reading: Reading = DEFAULT_READING
) -> tuple[int, int]:
    """Height and width of the sphere that a file becomes in full; ImageError: too large, too small, not 2:1."""
    placement = placement_of(header, reading)
    height, width = placement.full_size
    check_pixel_count(header.path, height, width, max_pixels)
    if min(height, width // 2) < MIN_PANORAMA_HEIGHT:
        raise ImageError(
            f"{header.path}: expected a panorama of at least {2 * MIN_PANORAMA_HEIGHT}×{MIN_PANORAMA_HEIGHT}, "
            f"got {width}×{height}; choose a larger image"
        )
    if width == 2 * height:
        return height, width
    if not (allow_aspect or is_squeezed(placement) or reading.is_partial):
        found = GENERAL_REMEDY
        if placement.is_whole:  # it is looked at, as it is refused anyway
            colour, _ = _upright_colour(header, decode_image(header.path, max_pixels=max_pixels)[1], reading)
            found = described_shape(colour, INTEGER_PEAKS.get(str(colour.dtype), 1))
        raise _shape_error(header.path, width, height, found)
    return width // 2, width // 2 * 2


def is_squeezed(placement: Placement) -> bool:
    """Whether a picture has the shape of a video's frame of 16:9, to which some cameras squeeze the sphere."""
    is_wide = placement.width >= MIN_FRAME_WIDTH and abs(9 * placement.width - 16 * placement.height) <= 16
    return placement.is_whole and is_wide


def _shape_error(path: Path, width: int, height: int, found: str) -> ImageError:
    return ImageError(
        f"{path}: expected an equirectangular panorama twice as wide as high, got {width}×{height}{found}"
    )


def _check_content(path: Path, colour: np.ndarray, placement: Placement, *, allow_aspect: bool) -> None:
    """Refuse (ImageError) squares whose halves show the same, and what is no sphere unless its shape is allowed."""
    height, width = colour.shape[:2]
    if allow_aspect:
        if width == height and are_stacked_alike(colour):
            raise ImageError(
                f"{path}: expected one picture of the sphere, got two that are alike, one above the other: this looks "
                "like top-bottom stereo; use the upper half (--upper-half)"
            )
    elif is_squeezed(placement) and not is_sphere(colour):
        raise _shape_error(path, width, height, GENERAL_REMEDY)
    elif width == 2 * height and (found := described_sphere(colour, INTEGER_PEAKS.get(str(colour.dtype), 1))):
        raise ImageError(f"{path}: expected an equirectangular panorama, got {found}")


def _reduced(
    header: ImageHeader, colour: np.ndarray, alpha: np.ndarray | None, placement: Placement, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray | None, Placement]:
    """Samples of a smaller sphere, by means over areas, before they become numbers of four times the memory."""
    if colour.dtype == np.float16:
        colour = colour.astype(np.float32)
    if header.is_alpha_associated and alpha is not None and (alpha != INTEGER_PEAKS.get(str(alpha.dtype), 1)).any():
        return colour, alpha, placement
    opaque = INTEGER_PEAKS.get(str(colour.dtype), 1)
    smaller = _resized(placement.put(colour), size)
    if alpha is not None or not placement.is_whole:  # the new alpha is white where all of a pixel is known
        known = np.ones(colour.shape[:2], bool) if alpha is None else unit_range(alpha, header.path) >= MIN_USABLE_ALPHA
        is_whole = _resized(placement.put(known.astype(np.float32)), size) > 1.0 - 1e-6
        alpha = np.where(is_whole, opaque, 0).astype(colour.dtype)
    return smaller, alpha, Placement(*size, 0, 0, *size)


def read_mask(
    path: Path | str, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS, reading: Reading = DEFAULT_READING
) -> Bool[np.ndarray, "height width"]:
    """Read a mask: True (usable) where the first channel is at least half of white; else as :func:`read_panorama`."""
    limits: dict[str, Any] = {"allow_aspect": allow_aspect, "max_pixels": max_pixels}
    # linear light keeps its numbers
    panorama = _read_sphere(path, is_photograph=False, reading=replace(reading, view_transform=False), **limits)
    bright = panorama.image[..., 0] >= 0.5
    return bright if panorama.mask is None else bright & panorama.mask


def usable_part(
    own: Bool[np.ndarray, "height width"] | None, size: tuple[int, ...], masks: Iterable[Path | None], nadir: float,
    *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS, reading: Reading = DEFAULT_READING,
) -> Bool[np.ndarray, "height width"] | None:  # fmt: skip
    """True where a panorama may be used; None where all of it may.

    ``own`` is the mask that came with the picture of ``size`` (height, width), its alpha channel. Images of ``masks``
    are black where it must not be used and read as :func:`read_mask` does; nor may what lies within ``nadir`` radians
    around straight down. ImageError: a mask cannot be read. InputError: it has another size, or forbids everything.
    """
    parts = [] if own is None else [own]
    for path in (path for path in masks if path is not None):
        mask = read_mask(path, allow_aspect=allow_aspect, max_pixels=max_pixels, reading=reading)
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
    """Refuse (InputError) a mask of another height and width than its panorama."""
    if size != expected:
        raise InputError(
            f"{path}: expected a mask of {expected[1]}×{expected[0]} pixels, got {size[1]}×{size[0]}; "
            "give it the size of its panorama"
        )


def outside_nadir(size: tuple[int, int], angle: float) -> Bool[np.ndarray, "height width"]:
    """True farther than ``angle`` radians away from the nadir of the image.

    Its own: the last row of the image, whatever the pose says, because a tripod and the roof of a car turn with the
    camera. With an angle of 0 it is True everywhere.
    """
    cos_polar = direction_tables(*size)[1]
    rows = np.asarray(-cos_polar <= math.cos(angle)) if angle > 0.0 else np.ones(size[0], bool)
    return np.repeat(rows[:, None], size[1], axis=1)


def upright(samples: np.ndarray, orientation: int) -> np.ndarray:
    """Undo an EXIF orientation: ``(rows, cols, channels)`` as stored to ``(height, width, channels)`` as seen.

    Source: Exif 2.32, tag 0x0112.
    """
    if orientation in (3, 4, 6, 7):
        samples = samples[::-1]
    if orientation in (2, 3, 7, 8):
        samples = samples[:, ::-1]
    return samples.swapaxes(0, 1) if orientation in TRANSPOSING_ORIENTATIONS else samples


def unit_range(samples: np.ndarray, path: Path) -> Float[np.ndarray, "*shape"]:
    """Integer samples divided by their peak, others kept, as float32; ImageError: of another type, NaN or infinite."""
    name = str(samples.dtype)
    if name in INTEGER_PEAKS:
        unit: np.ndarray = np.divide(samples, np.float32(INTEGER_PEAKS[name]), dtype=np.float32)
        return unit
    if name not in FLOAT_TYPES:
        raise ImageError(f"{path}: expected 8- or 16-bit or floating-point samples, got {name}; convert it first")
    finite = np.isfinite(samples)
    if not finite.all():
        raise ImageError(
            f"{path}: expected finite samples, got {np.count_nonzero(~finite)} NaN or infinite; export it anew"
        )
    return samples.astype(np.float32)


def _panorama(header: ImageHeader, colour: np.ndarray, alpha: np.ndarray | None, placement: Placement) -> Panorama:
    is_integer = str(colour.dtype) in INTEGER_PEAKS
    image, usable = unit_range(colour, header.path), None
    if alpha is not None:
        opacity = unit_range(alpha, header.path)
        usable = opacity >= MIN_USABLE_ALPHA
        if header.is_alpha_associated and bool(np.any(usable & (opacity < 1))):
            image = image / np.where(usable, opacity, np.float32(1))[..., None]
            is_integer = False
    if not placement.is_whole:
        usable = placement.put(np.ones(colour.shape[:2], bool) if usable is None else usable)
    image, colour = placement.put(image), placement.put(colour)
    return Panorama(
        image=np.ascontiguousarray(image),
        mask=None if usable is None or usable.all() else np.ascontiguousarray(usable),
        original=np.ascontiguousarray(colour) if is_integer else None,
        path=header.path,
    )


def _upright_colour(header: ImageHeader, samples: np.ndarray, reading: Reading) -> tuple[np.ndarray, np.ndarray | None]:
    """Colour and alpha of what is wanted of a picture, turned upright."""
    picture = upright(samples, header.orientation)
    return colour_and_alpha(header, picture[: len(picture) // 2] if reading.upper_half else picture)


def colour_and_alpha(header: ImageHeader, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Samples of three colour channels ``(height, width, 3)`` and of alpha ``(height, width)``."""
    red_green_blue = [index for name in "RGB" if (index := channel_of(header, name)) is not None]
    alpha = header.alpha_channel if header.alpha_channel >= 0 else channel_of(header, "A")
    others = [index for index in range(len(header.channels)) if index != alpha]
    chosen = next((c for c in (red_green_blue, others * 3 if len(others) == 1 else others) if len(c) == 3), None)
    if chosen is None:
        raise ImageError(f"{header.path}: expected grey or RGB, got {', '.join(header.channels)}; export an RGB image")
    colour = samples if chosen == list(range(samples.shape[2])) else samples[..., chosen]
    return colour, None if alpha is None else samples[..., alpha]


def channel_of(header: ImageHeader, wanted: str) -> int | None:
    """Index of a channel by its name, or by the last part of a layered name such as ``ViewLayer.Combined.R``."""
    if wanted in header.channels:
        return header.channels.index(wanted)
    return next((index for index, name in enumerate(header.channels) if name.rpartition(".")[2] == wanted), None)


def _resized(samples: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """In another height and width, by means over areas."""
    import cv2  # loaded only here: a plan needs this package, and no more

    return np.asarray(cv2.resize(samples, size[::-1], interpolation=cv2.INTER_AREA))


# Files that count as photographs of surfaces.
PHOTOGRAPH_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"})
MAX_PHOTOGRAPH_SIDE = 768  # pixels of the longer side that are kept: two megabytes a photograph, with its mip levels
MAX_PHOTOGRAPHS = 2000  # photographs in a folder: four gigabytes at most, much less where they are small


def list_photographs(folder: Path) -> list[Path]:
    """All photographs in a folder and below, ordered by their names. InputError: no folder, no photograph, too many."""
    if not folder.is_dir():
        raise InputError(f"expected a folder of photographs at {folder}, found none; check the name")
    paths = [path for path in folder.rglob("*") if path.suffix.lower() in PHOTOGRAPH_SUFFIXES and path.is_file()]
    if not paths:
        known = ", ".join(sorted(PHOTOGRAPH_SUFFIXES))
        raise InputError(f"expected photographs ({known}) in {folder}, found none; put some into it")
    if len(paths) > MAX_PHOTOGRAPHS:
        raise InputError(f"expected at most {MAX_PHOTOGRAPHS} photographs in {folder}, found {len(paths)}; move some")
    return sorted(paths, key=lambda path: path.relative_to(folder).as_posix())


def read_photographs(folder: Path) -> list[UInt8[np.ndarray, "height width 3"]]:
    """All photographs of a folder, upright, sRGB, at most :data:`MAX_PHOTOGRAPH_SIDE` pixels long; alpha is ignored.

    InputError: as :func:`list_photographs`. ImageError: one of them cannot be read; the message names it.
    """
    return [read_picture(path, MAX_PHOTOGRAPH_SIDE) for path in list_photographs(folder)]


def read_picture(path: Path, longest_side: int) -> UInt8[np.ndarray, "height width 3"]:
    """An ordinary picture, upright, sRGB, without alpha, its longer side at most this long. ImageError: no image."""
    header, samples = decode_image(path)
    colour, _ = colour_and_alpha(header, upright(samples, header.orientation))
    image = np.clip(unit_range(colour, path), 0.0, 1.0)
    scale = min(1.0, longest_side / max(image.shape[:2]))
    if scale < 1.0:
        image = _resized(image, (max(1, round(scale * image.shape[0])), max(1, round(scale * image.shape[1]))))
    return np.ascontiguousarray(np.rint(image * 255.0).astype(np.uint8))
