"""Places for the frames of a video: a video file tagged as a 360° panorama, or numbered images."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.io.encode import IMAGE_SUFFIXES
from omnisyn_cli.io.encoder_process import EncoderProcess, Packing
from omnisyn_cli.io.encoders import CODECS, PLANAR, EncoderSettings, check_settings, encoder_command, raw_format
from omnisyn_cli.io.paths import check_output, temporary_name
from omnisyn_cli.io.sequence import (
    ImageSequence,
    check_sequence,
    image_sequence,
    is_doubtful,
    is_sequence,
    open_sequence,
)
from omnisyn_cli.io.spherical import inject_spherical

__all__ = ["FrameSink", "check_encoding", "check_video", "open_video", "sample_type"]

IMAGE_CODECS = {"png": (".png",), "jpg": (".jpg", ".jpeg"), "exr": (".exr",), "tif": (".tif", ".tiff")}
"""What a folder of frames can be made of."""


class FrameSink(Protocol):
    """Where frames go."""

    frame_count: int

    def write(self, frame: Shaped[np.ndarray, "height width 3"]) -> None:
        """Take one more frame ``(height, width, 3)`` RGB."""


def sample_type(path: Path | str, codec: str | None = None) -> str:
    """The type of frames that a target makes the most of: ``uint8``, ``uint16`` (ProRes) or ``float32`` (EXR)."""
    target = Path(path)
    sequence = _sequence_of(target, codec)
    if sequence is not None:
        return "float32" if sequence.after.lower().endswith(".exr") else "uint8"
    return "uint16" if codec == "prores" else "uint8"


def check_video(
    path: Path | str,
    *,
    size: tuple[int, int],
    fps: float | Fraction,
    codec: str | None = None,
    crf: float | None = None,
    preset: str | None = None,
    dtype: str = "uint8",
    overwrite: bool = False,
) -> None:
    """Refuse everything that :func:`open_video` would refuse, before any work; same arguments.

    Raises:
        OutputPathError: the target exists and ``overwrite`` is off, no folder for it, or its ending does not go with
            the codec.
        InputError: odd size, or a frame rate, quality, preset or sample type out of range.
    """
    target = Path(path)
    check_encoding(target, size=size, fps=fps, codec=codec, crf=crf, preset=preset, dtype=dtype)
    sequence = _sequence_of(target, codec)
    if sequence is not None:
        check_sequence(sequence, overwrite)
    else:
        check_output(target, overwrite)


def check_encoding(
    path: Path,
    *,
    size: tuple[int, int],
    fps: float | Fraction,
    codec: str | None = None,
    crf: float | None = None,
    preset: str | None = None,
    dtype: str = "uint8",
) -> None:
    """Refuse what no encoder could do, whatever there is on the disk; arguments are those of :func:`open_video`.

    Raises:
        OutputPathError: the target's ending does not go with the codec.
        InputError: odd size, or a frame rate, quality, preset or sample type out of range.
    """
    if _sequence_of(path, codec) is None:
        check_settings(path, EncoderSettings(size, fps, _codec_of(path, codec), crf, preset, 0, dtype))
    elif crf is not None or preset is not None:
        raise OutputPathError(
            f"{path}: expected no quality or encoder preset for a folder of frames, got one; leave it out"
        )


@contextmanager
def open_video(
    path: Path | str,
    *,
    size: tuple[int, int],
    fps: float | Fraction,
    codec: str | None = None,
    crf: float | None = None,
    preset: str | None = None,
    threads: int = 0,
    dtype: str = "uint8",
    overwrite: bool = False,
) -> Iterator[FrameSink]:
    """A place for frames; the target appears under its name when it is complete, and not at all after a failure.

    Args:
        path: a video file (.mp4, .m4v, .mov), a folder, or a pattern such as ``frames/view_%05d.png``.
        size: ``(height, width)`` of the frames, both even for video.
        fps: frames per second.
        codec: ``h264`` (default), ``h265``, ``av1`` or ``prores``; for a folder ``png`` (default), ``jpg``, ``exr``
            or ``tif``.
        crf: constant quality, lower is better (defaults: H.264 18, H.265 20, AV1 28; ProRes has none). 0 makes H.264
            lossless, which few players play.
        preset: x264's and x265's names, AV1's 0 to 13, ProRes' ``proxy``, ``lt``, ``standard``, ``hq``.
        threads: for the encoder; 0 takes all.
        dtype: of the frames, ``uint8`` or ``uint16`` (10 bits; not for H.264). Image sequences take any.
        overwrite: replace an existing target.

    Raises:
        OutputPathError, InputError: see :func:`check_video`.
        EncodingError: ffmpeg refused or stopped, or no frame came.
        WriteError: the disk is full, or the folder went away.
    """
    target = Path(path)
    check_video(target, size=size, fps=fps, codec=codec, crf=crf, preset=preset, dtype=dtype, overwrite=overwrite)
    sequence = _sequence_of(target, codec)
    if sequence is not None:
        with open_sequence(sequence, size, overwrite=overwrite) as frames:
            yield frames
        return
    settings = EncoderSettings(size, fps, _codec_of(target, codec), crf, preset, threads, dtype)
    with _encoded(target, settings, overwrite=overwrite) as encoder:
        yield encoder


@contextmanager
def _encoded(target: Path, settings: EncoderSettings, *, overwrite: bool) -> Iterator[EncoderProcess]:
    """An encoder to a hidden file, which becomes ``target``, tagged as spherical, when everything has gone well."""
    encoded = temporary_name(target.parent, target.suffix)
    command, shape = encoder_command(encoded, settings), (*settings.size, 3)
    try:
        with EncoderProcess(command, target, shape, settings.dtype, _packing(settings)) as encoder:
            yield encoder
        check_output(target, overwrite)  # somebody else may have made one in the meantime
        inject_spherical(encoded, target)
    finally:
        encoded.unlink(missing_ok=True)


def _packing(settings: EncoderSettings) -> Packing | None:
    """What makes planes of frames, where the encoder takes them."""
    if raw_format(settings) != PLANAR:
        return None
    from omnisyn_cli.io.yuv import PlanarFrames  # a kernel, which a plan does without

    return PlanarFrames(settings.size)


def _sequence_of(path: Path, codec: str | None) -> ImageSequence | None:
    """Return the image sequence that a path means, or None for a video file.

    A name that may be a slip of the pen is that of a video, unless images are asked for.
    """
    if codec not in IMAGE_CODECS and is_doubtful(path):
        return None
    if not is_sequence(path):
        if path.suffix.lower() in IMAGE_SUFFIXES:
            raise OutputPathError(
                f"{path}: expected a video, a folder or a pattern, got one image; add a frame number such as %06d"
            )
        return None
    if codec is not None and codec not in IMAGE_CODECS:
        raise OutputPathError(
            f"{path}: expected one of {', '.join(IMAGE_CODECS)} for a folder of frames, got codec '{codec}'; "
            "name a video file such as video.mp4 instead"
        )
    sequence = image_sequence(path, IMAGE_CODECS[codec or "png"][0])
    if codec is not None and not sequence.after.lower().endswith(IMAGE_CODECS[codec]):
        endings = " or ".join(IMAGE_CODECS[codec])
        raise OutputPathError(f"{path}: expected a pattern ending in {endings} for {codec}; change the pattern")
    return sequence


def _codec_of(path: Path, codec: str | None) -> str:
    if codec in IMAGE_CODECS:
        raise OutputPathError(
            f"{path}: expected a video codec among {', '.join(CODECS)} for this name, got '{codec}'; "
            "name a folder for images"
        )
    return codec or "h264"
