"""360° metadata for videos and pictures that are finished, and what players make of what is there."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.io.decode import ImageHeader, check_is_file, read_header
from omnisyn_cli.io.jpeg_metadata import GPANO, with_properties
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.io.placement import Reading, area_tags, placement_of
from omnisyn_cli.io.spherical import SphericalMetadata, inject_spherical, read_spherical

BOXED_SUFFIXES, JPEG_SUFFIXES = (".mp4", ".m4v", ".mov"), (".jpg", ".jpeg")  # of files that can be tagged
ASPECTS = {"mono": 2.0, "top-bottom": 1.0, "left-right": 4.0}  # width by height of a video, where each eye has 2:1
MAX_ASPECT_ERROR = 0.01  # share that encoders round sizes by
PROJECTION_TAG = "GPano:ProjectionType"


def check_taggable(path: Path, stereo_mode: str, reading: Reading, *, allow_aspect: bool = False) -> None:
    """Refuse a file that cannot be tagged, or would be shown distorted.

    InputError: no MP4, MOV or JPEG, damaged, stereo where it cannot be said, or not 2:1 for an eye.
    """
    check_is_file(path)
    suffix = path.suffix.lower()
    if suffix in BOXED_SUFFIXES:
        if reading.is_partial:
            raise InputError(f"{path}: expected a picture for --hfov or --vfov, got a video; leave them out")
        found = read_spherical(path)
        height, width = found.size
    elif suffix in JPEG_SUFFIXES:
        if stereo_mode != "mono":
            raise InputError(f"{path}: expected a video for --stereo {stereo_mode}, got a picture; leave it out")
        placement = placement_of(read_header(path), reading)
        height, width = placement.full_height, placement.full_width
    else:
        raise InputError(
            f"{path}: expected MP4, MOV or JPEG, got '{suffix}'; put a video into another container (ffmpeg -c copy), "
            "or convert a picture"
        )
    if not (allow_aspect or is_whole(height, width, stereo_mode)):
        way = "say how much of the sphere it shows (--hfov)" if suffix in JPEG_SUFFIXES else "choose another --stereo"
        raise InputError(
            f"{path}: expected {ASPECTS[stereo_mode]:g}:1 for {stereo_mode}, got {width}x{height}; {way}, or "
            "accept the distortion (--allow-aspect)"
        )


def is_whole(height: int, width: int, stereo_mode: str) -> bool:
    """Whether every eye has 2:1."""
    return abs(width / (ASPECTS[stereo_mode] * height) - 1.0) <= MAX_ASPECT_ERROR


def write_tags(path: Path, target: Path, stereo_mode: str, reading: Reading) -> None:
    """Copy a file that :func:`check_taggable` accepts with its metadata; all else of it stays, to the byte.

    An existing target is replaced when all is written; it may be the file itself.
    """
    if path.suffix.lower() in BOXED_SUFFIXES:
        inject_spherical(path, target, stereo_mode)
        return
    tags = {"UsePanoramaViewer": "True", "ProjectionType": "equirectangular"}
    area = area_tags(placement_of(read_header(path), reading))
    write_parts(target, [with_properties(path, path.read_bytes(), GPANO, {**tags, **area})])


def described_tags(path: Path) -> dict[str, Any]:
    """What a file says of its projection, and in words what players make of it. InputError: no video or picture."""
    check_is_file(path)
    if path.suffix.lower() in BOXED_SUFFIXES:
        found = read_spherical(path)
        (height, width), versions = found.size, (found.has_version_1, found.has_version_2)
        tags = [f"version {number}" for number, is_there in enumerate(versions, start=1) if is_there]
        return {
            "kind": "video", "width": width, "height": height, "tags": tags, "projection": found.projection,
            "stereo_mode": found.stereo_mode, "software": found.software, "players": [*_of_video(found)],
        }  # fmt: skip
    header = read_header(path)
    projection = header.attributes.get(PROJECTION_TAG)
    return {
        "kind": "picture", "width": header.width, "height": header.height,
        "tags": [] if projection is None else ["GPano"], "projection": projection, "players": [*_of_picture(header)],
    }  # fmt: skip


def _of_video(found: SphericalMetadata) -> Iterator[str]:
    (height, width), mode = found.size, found.stereo_mode or "mono"
    if not (found.has_version_1 or found.has_version_2):
        yield "YouTube, VLC and headsets: flat, as nothing says that it is a 360° video"
        fitting = [each for each in ASPECTS if is_whole(height, width, each)]
        how = {"mono": "omnisyn tag", "top-bottom": "omnisyn tag --stereo top-bottom, if both eyes are in it"}
        how["left-right"] = how["top-bottom"].replace("top-bottom", "left-right")
        yield f"to do: {how[fitting[0]] if fitting else 'nothing, as it is not 2:1 and so hardly a 360° video'}"
    elif found.projection != "equirectangular" or mode not in ASPECTS:
        yield f"YouTube, VLC and headsets: 360° if they know {found.projection or 'no projection'}, {mode}"
    elif is_whole(height, width, mode):
        yield f"YouTube, VLC and headsets: 360°, {mode}"
    else:
        yield f"YouTube, VLC and headsets: 360°, but distorted, as {mode} is {ASPECTS[mode]:g}:1"
    for number, is_there in ((1, found.has_version_1), (2, found.has_version_2)):
        if not is_there and (found.has_version_1 or found.has_version_2):
            yield f"players that read version {number} alone: flat; omnisyn tag writes both"


def _of_picture(header: ImageHeader) -> Iterator[str]:
    try:
        placement = placement_of(header)
    except ImageError as error:
        yield f"viewers that read GPano: not as a sphere; {error}"
        return
    whole = is_whole(placement.full_height, placement.full_width, "mono")
    shape = "360°" if whole else "distorted, as the whole is not 2:1"
    if PROJECTION_TAG in header.attributes:
        part = (placement.height, placement.width) != (placement.full_height, placement.full_width)
        yield f"Google Photos, Facebook and viewers that read GPano: {shape}{', a part of the sphere' if part else ''}"
        return
    yield f"Google Photos, Facebook: flat, as nothing says that it is a panorama; viewers for panoramas: {shape}"
    if header.path.suffix.lower() in JPEG_SUFFIXES:
        yield f"to do: omnisyn tag{'' if whole else ' --hfov DEGREES, if it is a part of the sphere'}"
