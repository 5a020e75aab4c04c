"""Files in and out: panoramas, masks, depth, poses, videos."""

from omnisyn_cli.io.decode import MAX_PIXELS, read_header
from omnisyn_cli.io.depth_files import read_depth, read_inverse_depth, write_depth
from omnisyn_cli.io.encode import write_image
from omnisyn_cli.io.images import Panorama, list_photographs, read_mask, read_panorama, read_photographs
from omnisyn_cli.io.outputs import check_output
from omnisyn_cli.io.spherical import inject_spherical, read_spherical
from omnisyn_cli.io.video import FrameSink, check_encoding, check_video, open_video, sample_type

__all__ = [
    "MAX_PIXELS", "FrameSink", "Panorama", "check_encoding", "check_output", "check_video", "inject_spherical",
    "list_photographs", "open_video", "read_depth", "read_header", "read_inverse_depth", "read_mask", "read_panorama",
    "read_photographs", "read_spherical", "sample_type", "write_depth", "write_image",
]  # fmt: skip
