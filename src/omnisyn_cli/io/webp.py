"""What OpenImageIO does not read of a WebP file: the GPano tags of its XMP packet.

Source: Google, "WebP Container Specification"; Google, "Photo Sphere XMP Metadata".
"""

from __future__ import annotations

import html
import math
import os
import re
from pathlib import Path

__all__ = ["panorama_tags"]

MOST_CHUNKS = 10_000
"""A picture has a dozen; whoever writes more of them means to keep us busy."""

LONGEST_XMP = 4 << 20
"""Bytes that are looked at; cameras and stitchers write some kilobytes."""

ATTRIBUTE = re.compile(r"\s(GPano:\w+)\s*=\s*(?:\"([^\"<]*)\"|'([^'<]*)')")

ELEMENT = re.compile(r"<(GPano:\w+)(?:\s[^<>]*)?>([^<]*)</")

FLAGS = {"true": 1, "false": 0}
"""XMP's words, as OpenImageIO tells them of other formats."""


def panorama_tags(path: Path) -> dict[str, int | float | str]:
    """GPano tags of a WebP file by OpenImageIO's names, e.g. ``GPano:FullPanoWidthPixels``; none without XMP.

    They are found as attributes and as elements. Nothing in them is expanded but characters, so nothing in them can be
    hostile, and a damaged file only has fewer of them.
    """
    packet = _xmp(path)
    attributes = {name: double or single for name, double, single in ATTRIBUTE.findall(packet)}
    found = {**attributes, **dict(ELEMENT.findall(packet))}
    return {name: _value(html.unescape(text).strip()) for name, text in found.items()}


def _xmp(path: Path) -> str:
    """The text of the chunk ``XMP `` as far as it lies in the file, else nothing."""
    with path.open("rb") as file:
        end = 8 + int.from_bytes(file.read(12)[4:8], "little")
        for _ in range(MOST_CHUNKS):
            head = file.read(8)
            size = int.from_bytes(head[4:], "little")
            if len(head) < 8 or file.tell() > end:
                break
            if head[:4] == b"XMP ":
                return file.read(min(size, end - file.tell(), LONGEST_XMP)).decode("utf-8", "replace")
            file.seek(size + size % 2, os.SEEK_CUR)
    return ""


def _value(text: str) -> int | float | str:
    """A number where it is one."""
    if text.lower() in FLAGS:
        return FLAGS[text.lower()]
    try:
        number = float(text)
    except ValueError:
        return text
    if not math.isfinite(number):
        return text
    return int(number) if number.is_integer() else number
