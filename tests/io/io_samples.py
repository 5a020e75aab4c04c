"""Small images for tests, written by OpenImageIO or Pillow-free means, and bytes to break."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO

OIIO_TYPES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}


def smooth_image(height: int = 32, width: int = 64, channels: int = 3, seed: int = 0) -> np.ndarray:
    """uint8 samples that JPEG keeps within a few steps, different in every row, column and channel."""
    row, col, channel = np.meshgrid(np.arange(height), np.arange(width), np.arange(channels), indexing="ij")
    return ((row * 3 + col * 2 + channel * 37 + seed * 11) % 200 + 20).astype(np.uint8)


def write_with(
    path: Path, samples: np.ndarray, *, names: tuple[str, ...] = (), window: Any = None, **tags: Any
) -> Path:
    """Write samples with tags (``Orientation=6``, ``**{"GPano:...": 3}``), channel names and an EXR data window."""
    height, width, channels = samples.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, OIIO_TYPES[str(samples.dtype)])
    if names:
        spec.channelnames = names
    if window is not None:
        spec.y, spec.x, spec.full_height, spec.full_width = window
    for name, value in tags.items():
        if isinstance(value, tuple):
            spec.attribute(name, *value)
        else:
            spec[name] = value
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec)
    assert writer.write_image(np.ascontiguousarray(samples))
    assert writer.close()
    writer.geterror()
    return path


def xmp_packet(tags: dict[str, Any], form: str) -> bytes:
    """An XMP packet that says ``tags`` (``{"GPano:...": 3}``) as ``attributes`` or as ``elements``."""
    attributes = "".join(f"\n  {name}='{value}'" for name, value in tags.items())
    elements = "".join(f"\n  <{name}>{value}</{name}>" for name, value in tags.items())
    inside = f"{attributes}/>" if form == "attributes" else f">{elements}\n </rdf:Description>"
    return (
        "<?xpacket begin='\ufeff' id='W5M0MpCehiHzreSzNTczkc9d'?>\n<x:xmpmeta xmlns:x='adobe:ns:meta/'>\n"
        "<rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'>\n <rdf:Description rdf:about=''\n"
        f"  xmlns:GPano='http://ns.google.com/photos/1.0/panorama/'{inside}\n</rdf:RDF>\n</x:xmpmeta>\n"
        "<?xpacket end='w'?>"
    ).encode()


def exif_of(jpeg: bytes) -> bytes:
    """The EXIF block of a JPEG, as other formats hold it."""
    start = jpeg.index(b"Exif\0\0")
    return jpeg[start + 6 : start - 2 + int.from_bytes(jpeg[start - 2 : start], "big")]


def riff_chunk(kind: bytes, data: bytes) -> bytes:
    return kind + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)


def webp_with(webp: bytes, size: tuple[int, int], *, xmp: bytes = b"", exif: bytes = b"") -> bytes:
    """A simple WebP of ``(height, width)`` in the extended format, with an XMP packet and an EXIF block."""
    height, width = size
    flags = 0x04 * bool(xmp) | 0x08 * bool(exif)
    canvas = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    metadata = [riff_chunk(kind, data) for kind, data in ((b"EXIF", exif), (b"XMP ", xmp)) if data]
    chunks = (b"WEBP", riff_chunk(b"VP8X", bytes([flags, 0, 0, 0]) + canvas), webp[12:], *metadata)
    return riff_chunk(b"RIFF", b"".join(chunks))


def png_with_xmp(png: bytes, xmp: bytes) -> bytes:
    """The same PNG with an XMP packet after its header."""
    body = b"iTXtXML:com.adobe.xmp" + bytes(5) + xmp
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:33] + chunk + png[33:]
