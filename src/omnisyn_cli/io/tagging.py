"""360° metadata for videos and pictures that are finished, and what players make of what is there."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.decode import ImageHeader, check_is_file, read_header
from omnisyn_cli.io.jpeg_metadata import with_gpano
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.io.placement import Reading, area_tags, placement_of
from omnisyn_cli.io.spherical import SphericalMetadata, inject_spherical, read_spherical

BOXED_SUFFIXES, JPEG_SUFFIXES = (".mp4", ".m4v", ".mov"), (".jpg", ".jpeg")  # of files that can be tagged
ASPECTS = {"mono": 2.0, "top-bottom": 1.0, "left-right": 4.0}  # width by height of a video, where each eye has 2:1
MAX_ASPECT_ERROR = 0.01  # share that encoders round sizes by
PROJECTION_TAG = "GPano:ProjectionType"


def check_taggable(path: Path, stereo_mode: str, reading: Reading, *, allow_aspect: bool = False) -> None:
    """Refuse (InputError) no MP4, MOV or JPEG, damaged files, stereo pictures, and what is not 2:1 for an eye."""
    check_is_file(path)
    is_video, is_picture = (path.suffix.lower() in suffixes for suffixes in (BOXED_SUFFIXES, JPEG_SUFFIXES))
    if not is_picture and (reading.is_partial or not is_video):
        raise InputError(
            f"{path}: expected MP4, MOV or JPEG, and JPEG for --hfov and --vfov, got '{path.suffix}'; convert it (a "
            "video with ffmpeg -c copy)"
        )
    if is_picture and stereo_mode != "mono":
        raise InputError(f"{path}: expected a video for --stereo {stereo_mode}, got a picture; leave it out")
    size = read_spherical(path).size if is_video else placement_of(read_header(path), reading).full_size
    if not (allow_aspect or is_whole(size, stereo_mode)):
        way = "choose another --stereo" if is_video else "say how much of the sphere it shows (--hfov)"
        raise InputError(
            f"{path}: expected {ASPECTS[stereo_mode]:g}:1 for {stereo_mode}, got {size[1]}x{size[0]}; {way}, or accept "
            "the distortion (--allow-aspect)"
        )


def is_whole(size: tuple[int, int], stereo_mode: str) -> bool:
    """Whether every eye of a picture of a height and width has 2:1."""
    return abs(size[1] / (ASPECTS[stereo_mode] * size[0]) - 1.0) <= MAX_ASPECT_ERROR


def write_tags(path: Path, target: Path, stereo_mode: str, reading: Reading) -> None:
    """Copy a file that :func:`check_taggable` accepts with its metadata; all else of it stays, to the byte.

    An existing target is replaced when all is written; it may be the file itself.
    """
    if path.suffix.lower() in BOXED_SUFFIXES:
        inject_spherical(path, target, stereo_mode)
        return
    tags = {"UsePanoramaViewer": "True", "ProjectionType": "equirectangular"}
    tags |= area_tags(placement_of(read_header(path), reading))
    write_parts(target, [with_gpano(path, path.read_bytes(), tags)])


def described_tags(path: Path) -> dict[str, Any]:
    """What a file says of its projection, and in words what players make of it. InputError: no video or picture."""
    check_is_file(path)
    if path.suffix.lower() in BOXED_SUFFIXES:
        found = read_spherical(path)
        tags, size, players = found.versions, found.size, _of_video(found)
        said = {"projection": found.projection, "stereo_mode": found.stereo_mode, "software": found.software}
    else:
        header = read_header(path)
        said = {"projection": header.attributes.get(PROJECTION_TAG)}
        tags, size = ["GPano"] * (PROJECTION_TAG in header.attributes), (header.height, header.width)
        players = _of_picture(header)
    return {"kind": "tags", "width": size[1], "height": size[0], "tags": tags, **said, "players": [*players]}


def _of_video(found: SphericalMetadata) -> Iterator[str]:
    mode = found.stereo_mode or "mono"
    fitting = next((each for each in ASPECTS if is_whole(found.size, each)), None)
    if not found.versions:
        how = "" if fitting == "mono" else f" --stereo {fitting}, if both eyes are in it"
        yield "YouTube, VLC and headsets: flat, as nothing says that it is a 360° video"
        yield f"to do: omnisyn tag{how}" if fitting else "to do: nothing, as it is not 2:1 and so hardly a 360° video"
        return
    fits = "" if mode == fitting else f", but distorted, as {mode} is {ASPECTS.get(mode, 2.0):g}:1"
    is_common = found.projection == "equirectangular"
    yield f"YouTube, VLC and headsets: 360°, {mode}{fits}{'' if is_common else f', if they know {found.projection}'}"
    if len(found.versions) == 1:
        yield f"players that read another version than {found.versions[0]}: flat; omnisyn tag writes both"


def _of_picture(header: ImageHeader) -> Iterator[str]:
    placement = placement_of(header)
    shape = "360°" if is_whole(placement.full_size, "mono") else "distorted, as the whole is not 2:1"
    if PROJECTION_TAG in header.attributes:
        yield f"Google Photos, Facebook, viewers for panoramas: {shape}{'' if placement.is_whole else ', a part of it'}"
        return
    yield f"Google Photos, Facebook: flat, as nothing says that it is a panorama; viewers for panoramas: {shape}"
    if header.path.suffix.lower() in JPEG_SUFFIXES:
        yield f"to do: omnisyn tag{'' if shape == '360°' else ' --hfov DEGREES, if it is a part of the sphere'}"
