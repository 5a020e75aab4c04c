"""The frames of a video file, to encode them again."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from omnisyn_cli.errors import EncodingError
from omnisyn_cli.io.encoders import ffmpeg_program

__all__ = ["read_frames"]


def read_frames(path: Path, size: tuple[int, int], count: int) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """The first frames of a BT.709 video as RGB.

    Args:
        path: of the video.
        size: height and width of its frames.
        count: how many of them; fewer if it is shorter.

    Raises:
        EncodingError: ffmpeg cannot read it.
    """
    scale = "scale=in_color_matrix=bt709:in_range=tv:flags=accurate_rnd+full_chroma_int"
    command = [ffmpeg_program(), "-v", "error", "-i", f"file:{path.absolute()}", "-frames:v", str(count)]
    done = subprocess.run(  # noqa: S603 - a list, no shell; the file name is prefixed
        [*command, "-vf", scale, "-pix_fmt", "rgb24", "-f", "rawvideo", "-"], capture_output=True, check=False
    )
    if done.returncode != 0:
        words = " | ".join(done.stderr.decode("utf-8", "replace").split("\n")[:3])
        raise EncodingError(f"{path}: expected a video that ffmpeg can read, got '{words}'; make it again")
    yield from np.frombuffer(done.stdout, np.uint8).reshape(-1, *size, 3)
