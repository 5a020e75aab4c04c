"""Places for the frames of a video: a video file tagged as a 360° panorama, or numbered images.

They may be filled from a thread of its own, so that rendering goes on while frames are encoded.
"""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol, Required, TypedDict, Unpack

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.io import encode, encoders
from omnisyn_cli.io.encoders import CODECS, EncoderSettings, Soundtrack
from omnisyn_cli.io.ffmpeg_process import EncoderProcess, Packing
from omnisyn_cli.io.outputs import check_output, temporary_name
from omnisyn_cli.io.spherical import inject_spherical

# What a folder of frames can be made of.
IMAGE_CODECS = {"png": (".png",), "jpg": (".jpg", ".jpeg"), "exr": (".exr",), "tif": (".tif", ".tiff")}


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


class Encoding(TypedDict, total=False):
    """How frames become a video or images; keywords of :func:`open_video` and of what checks for it."""

    size: Required[tuple[int, int]]  # ``(height, width)`` of the frames, both even for video
    fps: Required[float | Fraction]  # frames per second
    codec: str | None  # ``h264`` (default), ``h265``, ``av1``, ``prores``; of images ``png`` (default) ``jpg exr tif``
    # constant quality, lower is better (defaults: H.264 17, H.265 20, AV1 28; ProRes has none). 0 makes H.264 lossless,
    # which few players play.
    crf: float | None
    preset: str | None  # x264's and x265's names, AV1's 0 to 13, ProRes' ``proxy``, ``lt``, ``standard``, ``hq``
    threads: int  # for the encoder; 0 (default) takes all
    dtype: str  # of the frames, ``uint8`` (default) or ``uint16`` (10 bits; not for H.264). Image sequences take any.
    stereo_mode: str | None  # what players are told of a video: ``mono`` (default), ``top-bottom``; None: it is flat
    soundtrack: Soundtrack | None  # of a video; images have none


def check_video(
    path: Path | str, *, overwrite: bool = False, **encoding: Unpack[Encoding]
) -> encode.ImageSequence | EncoderSettings:
    """Refuse everything that :func:`open_video` would refuse, before any work; same arguments.

    The images that the path means come back, or how its video is encoded. OutputPathError: the target exists and
    ``overwrite`` is off, no folder for it, or its ending does not go with the codec. InputError: odd size, or a frame
    rate, quality, preset or sample type out of range.
    """
    target = Path(path)
    resolved = check_encoding(target, **encoding)
    if isinstance(resolved, EncoderSettings):
        check_output(target, overwrite)
    else:
        encode.check_sequence(resolved, overwrite)
    return resolved


@contextmanager
def open_video(path: Path | str, *, overwrite: bool = False, **encoding: Unpack[Encoding]) -> Iterator[FrameSink]:
    """A place for frames; the target appears under its name when it is complete, and not at all after a failure.

    It is a video file (.mp4, .m4v, .mov), a folder, or a pattern such as ``frames/view_%05d.png``; an existing one is
    replaced with ``overwrite``.

    OutputPathError, InputError: see :func:`check_video`. EncodingError: ffmpeg refused or stopped, or no frame came.
    WriteError: the disk is full, or the folder went away.
    """
    target = Path(path)
    resolved = check_video(target, overwrite=overwrite, **encoding)
    if isinstance(resolved, EncoderSettings):
        place: AbstractContextManager[FrameSink] = _encoded(target, resolved, overwrite=overwrite)
    else:
        place = encode.open_sequence(resolved, encoding["size"], overwrite=overwrite)
    with place as sink:
        yield sink


def check_encoding(path: Path, *, codec: str | None = None, **encoding: Any) -> encode.ImageSequence | EncoderSettings:
    """As :func:`check_video`, whatever there is on the disk."""
    sequence = _sequence_of(path, codec)
    if sequence is None:
        if codec in IMAGE_CODECS:
            raise OutputPathError(
                f"{path}: expected a video codec among {', '.join(CODECS)} for this name, got '{codec}'; "
                "name a folder for images"
            )
        settings = EncoderSettings(codec=codec or "h264", **encoding)
        encoders.check_settings(path, settings)
        return settings
    if encoding.get("crf") is not None or encoding.get("preset") is not None:
        raise OutputPathError(f"{path}: expected no quality or preset for a folder of frames, got one; leave it out")
    return sequence


@contextmanager
def _encoded(target: Path, settings: EncoderSettings, *, overwrite: bool) -> Iterator[EncoderProcess]:
    """An encoder to a hidden file, which becomes ``target``, tagged as spherical, when everything has gone well."""
    encoded = temporary_name(target.parent, target.suffix)
    command, shape = encoders.encoder_command(encoded, settings), (*settings.size, 3)
    packed: Packing | None = None
    if encoders.raw_format(settings) == encoders.PLANAR_FORMAT:
        from omnisyn_cli.io.yuv import PlanarFrames  # a kernel, which a plan does without

        packed = PlanarFrames(settings.size)
    try:
        with EncoderProcess(command, target, shape, settings.dtype, packed) as encoder:
            yield encoder
        check_output(target, overwrite)  # somebody else may have made one in the meantime
        inject_spherical(encoded, target, settings.stereo_mode)
    finally:
        encoded.unlink(missing_ok=True)


def _sequence_of(path: Path, codec: str | None) -> encode.ImageSequence | None:
    """The images that a path means, or None for a video: a doubtful name means one unless images are asked for."""
    if codec not in IMAGE_CODECS and encode.is_ambiguous(path):
        return None
    if not encode.is_sequence(path):
        if path.suffix.lower() in encode.IMAGE_SUFFIXES:
            raise OutputPathError(
                f"{path}: expected a video, a folder or a pattern, got one image; add a frame number such as %06d"
            )
        return None
    if codec is not None and codec not in IMAGE_CODECS:
        raise OutputPathError(
            f"{path}: expected one of {', '.join(IMAGE_CODECS)} for a folder of frames, got codec '{codec}'; "
            "name a video file such as video.mp4 instead"
        )
    sequence = encode.image_sequence(path, IMAGE_CODECS[codec or "png"][0])
    if codec is not None and not sequence.after.lower().endswith(IMAGE_CODECS[codec]):
        endings = " or ".join(IMAGE_CODECS[codec])
        raise OutputPathError(f"{path}: expected a pattern ending in {endings} for {codec}; change the pattern")
    return sequence


FRAMES_IN_QUEUE = 2  # more would only cost memory: the slower side, rendering or encoding, decides the pace
# Pixels (8192×4096) from which on one frame in the queue is enough: each takes long, and much memory.
LARGE_FRAME_PIXELS = 2**25


def frames_in_queue(size: tuple[int, int]) -> int:
    """How many frames of a size wait for a sink at most."""
    return FRAMES_IN_QUEUE if size[0] * size[1] < LARGE_FRAME_PIXELS else 1


class FrameRing:
    """Memory for frames on their way to sinks, used again when they have arrived.

    There is room for a frame of ``size`` (height, width) that is written, some that are made, and ``waiting`` between.
    """

    def __init__(self, size: tuple[int, int], waiting: int, made: int = 1) -> None:
        self._frames = deque(np.empty((*size, 3), np.uint8) for _ in range(waiting + 1 + made))

    def __call__(self) -> UInt8[np.ndarray, "height width 3"]:
        """Memory for the next frame; it is given to all sinks before the one after it is asked for."""
        self._frames.rotate()
        return self._frames[0]


class BackgroundSink:
    """Hands frames to another sink from a thread; frames must not be changed before they have arrived.

    An error of the other sink is raised by the next call of :meth:`write` or by :meth:`finish`; frames that still wait
    when the context ends with an error are dropped.

    At most ``waiting`` frames wait for it while one is being written.
    """

    def __init__(self, sink: FrameSink, waiting: int = FRAMES_IN_QUEUE) -> None:
        self._sink, self._waiting = sink, waiting
        self._pending: deque[Future[None]] = deque()
        self._worker = ThreadPoolExecutor(1, "omnisyn-frames")

    def write(self, frame: Shaped[np.ndarray, "height width 3"]) -> None:
        """Take one more frame; waits while as many are waiting as may."""
        while self._pending and (len(self._pending) > self._waiting or self._pending[0].done()):
            self._pending.popleft().result()
        self._pending.append(self._worker.submit(self._sink.write, frame))

    def finish(self) -> None:
        """Wait until every frame has been handed over."""
        while self._pending:
            self._pending.popleft().result()

    def __enter__(self) -> "BackgroundSink":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self._worker.shutdown(cancel_futures=True)
