"""What the program sees in a file: panorama, depth, pose file or video, as plain values that JSON can hold."""

import math
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.io.decode import MAX_PIXELS, ImageHeader, check_is_file, read_header
from omnisyn_cli.io.depth_files import is_depth_header, read_depth
from omnisyn_cli.io.ffmpeg_process import run_ffmpeg
from omnisyn_cli.io.images import read_panorama
from omnisyn_cli.io.placement import DEFAULT_READING, Reading
from omnisyn_cli.io.spherical import read_spherical
from omnisyn_cli.io.tagging import BOXED_SUFFIXES
from omnisyn_cli.poses.file import read_poses

VIDEO_SUFFIXES = (*BOXED_SUFFIXES, ".mkv", ".webm", ".avi")  # of files that FFmpeg describes
PROBE_SECONDS = 60  # after which FFmpeg is given up. Set by hand.
# What FFmpeg prints of a video stream.
VIDEO_STREAM = re.compile(
    r"Stream #\S+ Video: (?P<codec>\w+).*?, (?P<pixel_format>[a-z]\w+)(?:\((?P<colour>[^)]*)\))?"
    r".*?, (?P<width>\d+)x(?P<height>\d+)(?:.*?, (?P<fps>[\d.]+k?) fps)?"
)
# What FFmpeg prints of the length: hours, minutes, seconds.
DURATION = re.compile(r"Duration: (\d+):(\d+):(\d+(?:\.\d+)?)")


def describe_file(
    path: Path | str, *, max_pixels: int = MAX_PIXELS, allow_outside: bool = False, reading: Reading = DEFAULT_READING
) -> dict[str, Any]:
    """The ``kind`` of a file (``panorama``, ``depth``, ``poses`` or ``video``), by its ending and channels, and more.

    Images, which are read as ``reading`` says, of more than ``max_pixels`` are not decoded. With ``allow_outside``
    depth and masks may lie outside of a pose file's folder. InputError: missing, damaged, or a video without a video
    stream; PoseError: a pose file that cannot be used.
    """
    source = Path(path)
    suffix = source.suffix.lower()
    if suffix == ".json":
        return _describe_poses(source, allow_outside)
    if suffix in VIDEO_SUFFIXES:
        return _describe_video(source)
    header = read_header(source)
    if is_depth_header(header):
        return _describe_depth(source, max_pixels)
    return _describe_panorama(header, max_pixels, reading)


def _describe_panorama(header: ImageHeader, max_pixels: int, reading: Reading) -> dict[str, Any]:
    gpano = {
        name.removeprefix("GPano:"): value if isinstance(value, int | float) else str(value)
        for name, value in header.attributes.items()
        if name.startswith("GPano:")
    }
    description: dict[str, Any] = {
        "kind": "panorama", "format": header.format, "width": header.width, "height": header.height,
        "samples": header.dtype, "channels": list(header.channels), "has_alpha": header.alpha_channel >= 0,
        "orientation": header.orientation, "has_more_pictures": header.has_more_pictures, "gpano": gpano,
        "gps": geographic_place(header),
    }  # fmt: skip
    try:
        panorama = read_panorama(header.path, max_pixels=max_pixels, reading=reading)
    except ImageError as error:
        return {**description, "usable": False, "problem": str(error)}
    seen = 1.0 if panorama.mask is None else float(panorama.mask.mean())
    height, width = panorama.image.shape[:2]
    if seen == 0.0:
        return {**description, "usable": False, "problem": "no pixel may be used: all of it is transparent or left out"}
    # OpenCV takes a while to import and is needed for panoramas only.
    from omnisyn_cli.poses.gravity import REMEDIES, gravity_of_picture

    gravity = gravity_of_picture(panorama.image, panorama.mask)
    return {
        **description, "usable": True, "sphere_width": width, "sphere_height": height, "usable_share": seen,
        "tilt_degrees": math.degrees(gravity.tilt) if gravity.vertical.is_certain else None,
        "looks": "; ".join(filter(None, [gravity.attitude, REMEDIES.get(gravity.attitude)])),
    }  # fmt: skip


def geographic_place(header: ImageHeader) -> dict[str, float] | None:
    """Latitude and longitude in degrees, altitude in metres where it is known; None without all EXIF GPS tags."""
    latitude = header.degrees("GPS:Latitude", "S")
    longitude = header.degrees("GPS:Longitude", "W")
    has_halves = all(header.attributes.get(f"GPS:{name}Ref") for name in ("Latitude", "Longitude"))
    if latitude is None or longitude is None or not has_halves:
        return None
    place = {"latitude": latitude, "longitude": longitude}
    return place if header.altitude is None else {**place, "altitude": header.altitude}


def _describe_depth(path: Path, max_pixels: int) -> dict[str, Any]:
    depth = read_depth(path, max_pixels=max_pixels)
    finite = depth[np.isfinite(depth)]
    height, width = depth.shape
    metres: dict[str, Callable[..., Any]] = {"nearest": np.min, "median": np.median, "farthest": np.max}
    return {
        "kind": "depth", "width": width, "height": height,
        **{f"{which}_metres": float(of(finite)) if finite.size else None for which, of in metres.items()},
        "infinite_share": 1.0 - finite.size / depth.size,
    }  # fmt: skip


def _describe_poses(path: Path, allow_outside: bool) -> dict[str, Any]:
    file = read_poses(path, allow_outside=allow_outside)
    positions = np.array([panorama.pose.position for panorama in file.panoramas.values()])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    names = list(file.panoramas)
    return {
        "kind": "poses",
        "panoramas": [
            {
                "name": name,
                "position": panorama.pose.position.tolist(),
                "image_exists": (path.parent / name).is_file(),
                "depth_exists": None if panorama.depth is None else panorama.depth.is_file(),
                "mask_exists": None if panorama.mask is None else panorama.mask.is_file(),
            }
            for name, panorama in file.panoramas.items()
        ],
        "steps_metres": steps.tolist(),
        "equal_positions": [f"{names[i]} and {names[i + 1]}" for i in np.flatnonzero(steps == 0).tolist()],
    }


def _describe_video(path: Path) -> dict[str, Any]:
    check_is_file(path)
    try:
        _, report, _ = run_ffmpeg(path, seconds=PROBE_SECONDS)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{path}: expected ffmpeg to describe it, got no answer; encode the file anew") from error
    stream = VIDEO_STREAM.search(report)
    if stream is None:
        words = report.removesuffix("At least one output file must be specified").splitlines()[-1:] or ["nothing"]
        raise InputError(f"{path}: expected a video, got '{words[0]}' from ffmpeg; check that the file is complete")
    spherical = None
    if path.suffix.lower() in BOXED_SUFFIXES:
        metadata = read_spherical(path)
        spherical = {
            "version_1": metadata.has_version_1, "version_2": metadata.has_version_2, "projection": metadata.projection,
            "stereo_mode": metadata.stereo_mode, "software": metadata.software,
        }  # fmt: skip
    fps, duration = stream["fps"], DURATION.search(report)
    hours, minutes, seconds = map(float, duration.groups()) if duration else (0.0, 0.0, 0.0)
    return {
        "kind": "video", "codec": stream["codec"], "pixel_format": stream["pixel_format"],
        "width": int(stream["width"]), "height": int(stream["height"]),
        "fps": float(fps.replace("k", "e3")) if fps else None,
        "duration_seconds": hours * 3600 + minutes * 60 + seconds if duration else None,
        "colour": [part.strip() for part in (stream["colour"] or "").split(",") if part.strip()],
        "spherical": spherical,
    }  # fmt: skip
