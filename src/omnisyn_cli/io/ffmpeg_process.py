"""ffmpeg as a process of ours: frames go in or come out, its last words are heard, nothing stays behind."""

import os
import re
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Self

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.errors import EncodingError, InputError, WriteError
from omnisyn_cli.io.decode import check_is_file
from omnisyn_cli.io.encoders import Soundtrack, ffmpeg_program
from omnisyn_cli.io.outputs import scratch_folder

MAX_STDERR_LINES = 12  # the last lines of ffmpeg that an error message quotes
KILL_TIMEOUT_SECONDS = 10  # that ffmpeg has to end once its input is closed or it has failed
# Asked for where the size of a pipe can be chosen, else it is 64 KiB: fewer turns between the two processes.
PIPE_BYTES = 1 << 20
# What FFmpeg says where it cannot write.
FULL_DISK_MESSAGES = ("No space left on device", "File too large", "Disk quota exceeded", "Input/output error")
FILE_SIZE_SIGNAL = "SIGXFSZ"  # the signal that ends a process whose file grows beyond the user's limit
# Lines that encoders print whatever the level of logging is.
ENCODER_CHATTER = ("Svt[info]", "Svt[warn]", "x265 [info]")


Packing = Callable[[np.ndarray], np.ndarray]


class EncoderProcess:
    """A running encoder that takes raw frames.

    As a context manager it is finished on a regular exit and killed on any exception, KeyboardInterrupt included.

    The command reads raw frames of ``shape`` (height, width, 3) and ``uint8`` or ``uint16`` from standard input, as
    they are or as ``packed`` makes them of contiguous ones. Error messages call the output ``target``.
    """

    def __init__(
        self, command: list[str], target: Path, shape: tuple[int, int, int], dtype: str, packed: Packing | None = None
    ) -> None:
        self.frame_count = 0
        self._packed = packed
        self._target = target
        self._shape = shape
        self._dtype = np.dtype(dtype).newbyteorder("<")
        self._words: deque[str] = deque(maxlen=MAX_STDERR_LINES)
        self._process = self._started(command)
        self._stdin: IO[bytes] = self._process.stdin  # type: ignore[assignment]  # a pipe was asked for
        with suppress(ImportError, AttributeError, OSError):  # only Linux lets us, and it may allow less
            import fcntl

            fcntl.fcntl(self._stdin.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        # A session of its own keeps Ctrl-C from reaching ffmpeg before us. stderr is drained all the time: a full pipe
        # would stop ffmpeg for ever.
        self._listener = threading.Thread(target=self._listen, daemon=True, name="ffmpeg-stderr")
        self._listener.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._finish()
        finally:
            self._kill()

    def write(self, frame: Shaped[np.ndarray, "height width 3"]) -> None:
        """Encode one more frame, of the announced shape and type."""
        if frame.shape != self._shape or frame.dtype != self._dtype:
            raise ValueError(f"expected a frame {self._shape} {self._dtype}, got {frame.shape} {frame.dtype}")
        samples = np.ascontiguousarray(frame, self._dtype)
        samples = samples if self._packed is None else self._packed(samples)
        try:
            self._stdin.write(samples.data)
        except OSError:
            raise self._failure() from None
        self.frame_count += 1

    def _started(self, command: list[str]) -> subprocess.Popen[bytes]:
        try:
            return subprocess.Popen(  # noqa: S603 - a list, no shell; every file name is prefixed
                command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                env={**os.environ, "SVT_LOG": "1", "AV_LOG_FORCE_NOCOLOR": "1"}, start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise EncodingError(
                f"{self._target}: expected to start ffmpeg, got '{error}'; check {command[0]}"
            ) from error

    def _listen(self) -> None:
        for line in self._process.stderr or ():
            text = line.decode("utf-8", "replace").strip()
            if text and not text.startswith(ENCODER_CHATTER):
                self._words.append(text)

    def _finish(self) -> None:
        """Close the input and wait until ffmpeg has written everything."""
        if self.frame_count == 0:
            raise EncodingError(f"{self._target}: expected a frame to encode, got none; check the trajectory")
        try:
            self._stdin.close()
        except OSError:
            raise self._failure() from None
        if self._process.wait() != 0:
            raise self._failure()

    def _failure(self) -> EncodingError | WriteError:
        """What ffmpeg died of, in its own words."""
        try:
            code: int | str = self._process.wait(KILL_TIMEOUT_SECONDS)
        except subprocess.TimeoutExpired:
            code = "no exit"
        self._listener.join(KILL_TIMEOUT_SECONDS)
        words = " | ".join(self._words) or "no word"
        ended_by = signal.Signals(-code).name if isinstance(code, int) and code < 0 else ""
        if ended_by == FILE_SIZE_SIGNAL:
            return WriteError(
                f"{self._target}: expected room for the video, got a limit on files; raise it (ulimit -f)"
            )
        if not ended_by and (full := next((sign for sign in FULL_DISK_MESSAGES if sign in words), None)):
            return WriteError(f"{self._target}: expected room for the video, got '{full}'; free some space")
        expected = f"{self._target}: expected ffmpeg to encode {self.frame_count} frames, got"
        if ended_by:  # without last words
            return EncodingError(
                f"{expected} it ended by {ended_by}; where memory is short a smaller --size helps, else choose another "
                "codec"
            )
        return EncodingError(
            f"{expected} exit code {code}: '{words}'; change the setting it names or choose another codec"
        )

    def _kill(self) -> None:
        """Leave no process, thread or pipe behind; harmless after a regular end."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._listener.join(KILL_TIMEOUT_SECONDS)
        for pipe in (self._process.stdin, self._process.stderr):
            with suppress(OSError):  # closing flushes; to a dead process that fails and does not matter
                if pipe is not None:
                    pipe.close()


def run_ffmpeg(path: Path, *options: str, seconds: float | None = None) -> tuple[bytes, str, bool]:
    """What ffmpeg writes to its standard output about a file, what it says, and whether it succeeds.

    Only this one file is opened, whatever playlists it may hold. subprocess.TimeoutExpired: not done after ``seconds``.
    """
    command = [
        ffmpeg_program(), "-hide_banner", "-nostdin", "-protocol_whitelist", "file", "-i", f"file:{path.absolute()}",
    ]  # fmt: skip
    done = subprocess.run([*command, *options], capture_output=True, check=False, timeout=seconds)  # noqa: S603 - a list
    return done.stdout, done.stderr.decode("utf-8", "replace").strip(), done.returncode == 0


def read_frames(path: Path, size: tuple[int, int], count: int) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """The first ``count`` frames of a BT.709 video of ``size`` (height, width) as RGB; fewer if it is shorter."""
    scale = "scale=in_color_matrix=bt709:in_range=tv:flags=accurate_rnd+full_chroma_int"
    form = ("-vf", scale, "-pix_fmt", "rgb24", "-f", "rawvideo", "-")
    samples, said, succeeded = run_ffmpeg(path, "-v", "error", "-frames:v", str(count), *form)
    if not succeeded:
        words = " | ".join(said.split("\n")[:3])
        raise EncodingError(f"{path}: expected a video that ffmpeg can read, got '{words}'; make it again")
    yield from np.frombuffer(samples, np.uint8).reshape(-1, *size, 3)


SOUND_STREAM = re.compile(r"Stream #0:\S+ Audio: (\w+)")  # what ffmpeg prints of a stream
DECODED_MICROSECONDS = re.compile(r"out_time_us=(\d+)")  # and, with ``-progress``, of what it has decoded


def read_soundtrack(path: Path, video_seconds: float) -> Soundtrack:
    """Decode the sound of a file, for a video of a length. InputError: there is none, or it cannot be decoded."""
    check_is_file(path)
    form = ("-nostats", "-progress", "-", "-map", "0:a:0", "-f", "null", "-")
    progress, said, succeeded = run_ffmpeg(path, *form)
    stream = SOUND_STREAM.search(said)
    decoded = DECODED_MICROSECONDS.findall(progress.decode("ascii", "replace"))
    seconds = float(decoded[-1]) / 1e6 if decoded else 0.0
    if not succeeded or stream is None or seconds <= 0.0:
        found = said.splitlines()[-1:] or ["nothing"]
        words = f"'{found[0]:.200}' from ffmpeg" if stream or "Input #0" not in said else "a file without sound"
        raise InputError(f"{path}: expected a file with sound for --audio, got {words}; name another")
    return Soundtrack(path, stream[1], seconds, video_seconds)


# Files that frames are taken from.
VIDEO_SUFFIXES = frozenset({".360", ".avi", ".insv", ".m4v", ".mkv", ".mov", ".mp4", ".webm"})


@contextmanager
def frames_of_video(path: Path, seconds: float) -> Iterator[tuple[Path, ...]]:
    """Frames at 0, ``seconds``, 2 · ``seconds`` …, as PNG files in the order of time.

    Colours are taken for BT.709, as cameras for 360° write them. InputError: no video, or fewer than two frames.
    """
    check_is_file(path)
    with scratch_folder() as folder:
        choice = f"select='isnan(prev_selected_t)+gte(t-prev_selected_t,{seconds:.6f}-0.5/30)'"
        _, said, succeeded = run_ffmpeg(
            path, "-v", "error", "-map", "0:v:0", "-fps_mode", "passthrough",
            "-vf", f"{choice},scale=in_color_matrix=bt709:flags=bicubic+accurate_rnd+full_chroma_int,format=rgb24",
            "-compression_level", "1", str(folder / "frame%05d.png"),
        )  # fmt: skip
        frames = tuple(sorted(folder.glob("*.png")))
        if not succeeded or not frames:
            lines = said.splitlines() or ["no frames"]
            raise InputError(f"{path}: expected a video, got '{lines[-1]:.200}'; export it as MP4")
        if len(frames) < 2:
            raise InputError(f"{path}: expected a video of more than {seconds:g} s, got one frame; take them closer")
        yield frames
