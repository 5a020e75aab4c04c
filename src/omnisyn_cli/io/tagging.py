"""360° metadata for videos and pictures that are finished."""

from pathlib import Path

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.decode import check_is_file, read_header
from omnisyn_cli.io.jpeg_metadata import GPANO, with_properties
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.io.placement import Reading, area_tags, placement_of
from omnisyn_cli.io.spherical import inject_spherical, read_spherical

BOXED_SUFFIXES, JPEG_SUFFIXES = (".mp4", ".m4v", ".mov"), (".jpg", ".jpeg")  # of files that can be tagged
ASPECTS = {"mono": 2.0, "top-bottom": 1.0, "left-right": 4.0}  # width by height of a video, where each eye has 2:1
MAX_ASPECT_ERROR = 0.01  # share that encoders round sizes by


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
    is_whole = abs(size[1] / (ASPECTS[stereo_mode] * size[0]) - 1.0) <= MAX_ASPECT_ERROR
    if not (allow_aspect or is_whole):
        way = "choose another --stereo" if is_video else "say how much of the sphere it shows (--hfov)"
        raise InputError(
            f"{path}: expected {ASPECTS[stereo_mode]:g}:1 for {stereo_mode}, got {size[1]}x{size[0]}; {way}, or accept "
            "the distortion (--allow-aspect)"
        )


def write_tags(path: Path, target: Path, stereo_mode: str, reading: Reading) -> None:
    """Copy a file that :func:`check_taggable` accepts with its metadata; all else of it stays, to the byte.

    An existing target is replaced when all is written; it may be the file itself.
    """
    if path.suffix.lower() in BOXED_SUFFIXES:
        inject_spherical(path, target, stereo_mode)
        return
    tags = {"UsePanoramaViewer": "True", "ProjectionType": "equirectangular"}
    tags |= area_tags(placement_of(read_header(path), reading))
    write_parts(target, [with_properties(path, path.read_bytes(), GPANO, tags)])
