"""The boxes an MP4 or MOV file is made of: found in the file, opened down to the sample entries, put together again.

Only as much as tagging a video needs. Media data are never loaded; sizes are checked before anything is believed, and
an InputError says what does not hold together.

Source: ISO/IEC 14496-12 (ISO base media file format), sections 4.2, 8.5.2 (``stsd``) and 8.7.5 (``stco``, ``co64``).
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from omnisyn_cli.errors import InputError

MAX_MOVIE_BYTES = 256 << 20  # bytes of ``moov`` that are read into memory; hours of video need a few of these megabytes
MAX_BOXES = 100_000  # boxes side by side; no real video has so many
# By box the child that is opened: the path to the sample entries, which bounds the depth of the recursion.
OPENED_CHILD = {b"moov": b"trak", b"trak": b"mdia", b"mdia": b"minf", b"minf": b"stbl", b"stbl": b"stsd"}
SAMPLE_DESCRIPTION_BYTES = 8  # ``stsd``: version, flags and entry count before its entries
VISUAL_SAMPLE_ENTRY_BYTES = 78  # fixed fields of a video sample entry before its boxes
OFFSET_LETTERS = {b"stco": "I", b"co64": "Q"}  # tables of chunk offsets, and how :mod:`struct` names their numbers


@dataclass(frozen=True)
class FileBox:
    """A box on the top level of a file: ``start`` to ``end`` in bytes, content from ``content``."""

    kind: bytes
    start: int
    content: int
    end: int


@dataclass(frozen=True)
class Box:
    """A box in memory."""

    kind: bytes  # four characters
    head: bytes  # content before the children; all of it in a box without any
    children: tuple["Box", ...] | None = None  # boxes inside, None where this box was not opened
    tail: bytes = b""  # bytes after the last child (QuickTime ends some lists with four zeros)


def top_level_boxes(path: Path) -> tuple[FileBox, ...]:
    """The boxes of a file in order; only their headers are read."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            boxes = tuple(_scan(path, file, size))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a readable video file, got '{error}'; check the name") from error
    if not boxes or boxes[0].kind not in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
        raise broken_file_error(path, "no MP4 box at its beginning")
    return boxes


def broken_file_error(path: Path, what: str) -> InputError:
    """The error for a file whose boxes do not hold together."""
    return InputError(f"{path}: expected a complete MP4 or MOV file, got {what}; encode it anew")


def parse_movie(path: Path, boxes: tuple[FileBox, ...]) -> Box:
    """The ``moov`` box of a file, opened down to the boxes inside the video sample entries."""
    movies = [box for box in boxes if box.kind == b"moov"]
    if len(movies) != 1:
        raise broken_file_error(path, f"{len(movies)} moov boxes where there must be one")
    content, end = movies[0].content, movies[0].end
    if end - content > MAX_MOVIE_BYTES:
        raise broken_file_error(path, f"a moov box of {end - content:,} bytes, more than {MAX_MOVIE_BYTES:,}")
    with path.open("rb") as file:
        file.seek(content)
        data = file.read(end - content)
    movie = _opened(path, Box(b"moov", data))
    if any(box.kind in (b"moof", b"sidx") for box in boxes) or child(movie, b"mvex"):
        raise InputError(f"{path}: expected an unfragmented MP4, got movie fragments; remux it with `ffmpeg -c copy`")
    return movie


def child(box: Box, kind: bytes) -> Box | None:
    """The first child of this kind, or None."""
    return next((inner for inner in box.children or () if inner.kind == kind), None)


def children_of(path: Path, data: bytes, head: int = 0, kind: bytes = b"") -> Box:
    """``data`` as a box with children after ``head`` bytes, none of them opened."""
    if len(data) < head:
        raise broken_file_error(path, "a box too short for its fields")
    children: list[Box] = []
    position = head
    while len(data) - position >= 8:
        if len(children) >= MAX_BOXES:
            raise broken_file_error(path, f"more than {MAX_BOXES} boxes in one")
        inner, start, size = _header(data[position : position + 16])
        if size == 0 and not any(data[position:]):
            break
        if size < start or size > len(data) - position:
            raise broken_file_error(path, f"a box {inner!r} of impossible size {size}")
        children.append(Box(inner, data[position + start : position + size]))
        position += size
    return Box(kind, data[:head], tuple(children), data[position:])


def serialize(box: Box) -> bytes:
    """The bytes of a box with its header; a 64-bit size where it is needed."""
    content = b"".join((box.head, *map(serialize, box.children or ()), box.tail))
    if len(content) + 8 < 1 << 32:
        return struct.pack(">I4s", len(content) + 8, box.kind) + content
    return struct.pack(">I4sQ", 1, box.kind, len(content) + 16) + content


def map_boxes(box: Box, change: Callable[[Box], Box]) -> Box:
    """A box with everything that is opened in it, and then itself, changed."""
    if box.children is not None:
        box = replace(box, children=tuple(map_boxes(each, change) for each in box.children))
    return change(box)


def shift_offsets(path: Path, movie: Box, new_offset: Callable[[int], int], *, wide: bool) -> Box:
    """The movie box with every chunk offset mapped by ``new_offset``; ``wide`` writes 64-bit tables throughout."""

    def shift_box(box: Box) -> Box:
        if box.kind not in OFFSET_LETTERS or box.children is not None:
            return box
        count = int.from_bytes(box.head[4:8], "big")  # after version and flags
        table = struct.Struct(f">{count}{OFFSET_LETTERS[box.kind]}")
        if len(box.head) < 8 + table.size:
            raise broken_file_error(path, "a truncated table of chunk offsets")
        offsets = [new_offset(offset) for offset in table.unpack_from(box.head, 8)]
        kind = b"co64" if wide else box.kind
        return Box(kind, box.head[:8] + struct.pack(f">{count}{OFFSET_LETTERS[kind]}", *offsets))

    return map_boxes(movie, shift_box)


def _header(data: bytes) -> tuple[bytes, int, int]:
    """Kind, bytes before the content, and size of the box that begins with up to 16 bytes of ``data``."""
    size, kind = struct.unpack_from(">I4s", data)  # size 1: 64 bits of size follow; 0: up to the end of the file
    return (kind, 8, size) if size != 1 or len(data) < 16 else (kind, 16, *struct.unpack_from(">Q", data, 8))


def _scan(path: Path, file: BinaryIO, file_size: int) -> Iterator[FileBox]:
    position = 0
    for _ in range(MAX_BOXES):
        if position == file_size:
            return
        file.seek(position)
        header = file.read(16)
        if len(header) < 8:
            raise broken_file_error(path, f"{file_size - position} stray bytes at its end")
        kind, start, size = _header(header)
        content = position + start
        end = file_size if size == 0 else position + size
        if end < content or end > file_size:
            raise broken_file_error(path, f"a box {kind!r} that ends at byte {end} of {file_size}")
        yield FileBox(kind, position, content, end)
        position = end
    raise broken_file_error(path, f"more than {MAX_BOXES} boxes")


def _opened(path: Path, box: Box, *, is_video: bool = False) -> Box:
    """A box with the children that lead to the sample entries opened too; only video sample entries are."""
    if box.kind == b"stsd":
        if not is_video:
            return box
        listed = children_of(path, box.head, SAMPLE_DESCRIPTION_BYTES, box.kind)
        entries = (children_of(path, each.head, VISUAL_SAMPLE_ENTRY_BYTES, each.kind) for each in listed.children or ())
        return replace(listed, children=tuple(entries))
    opened = children_of(path, box.head, kind=box.kind)
    if box.kind == b"mdia":
        handler = child(opened, b"hdlr")
        is_video = handler is not None and handler.head[8:12] == b"vide"  # after version, flags and a reserved field
    inner = OPENED_CHILD[box.kind]
    children = tuple(
        _opened(path, each, is_video=is_video) if each.kind == inner else each for each in opened.children or ()
    )
    return replace(opened, children=children)
