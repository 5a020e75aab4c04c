"""Image files as they are: header and pixels, every sign of damage turned into an error.

OpenImageIO decodes. What it does not say, because its libraries do not tell it, is checked here: a PNG that lost only
its end marker, and a JPEG whose missing part has been painted grey. What it does not read of a WebP file is read
here: the GPano tags of its XMP packet.
"""

import html
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from jaxtyping import Shaped

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io.colour import ColourProfile, parse_profile
from omnisyn_cli.io.heif import AVIF_SUFFIX, HEIC_SUFFIXES, damaged, png_of
from omnisyn_cli.io.jpeg_metadata import JPEG_MAGIC, xmp_packet

# Twice the pixels of the largest panorama worth reading; more is taken for a mistake or an attack.
MAX_PIXELS = 2 * 16384 * 8192
MAX_SAMPLES_PER_PIXEL = 4  # an image of many layers may have this many times ``max_pixels`` samples altogether
MAX_COMPLAINT_CHARS = 500  # characters of what a decoder says that are passed on
BELOW_ZERO_ALTITUDE_REFS = (1, 3)  # values of EXIF's GPSAltitudeRef that mean below sea level and below the ellipsoid
LINEAR_FORMATS = ("openexr", "hdr")  # formats, by OpenImageIO's names, whose values are linear light
SHOWN_ATTRIBUTE = "omnisyn:displayReferred"  # of EXR files whose samples are sRGB, as this program writes frames
# What decoders say about files that are complete nevertheless.
HARMLESS_COMPLAINTS = ("extraneous bytes before marker",)
TIFF_RGB = 2  # value of the tag PhotometricInterpretation, TIFF 6.0
# Photometric interpretations that OpenImageIO turns into RGB or grey: inverted grey, grey, RGB, palette, CMYK, YCbCr.
# Others, such as CIELAB (8), it hands out as if they were RGB. Source: TIFF 6.0, section 8.
TIFF_COLOURS = (0, 1, TIFF_RGB, 3, 5, 6)
# Formats whose pictures can be turned to and back; of a WebP there is no way back, but it says what it is.
FORMATS_OF_MANY_PICTURES = ("gif", "tiff", "openexr")
MAX_RIFF_CHUNKS = 10_000  # a picture has a dozen chunks; a file with more is hostile
MAX_XMP_BYTES = 4 << 20  # bytes of XMP that are read; cameras and stitchers write some kilobytes
# XMP may write a property as an attribute.
GPANO_ATTRIBUTE = re.compile(r"\s(GPano:\w+)\s*=\s*(?:\"([^\"<]*)\"|'([^'<]*)')")
GPANO_ELEMENT = re.compile(r"<(GPano:\w+)(?:\s[^<>]*)?>([^<]*)</")  # it may write it as an element, too
# Any prefix may stand for the namespace of these tags.
GPANO_PREFIX = re.compile(r"xmlns:([\w.-]+)\s*=\s*[\"']http://ns\.google\.com/photos/1\.0/panorama/[\"']")
XMP_BOOLEANS = {"true": 1, "false": 0}  # XMP's booleans as the integers that OpenImageIO gives for other formats


@dataclass(frozen=True)
class ImageHeader:
    """What an image file says about itself before any pixel is decoded."""

    path: Path  # the file
    format: str  # OpenImageIO's name of the format, e.g. ``jpeg``.
    # pixels stored, before orientation is applied
    height: int
    width: int
    # position of the stored pixels in the full picture (OpenEXR's data window), else 0
    top: int
    left: int
    # size of the full picture (OpenEXR's display window), else ``height, width``
    full_height: int
    full_width: int
    channels: tuple[str, ...]  # names, e.g. ``("R", "G", "B", "A")``.
    dtype: str  # of the stored samples, e.g. ``uint8``.
    alpha_channel: int  # index into ``channels``, or −1
    is_alpha_associated: bool  # whether colours are stored multiplied by alpha
    orientation: int  # EXIF orientation, 1 to 8
    attributes: Mapping[str, Any]  # all other metadata by OpenImageIO's names, e.g. ``GPano:FullPanoWidthPixels``.
    has_more_pictures: bool = False  # whether others of its size follow, as in an animation; only the first is read

    @property
    def is_linear(self) -> bool:
        """Whether samples are linear light, as OpenEXR and Radiance HDR have it unless they say otherwise."""
        return self.format in LINEAR_FORMATS and SHOWN_ATTRIBUTE not in self.attributes

    @property
    def colour_profile(self) -> ColourProfile | None:
        """The embedded ICC profile, if its colours are others than sRGB's."""
        data = self.attributes.get("ICCProfile")
        return None if data is None else parse_profile(bytes(np.asarray(data, np.uint8)))

    @property
    def altitude(self) -> float | None:
        """Metres of EXIF's GPS altitude, negative below the sea level or the ellipsoid; None without one."""
        metres = self.number("GPS:Altitude")
        return -metres if metres is not None and self.number("GPS:AltitudeRef") in BELOW_ZERO_ALTITUDE_REFS else metres

    def number(self, name: str) -> float | None:
        """A finite numeric attribute, or None where it is missing or not a number."""
        try:
            value = float(self.attributes[name])
        except (KeyError, TypeError, ValueError):
            return None
        return value if math.isfinite(value) else None

    def degrees(self, name: str, negative: str) -> float | None:
        """An EXIF angle (Exif 2.32, 4.6.6), below zero where its ``Ref`` is ``negative``; None if missing."""
        try:
            degrees, minutes, seconds = (float(part) for part in self.attributes[name])
        except (KeyError, TypeError, ValueError):
            return None
        angle = degrees + minutes / 60.0 + seconds / 3600.0
        is_negative = str(self.attributes.get(f"{name}Ref", "")).strip().upper().startswith(negative)
        return -angle if is_negative else angle


def read_header(path: Path | str) -> ImageHeader:
    """Header of an image file, without decoding pixels (but of WebP). ImageError: missing, empty, or not an image."""
    with _opened(Path(path)) as (header, _):
        return header


def decode_image(
    path: Path | str, *, max_pixels: int = MAX_PIXELS
) -> tuple[ImageHeader, Shaped[np.ndarray, "height width channels"]]:
    """Header and samples ``(height, width, channels)`` in the file's own type, neither turned nor premultiplied.

    ImageError: missing, empty, not an image, larger than ``max_pixels``, truncated or damaged.
    """
    source = Path(path)
    if _is_heif(source):  # its size is known before any pixel is decoded
        first = read_header(source)
        check_pixel_count(source, first.height, first.width, max_pixels)
    with _opened(source, with_pixels=True) as (header, reader):
        check_pixel_count(source, header.full_height, header.full_width, max_pixels)
        check_pixel_count(source, header.height, header.width, max_pixels)
        samples, most = header.height * header.width * len(header.channels), MAX_SAMPLES_PER_PIXEL * max_pixels
        if samples > most:  # small pictures with thousands of layers
            raise ImageError(
                f"{source}: expected at most {most:,} samples, got {len(header.channels)} channels of "
                f"{header.width}×{header.height}; export the layer that is needed alone"
            )
        pixels = reader.read_image(0, 0, 0, len(header.channels), reader.spec().format)
        complaint = _complaint(reader.geterror)
    if pixels is None or complaint:
        raise damaged(source, complaint or "no pixels")
    if header.format == "png":  # libpng does not wait for the end marker
        size = source.stat().st_size
        if not any(name == b"IEND" and end <= size for name, end in _png_chunks(source)):
            raise damaged(source, "PNG without its end marker")
    return header, pixels


def check_pixel_count(path: Path, height: int, width: int, max_pixels: int) -> None:
    """Refuse sizes that are empty or beyond ``max_pixels``."""
    if height < 1 or width < 1:
        raise ImageError(f"{path}: expected at least one pixel, got {width}×{height}; export the image anew")
    if height * width > max_pixels:
        raise ImageError(
            f"{path}: expected at most {max_pixels:,} pixels, got {width}×{height} = {height * width:,}; "
            "scale the image down, or allow more (--max-pixels)"
        )


def _is_heif(path: Path) -> bool:
    return path.suffix.lower() in (*HEIC_SUFFIXES, AVIF_SUFFIX)


@contextmanager
def _opened(path: Path, *, with_pixels: bool = False) -> Iterator[tuple[ImageHeader, Any]]:
    """Header and reader of a file; without pixels where nobody is going to read them and that saves time."""
    check_is_file(path)
    if _is_heif(path):
        with png_of(path, with_pixels=with_pixels) as (png, (height, width)), _opened(png) as (header, reader):
            told = replace(header, path=path, format=path.suffix.lower().lstrip("."))
            yield replace(told, height=height, width=width, full_height=height, full_width=width), reader
        return
    config = OpenImageIO.ImageSpec()
    config["oiio:UnassociatedAlpha"] = 1
    reader = OpenImageIO.ImageInput.open(str(path), config)
    complaint = _complaint(OpenImageIO.geterror)
    if reader is None:
        raise ImageError(f"{path}: expected an image, got '{complaint or 'unknown format'}'; check the file")
    try:
        yield _header(path, reader), reader
    finally:
        reader.close()


def check_is_file(path: Path) -> None:
    """Refuse paths that are missing, a folder, an empty file or not readable."""
    if (name := str(path)).encode("utf-8", "replace") != name.encode("utf-8", "surrogateescape"):
        raise ImageError(f"{name!r}: expected a file name in UTF-8, got other bytes; rename the file or its folder")
    try:
        if not path.is_file():
            if path.is_dir():
                raise ImageError(f"{path}: expected a file, got a folder; name the files in it")
            found = "a device or a pipe" if path.exists() else "no such file"
            raise ImageError(f"{path}: expected a file, got {found}; check the name")
        if path.stat().st_size == 0:
            raise ImageError(f"{path}: expected an image, got an empty file; copy or export it anew")
        with path.open("rb"):
            pass
    except (OSError, ValueError) as problem:
        raise ImageError(f"{path}: expected a readable file, got '{problem}'; check name and permissions") from problem


def _header(path: Path, reader: Any) -> ImageHeader:
    has_more_pictures = _has_more_pictures(path, reader)
    spec = reader.spec()
    if (colours := spec.get_int_attribute("tiff:PhotometricInterpretation", TIFF_RGB)) not in TIFF_COLOURS:
        found = spec.get_string_attribute("tiff:ColorSpace", f"kind {colours}")
        raise ImageError(f"{path}: expected colours in RGB, grey or CMYK, got {found}; convert the image to sRGB")
    try:
        channels = tuple(spec.channelnames)
    except UnicodeDecodeError as error:
        raise damaged(path, "names of channels that are no text") from error
    # Only OpenEXR means its data window: TIFF and PNG positions are printing hints.
    has_window = reader.format_name() == "openexr"
    return ImageHeader(
        path=path,
        format=reader.format_name(),
        height=spec.height,
        width=spec.width,
        top=spec.y - spec.full_y if has_window else 0,
        left=spec.x - spec.full_x if has_window else 0,
        full_height=spec.full_height if has_window else spec.height,
        full_width=spec.full_width if has_window else spec.width,
        channels=channels,
        dtype=str(spec.format),
        alpha_channel=spec.alpha_channel if spec.alpha_channel < len(channels) else -1,  # GIF: one beyond the last
        is_alpha_associated=spec.get_int_attribute("oiio:UnassociatedAlpha", 0) == 0,
        orientation=spec.get_int_attribute("Orientation", 1),
        attributes=_attributes(path, reader),
        has_more_pictures=has_more_pictures,
    )


def _has_more_pictures(path: Path, reader: Any) -> bool:
    """Whether pictures of the same size follow the first; smaller ones are thumbnails and reductions of it."""
    if reader.format_name() == "png":
        return next((name == b"acTL" for name, _ in _png_chunks(path) if name in (b"acTL", b"IDAT")), False)
    first = reader.spec()
    if reader.format_name() not in FORMATS_OF_MANY_PICTURES:
        return bool(first.get_int_attribute("oiio:Movie", 0))
    has_same_size = bool(reader.seek_subimage(1, 0)) and (
        (reader.spec().width, reader.spec().height) == (first.width, first.height)
    )
    _complaint(reader.geterror)  # a damaged second picture does no harm
    reader.seek_subimage(0, 0)
    return has_same_size


def _attributes(path: Path, reader: Any) -> dict[str, Any]:
    """Metadata by name, without what is no text: old programs wrote comments in encodings of their own."""
    found = {}
    for attribute in reader.spec().extra_attribs:
        try:
            found[attribute.name] = attribute.value
        except UnicodeDecodeError:
            continue
    is_untold = reader.format_name() in ("webp", "jpeg") and not any(name.startswith("GPano:") for name in found)
    return {**found, **panorama_tags(path)} if is_untold else found


def _complaint(message: Callable[[], str]) -> str:
    """A decoder's words on one line, whatever bytes of the file it quotes, without those that mean no harm."""
    try:
        text = message()
    except UnicodeDecodeError as error:
        text = error.object.decode("utf-8", "backslashreplace")
    lines = [line.strip() for line in text.splitlines()]
    harmful = [line for line in lines if line and not any(harmless in line for harmless in HARMLESS_COMPLAINTS)]
    complaints = (line for k, line in enumerate(harmful) if not any(line in other for other in harmful[k + 1 :]))
    return "; ".join(complaints)[:MAX_COMPLAINT_CHARS]


def _png_chunks(path: Path) -> Iterator[tuple[bytes, int]]:
    """Name of each chunk of a PNG, and where in the file it ends; see section 5.3 of its specification."""
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            end = file.tell() + int.from_bytes(head[:4], "big") + 4
            yield head[4:], end
            file.seek(end)


def panorama_tags(path: Path) -> dict[str, int | float | str]:
    """GPano tags of a WebP or JPEG file by OpenImageIO's names, e.g. ``GPano:FullPanoWidthPixels``; none without XMP.

    OpenImageIO knows none of WebP, and of JPEG those with the usual prefix. They are found as attributes and as
    elements. Nothing in them is expanded but characters, so nothing in them can be hostile, and a damaged file only has
    fewer of them.

    Source: Google, "WebP Container Specification"; Google, "Photo Sphere XMP Metadata".
    """
    packet = _xmp(path)
    if (declared := GPANO_PREFIX.search(packet)) and declared[1] != "GPano":
        packet = re.sub(rf"(?<=[\s</]){re.escape(declared[1])}:", "GPano:", packet)
    attributes = {name: double or single for name, double, single in GPANO_ATTRIBUTE.findall(packet)}
    found = {**attributes, **dict(GPANO_ELEMENT.findall(packet))}
    return {name: _value(html.unescape(text).strip()) for name, text in found.items()}


def _xmp(path: Path) -> str:
    """The text of XMP in a JPEG's segment, or in the chunk ``XMP `` as far as it lies in the file, else nothing."""
    with path.open("rb") as file:
        if file.peek()[:2] == JPEG_MAGIC:
            return xmp_packet(path, file.read(MAX_XMP_BYTES)).decode("utf-8", "replace")
        end = 8 + int.from_bytes(file.read(12)[4:8], "little")
        for _ in range(MAX_RIFF_CHUNKS):
            head = file.read(8)
            size = int.from_bytes(head[4:], "little")
            if len(head) < 8 or file.tell() > end:
                break
            if head[:4] == b"XMP ":
                return file.read(min(size, end - file.tell(), MAX_XMP_BYTES)).decode("utf-8", "replace")
            file.seek(size + size % 2, os.SEEK_CUR)
    return ""


def _value(text: str) -> int | float | str:
    """A number where it is one."""
    if text.lower() in XMP_BOOLEANS:
        return XMP_BOOLEANS[text.lower()]
    try:
        number = float(text)
    except ValueError:
        return text
    if not math.isfinite(number):
        return text
    return int(number) if number.is_integer() else number
