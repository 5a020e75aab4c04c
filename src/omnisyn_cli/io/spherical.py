"""Tell players that a video is a 360° panorama, in both ways that are in use, and read back what a file says.

Version 1 is a ``uuid`` box with RDF XML in the track; version 2 is the boxes ``st3d`` and ``sv3d`` in the video sample
entry. ffmpeg can read but not write either.

Source: Google, "Spherical Video RFC" (version 1) and "Spherical Video V2 RFC",
https://github.com/google/spatial-media/tree/master/docs.
"""

import re
import struct
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import InputError, WriteError
from omnisyn_cli.io import boxes as mp4
from omnisyn_cli.io.outputs import replaced_when_complete

# Of the box with :data:`SPHERICAL_XML`: Spherical Video V1 RFC.
SPHERICAL_UUID = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")
SOFTWARE = "OmniSyn"  # what players show as the program that stitched
# Metadata after the Spherical Video V1 RFC.
SPHERICAL_XML = (
    '<?xml version="1.0"?>'
    '<rdf:SphericalVideo xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"'
    ' xmlns:GSpherical="http://ns.google.com/videos/1.0/spherical/">'
    "<GSpherical:Spherical>true</GSpherical:Spherical>"
    "<GSpherical:Stitched>true</GSpherical:Stitched>"
    f"<GSpherical:StitchingSoftware>{SOFTWARE}</GSpherical:StitchingSoftware>"
    "<GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType>"
    "{stereo}</rdf:SphericalVideo>"
)
STEREO_MODES = {0: "mono", 1: "top-bottom", 2: "left-right"}  # values of the box ``st3d``: Spherical Video V2 RFC.
# Boxes in ``proj``: Spherical Video V2 RFC.
PROJECTIONS = {b"equi": "equirectangular", b"cbmp": "cubemap", b"mshp": "mesh"}
SAMPLE_ENTRY_SIZE_AT = 24  # byte of a video sample entry where its width and height are: ISO/IEC 14496-12, 12.1.3
COPY_BLOCK_BYTES = 4 << 20  # media data are copied in blocks of this size


@dataclass(frozen=True)
class SphericalMetadata:
    """What a video says about its projection."""

    has_version_1: bool = False  # whether the first video track carries the RDF XML
    has_version_2: bool = False  # whether its sample entry carries ``sv3d``
    projection: str | None = None  # ``equirectangular``, ``cubemap``, ``mesh``; None where nothing is said
    stereo_mode: str | None = None  # ``mono``, ``top-bottom``, ``left-right``; None where nothing is said
    software: str | None = None  # who wrote the metadata
    size: tuple[int, int] = (0, 0)  # height and width of the video

    @property
    def versions(self) -> list[str]:
        """The versions that are there, in words."""
        found = ((1, self.has_version_1), (2, self.has_version_2))
        return [f"version {number}" for number, is_there in found if is_there]


def inject_spherical(source: Path | str, target: Path | str, stereo_mode: str | None = "mono") -> None:
    """Copy an MP4 or MOV file with its video tracks tagged as equirectangular panoramas, both versions.

    ``stereo_mode`` is one of :data:`STEREO_MODES`' words; None is that of a flat video, which gets no tags.

    ``moov`` is put before the media data, so that players can start before the whole file has come. Tags that are there
    already are replaced. Media data are streamed, never loaded. An existing target is replaced.

    InputError: the source is missing, truncated, fragmented, has no video or is no MP4 or MOV file. WriteError: the
    disk is full, or the folder went away.
    """
    origin, destination = Path(source), Path(target)
    ranks = {b"ftyp": 0, b"moov": 1}  # then everything else in its order
    boxes = tuple(sorted(mp4.top_level_boxes(origin), key=lambda box: ranks.get(box.kind, 2)))
    movie = mp4.parse_movie(origin, boxes)
    _first_video_track(origin, movie)  # without one there is nothing to tag
    if stereo_mode is not None:
        movie = mp4.map_boxes(movie, lambda box: _tagged(box, stereo_mode))
    # A table of offsets has the same size wherever it points, so the new movie's size is known before its content.
    wide = _is_wide(boxes, movie)
    new_size = len(mp4.serialize(mp4.shift_offsets(origin, movie, lambda offset: offset, wide=wide)))
    new_offset = _offset_map(origin, boxes, new_size)
    movie_bytes = mp4.serialize(mp4.shift_offsets(origin, movie, new_offset, wide=wide))
    with replaced_when_complete(destination) as temporary:
        _copy_boxes(origin, temporary, boxes, movie_bytes)


def read_spherical(path: Path | str) -> SphericalMetadata:
    """What the first video track of an MP4 or MOV file says about its projection; InputError: missing or malformed."""
    source = Path(path)
    track = _first_video_track(source, mp4.parse_movie(source, mp4.top_level_boxes(source)))
    width, height = struct.unpack_from(">HH", video_sample_entries(track)[0].head, SAMPLE_ENTRY_SIZE_AT)
    return SphericalMetadata(size=(height, width), **_version_1(track) | _version_2(source, track))


def video_sample_entries(track: mp4.Box) -> tuple[mp4.Box, ...]:
    """The opened sample entries of a track; none for a track that is not video."""
    box: mp4.Box | None = track
    for kind in (b"mdia", b"minf", b"stbl", b"stsd"):
        box = mp4.child(box, kind) if box else None
    return tuple(entry for entry in (box.children if box else None) or () if entry.children is not None)


def _first_video_track(path: Path, movie: mp4.Box) -> mp4.Box:
    track = next((box for box in movie.children or () if box.kind == b"trak" and video_sample_entries(box)), None)
    if track is None:
        raise InputError(f"{path}: expected a file with a video track, got none; check that this is the file you meant")
    return track


def _tagged(box: mp4.Box, stereo_mode: str) -> mp4.Box:
    """A video track with version 1, its sample entries with version 2; former tags are replaced."""
    if box.kind == b"trak" and video_sample_entries(box):
        others = (inner for inner in box.children or () if not _is_version_1(inner))
        stereo = "" if stereo_mode == "mono" else f"<GSpherical:StereoMode>{stereo_mode}</GSpherical:StereoMode>"
        text = SPHERICAL_XML.format(stereo=stereo)
        return replace(box, children=(*others, mp4.Box(b"uuid", SPHERICAL_UUID + text.encode())))
    if box.kind == b"stsd" and box.children is not None:
        return replace(box, children=tuple(_tagged_entry(entry, stereo_mode) for entry in box.children))
    return box


def _tagged_entry(entry: mp4.Box, stereo_mode: str) -> mp4.Box:
    others = (box for box in entry.children or () if box.kind not in (b"st3d", b"sv3d"))
    # full boxes begin with version and flags, four zeros
    header = mp4.Box(b"svhd", bytes(4) + SOFTWARE.encode() + b"\0")
    orientation = mp4.Box(b"prhd", bytes(4) + struct.pack(">iii", 0, 0, 0))  # yaw, pitch, roll, 16.16 fixed point
    whole_sphere = mp4.Box(b"equi", bytes(4) + struct.pack(">IIII", 0, 0, 0, 0))  # top, bottom, left, right: uncropped
    projection = mp4.Box(b"sv3d", b"", (header, mp4.Box(b"proj", b"", (orientation, whole_sphere))))
    mode = next(number for number, name in STEREO_MODES.items() if name == stereo_mode)
    return replace(entry, children=(*others, mp4.Box(b"st3d", bytes([0, 0, 0, 0, mode])), projection))


def _is_wide(boxes: tuple[mp4.FileBox, ...], movie: mp4.Box) -> bool:
    """Whether offsets may need 64 bits; a table at most doubles."""
    return sum(box.end - box.start for box in boxes) + 2 * len(mp4.serialize(movie)) >= 1 << 32


def _offset_map(path: Path, boxes: tuple[mp4.FileBox, ...], movie_size: int) -> Callable[[int], int]:
    """The place in the new file of a byte in the old one; ``boxes`` are in their new order."""
    shifts, position = [], 0
    for box in boxes:
        shifts.append((box.start, box.end, position - box.start))
        position += movie_size if box.kind == b"moov" else box.end - box.start
    shifts.sort()
    starts = [start for start, _, _ in shifts]

    def new_offset(offset: int) -> int:
        _, end, shift = shifts[max(bisect_right(starts, offset) - 1, 0)]
        if offset > end:
            raise mp4.broken_file_error(path, f"media data at byte {offset}, outside of it")
        return offset + shift

    return new_offset


def _copy_boxes(source: Path, target: Path, boxes: tuple[mp4.FileBox, ...], movie: bytes) -> None:
    with source.open("rb") as reader, target.open("xb") as writer:
        for box in boxes:
            if box.kind == b"moov":
                writer.write(movie)
                continue
            reader.seek(box.start)
            remaining = box.end - box.start
            while remaining:
                block = reader.read(min(remaining, COPY_BLOCK_BYTES))
                if not block:
                    raise WriteError(f"{source}: expected {remaining} more bytes, got none; leave the file alone")
                writer.write(block)
                remaining -= len(block)


def _is_version_1(box: mp4.Box) -> bool:
    return box.kind == b"uuid" and box.head[:16] == SPHERICAL_UUID


def _version_1(track: mp4.Box) -> dict[str, Any]:
    """What the XML says. Nothing in it is expanded, so nothing in it can be hostile."""
    box = next(filter(_is_version_1, track.children or ()), None)
    if box is None:
        return {}
    elements = re.findall(r"<GSpherical:(\w+)>([^<]*)</GSpherical:\1>", box.head[16:].decode("utf-8", "replace"))
    values = {name: text.strip() for name, text in reversed(elements)}  # the first of a name counts
    return {
        "has_version_1": values.get("Spherical") == "true",
        "projection": values.get("ProjectionType"),
        "stereo_mode": values.get("StereoMode") or "mono",
        "software": values.get("StitchingSoftware"),
    }


def _version_2(path: Path, track: mp4.Box) -> dict[str, Any]:
    """What the sample entry says."""
    entry = video_sample_entries(track)[0]
    stereo, spherical = mp4.child(entry, b"st3d"), mp4.child(entry, b"sv3d")
    if spherical is None:
        return {}
    inside = mp4.children_of(path, spherical.head)
    projection = mp4.children_of(path, (mp4.child(inside, b"proj") or mp4.Box(b"proj", b"")).head)
    mode = STEREO_MODES.get(stereo.head[4], "unknown") if stereo and len(stereo.head) > 4 else "mono"
    found: dict[str, Any] = {"has_version_2": True, "stereo_mode": mode}
    if kinds := [PROJECTIONS[box.kind] for box in projection.children or () if box.kind in PROJECTIONS]:
        found["projection"] = kinds[0]
    if header := mp4.child(inside, b"svhd"):
        found["software"] = header.head[4:].rstrip(b"\0").decode("utf-8", "replace")
    return found
