"""Numbered images in a folder as a place for frames."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.errors import EncodingError, OutputPathError
from omnisyn_cli.io.encode import IMAGE_SUFFIXES, image_suffix, write_image
from omnisyn_cli.io.outputs import appears_at_once, check_staged_folder, hidden_folder, write_errors

DEFAULT_NUMBER = "%06d"
"""Of files in a folder: six digits last for nine hours at 30 frames a second."""

NUMBER = re.compile(r"%0?(\d{0,2})d")
"""Where a path has the number of a frame, as in FFmpeg."""

UNSUPPORTED_SUFFIXES = (
    ".264", ".265", ".3g2", ".3gp", ".avi", ".bmp", ".gif", ".h264", ".h265", ".heic", ".hevc", ".ivf", ".m2ts", ".m4v",
    ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf", ".ogv", ".ts", ".webm", ".webp", ".wmv",
)  # fmt: skip
"""Endings of videos, and of images that are not written here: such a name means a file."""

VERSION_SUFFIX = re.compile(r"\.v?\d.*", re.IGNORECASE)
"""Numbers and versions, as in ``walk_1.5m``, ``frames.2024`` and ``walk.v2``: no file's ending."""


@dataclass(frozen=True)
class ImageSequence:
    """File names ``folder/before000001after``: numbers from 0 on, padded to ``digits``."""

    folder: Path
    before: str
    digits: int
    after: str

    def name(self, index: int) -> str:
        """File name of frame ``index``."""
        return f"{self.before}{index:0{self.digits}d}{self.after}"

    def existing(self) -> list[Path]:
        """Files in the folder that are called exactly as its frames: with as many zeros, not just with any number."""
        numbered = re.compile(re.escape(self.before) + r"(\d+)" + re.escape(self.after))
        files = self.folder.iterdir() if self.folder.is_dir() else ()
        found = ((file, numbered.fullmatch(file.name)) for file in files)
        return [file for file, match in found if match and self.name(int(match.group(1))) == file.name]


class ImageSequenceWriter:
    """Writes one image after another into a folder."""

    def __init__(self, folder: Path, sequence: ImageSequence, size: tuple[int, int]) -> None:
        self.frame_count = 0
        self._size = size
        self._folder = folder
        self._sequence = sequence

    def write(self, frame: Shaped[np.ndarray, "height width 3"]) -> None:
        """Write one more frame, of any type that :func:`omnisyn_cli.io.write_image` takes."""
        if frame.shape != (*self._size, 3):
            raise ValueError(f"expected a frame {(*self._size, 3)}, got {frame.shape}")
        write_image(self._folder / self._sequence.name(self.frame_count), frame)
        self.frame_count += 1


def is_sequence(path: Path) -> bool:
    """Whether a path can mean numbered images: an image name with ``%06d``, or no name of a known file.

    A folder that is called like a video is no place for images: whoever names it means a file.
    """
    suffix = path.suffix.lower()
    if suffix == "":
        return True
    if NUMBER.search(path.name):
        return suffix in IMAGE_SUFFIXES
    return not _is_known(suffix)


def is_ambiguous(path: Path) -> bool:
    """Whether a name can mean a folder, but looks like a file's: it ends in a dot and letters, such as ``.mpx``."""
    is_plain = path.suffix == "" or path.is_dir() or _is_known(path.suffix.lower())
    return not (is_plain or VERSION_SUFFIX.fullmatch(path.suffix))


def image_sequence(path: Path, suffix: str = ".png") -> ImageSequence:
    """The file names that a folder or a pattern such as ``frames/view_%04d.jpg`` stands for.

    Images end in ``suffix`` where ``path`` does not say it. OutputPathError: more than one number, a number in the
    folder's name, or an unknown kind of image.
    """
    if path.is_dir() or not (NUMBER.search(path.name) or _is_known(path.suffix.lower())):
        path = path / f"{DEFAULT_NUMBER}{suffix}"
    elif path.suffix == "":
        path = path.with_name(path.name + suffix)
    image_suffix(path)
    numbers = list(NUMBER.finditer(path.name))
    if len(numbers) != 1:
        raise OutputPathError(f"{path}: expected one frame number such as %06d, got {len(numbers)}; change the pattern")
    number = numbers[0]
    return ImageSequence(path.parent, path.name[: number.start()], int(number.group(1) or 1), path.name[number.end() :])


def _is_known(suffix: str) -> bool:
    return suffix in IMAGE_SUFFIXES or suffix in UNSUPPORTED_SUFFIXES


def check_sequence(sequence: ImageSequence, overwrite: bool) -> None:
    """Refuse a sequence that could not be written, before any work."""
    folder = sequence.folder
    check_staged_folder(folder)
    if not overwrite and (existing := sequence.existing()):
        raise OutputPathError(
            f"{folder}: expected a folder without such frames, got {len(existing)} (e.g. {min(existing).name}); "
            "choose another folder or allow overwriting (--overwrite)"
        )


@contextmanager
def open_sequence(
    sequence: ImageSequence, size: tuple[int, int], *, overwrite: bool = False
) -> Iterator[ImageSequenceWriter]:
    """A place for frames that appears in its folder when it is complete; former frames of it are removed then."""
    check_sequence(sequence, overwrite)
    folder = sequence.folder
    with hidden_folder(folder) as temporary:
        writer = ImageSequenceWriter(temporary, sequence, size)
        yield writer
        if writer.frame_count == 0:
            raise EncodingError(f"{folder}: expected a frame to write, got none; check the trajectory")
        check_sequence(sequence, overwrite)  # somebody else may have made frames in the meantime
        if appears_at_once(temporary, folder):
            return
        with write_errors(folder):
            folder.mkdir(exist_ok=True)
            for frame in sorted(temporary.iterdir()):
                frame.replace(folder / frame.name)
            index = writer.frame_count  # what follows without a gap is the rest of a longer sequence
            while (stale := folder / sequence.name(index)).exists():
                stale.unlink()
                index += 1
