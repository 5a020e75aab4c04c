"""Frames of a 360° video as panoramas: one every so many seconds, as files that are gone afterwards."""

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.decode import check_is_file
from omnisyn_cli.io.encoders import ffmpeg_program

VIDEO_SUFFIXES = frozenset({".360", ".avi", ".insv", ".m4v", ".mkv", ".mov", ".mp4", ".webm"})
"""Files that frames are taken from."""


@contextmanager
def frames_of_video(path: Path, seconds: float) -> Iterator[tuple[Path, ...]]:
    """Frames at 0, ``seconds``, 2 · ``seconds`` …, as PNG files in the order of time.

    Colours are taken for BT.709, as cameras for 360° write them. InputError: no video, or fewer than two frames.
    """
    check_is_file(path)
    with tempfile.TemporaryDirectory(prefix="omnisyn-frames-") as folder:
        choice = f"select='isnan(prev_selected_t)+gte(t-prev_selected_t,{seconds:.6f}-0.5/30)'"
        command = [
            ffmpeg_program(), "-hide_banner", "-loglevel", "error", "-nostdin", "-protocol_whitelist", "file",
            "-i", f"file:{path.absolute()}", "-map", "0:v:0", "-fps_mode", "passthrough",
            "-vf", f"{choice},scale=in_color_matrix=bt709:flags=bicubic+accurate_rnd+full_chroma_int,format=rgb24",
            "-compression_level", "1", str(Path(folder) / "frame%05d.png"),
        ]  # fmt: skip
        finished = subprocess.run(command, capture_output=True, check=False)  # noqa: S603 - a list, no shell
        frames = tuple(sorted(Path(folder).glob("*.png")))
        if finished.returncode != 0 or not frames:
            lines = finished.stderr.decode("utf-8", "replace").strip().splitlines() or ["no frames"]
            raise InputError(f"{path}: expected a video, got '{lines[-1]:.200}'; export it as MP4")
        if len(frames) < 2:
            raise InputError(f"{path}: expected a video of more than {seconds:g} s, got one frame; take them closer")
        yield frames
