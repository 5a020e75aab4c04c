"""Depth files: Euclidean distance from the optical centre in metres, infinity where there is nothing."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import ImageError, OutputPathError
from omnisyn_cli.io.decode import MAX_PIXELS, ImageHeader, check_pixel_count, decode_image
from omnisyn_cli.io.encode import write_channels
from omnisyn_cli.io.images import channel_of, upright
from omnisyn_cli.io.outputs import check_output, replaced_when_complete
from omnisyn_cli.io.placement import placement_of

DEPTH_CHANNEL = "Z"  # the name that OpenEXR has for depth
MIN_DEPTH = 1e-6  # metres; smaller depths become this, so that inverse depths stay finite
MAX_DEPTH = 1e9  # metres; renderers write such numbers (Blender: 1e10) where their rays hit nothing
METRES_PER_PNG_UNIT = np.float32(1e-3)  # 16-bit PNGs hold millimetres


def read_depth(path: Path | str, *, max_pixels: int = MAX_PIXELS) -> Float[np.ndarray, "height width"]:
    """Depth ``(height, width)`` in metres, float32, width = 2·height, ``inf`` where there is nothing.

    EXR: channel ``Z``, or the only channel, in metres; infinity, zero and anything from 1e9 on mean "nothing there".
    PNG of 16 bits, one channel: millimetres; zero means unknown or nothing. What is cropped (OpenEXR data window, GPano
    tags) is put in its place as panoramas are, with nothing around it.
    ImageError: missing, damaged, too large, not 2:1, of another kind, or with negative or undefined (NaN) depths.
    """
    header, samples = decode_image(path, max_pixels=max_pixels)
    depth = upright(samples, header.orientation)[..., _depth_channel(header)].astype(np.float32)
    if header.dtype == "uint16":
        depth *= METRES_PER_PNG_UNIT
    check_pixel_count(header.path, *depth_size(header), max_pixels)
    depth = placement_of(header).put(depth)
    undefined, negative = np.count_nonzero(np.isnan(depth)), np.count_nonzero(depth < 0)
    if undefined or negative:
        raise ImageError(
            f"{path}: expected depths in metres or infinity, got {undefined} NaN and {negative} negative of "
            f"{depth.size} pixels; write infinity where nothing is there"
        )
    return np.where((depth > 0) & (depth < MAX_DEPTH), depth, np.float32(np.inf))


def read_inverse_depth(path: Path | str, *, max_pixels: int = MAX_PIXELS) -> Float[np.ndarray, "height width"]:
    """As :func:`read_depth`, in 1/metre: zero where there is nothing."""
    depth = np.maximum(read_depth(path, max_pixels=max_pixels), np.float32(MIN_DEPTH))
    inverse: np.ndarray = np.float32(1) / depth
    return inverse


def write_depth(path: Path | str, depth: Float[np.ndarray, "height width"]) -> None:
    """Write depth in metres as EXR with one float channel ``Z``; infinity is kept, an existing file is replaced.

    OutputPathError: the name does not end in .exr, or there is no folder to write into. WriteError: the disk is full,
    or the folder went away. ValueError: the array is not two-dimensional, or holds NaN or negative numbers.
    """
    target = Path(path)
    if target.suffix.lower() != ".exr":
        raise OutputPathError(f"{target}: expected a name ending in .exr, got '{target.suffix}'; change the name")
    check_output(target, overwrite=True)
    if depth.ndim != 2 or depth.size == 0:
        raise ValueError(f"expected depth of shape (height, width), got {depth.shape}")
    if not (depth >= 0).all():
        raise ValueError("expected depths that are positive or infinite, got NaN or negative ones")
    with replaced_when_complete(target) as temporary:
        write_channels(temporary, depth.astype(np.float32), (DEPTH_CHANNEL,), target)


def depth_size(header: ImageHeader) -> tuple[int, int]:
    """Height and width of the sphere that :func:`read_depth` makes of a file.

    ImageError: it would refuse the file for what its header says: of another kind, not 2:1, or no sphere.
    """
    _depth_channel(header)
    height, width = placement_of(header).full_size
    if width != 2 * height:
        raise ImageError(f"{header.path}: expected depth twice as wide as high, got {width}×{height}; render it to 2:1")
    return height, width


def is_depth_header(header: ImageHeader) -> bool:
    """Whether a file is meant as depth: EXR with a ``Z`` or only one channel and no colours, or a 16-bit grey PNG."""
    if header.format == "openexr":
        has_colours = all(channel_of(header, name) is not None for name in "RGB")
        return not has_colours and (len(header.channels) == 1 or channel_of(header, DEPTH_CHANNEL) is not None)
    return _is_millimetres(header)


def _is_millimetres(header: ImageHeader) -> bool:
    return header.format == "png" and header.dtype == "uint16" and len(header.channels) == 1


def _depth_channel(header: ImageHeader) -> int:
    if header.format == "openexr" and header.dtype in ("half", "float", "double"):
        channel = channel_of(header, DEPTH_CHANNEL)
        if channel is not None:
            return channel
        if len(header.channels) == 1:
            return 0
    elif _is_millimetres(header):
        return 0
    raise ImageError(
        f"{header.path}: expected depth as EXR with a float channel Z or as 16-bit grey PNG in millimetres, got "
        f"{header.format} with {header.dtype} channels {', '.join(header.channels)}; convert the file"
    )
