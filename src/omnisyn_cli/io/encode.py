"""Images written to files, whole or not at all, and numbered images in a folder as a place for frames."""

import base64
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO
from jaxtyping import Shaped, UInt8

from omnisyn_cli.errors import EncodingError, OutputPathError, WriteError
from omnisyn_cli.io import outputs
from omnisyn_cli.io.decode import SHOWN_ATTRIBUTE
from omnisyn_cli.io.images import INTEGER_PEAKS as PEAKS

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".tif", ".tiff")  # files that frames and pictures can be written to
JPEG_QUALITY = 95  # nearly without visible loss. Set by hand.
PNG_COMPRESSION_LEVEL = 1  # ten times faster than zlib's default level, for files a few percent larger
OIIO_TYPES = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}  # OpenImageIO's names of numpy's types
# OpenImageIO's TIFF writer always complains about an EXIF directory that nobody asked for.
IGNORED_COMPLAINT = "Exif data"


def write_image(path: Path | str, image: Shaped[np.ndarray, "height width *channels"]) -> None:
    """Write ``(height, width, 3)`` RGB or ``(height, width)`` grey; the name's ending chooses the format.

    Samples are uint8, uint16 or floating point in [0, 1]. PNG holds uint8 and uint16 exactly (floats are rounded to
    8 bits), JPEG 8 bits at quality 95, TIFF any of the three exactly, EXR float32. An existing file is replaced.

    OutputPathError: unknown ending, or no folder to write into. WriteError: the disk is full, or the folder went away.
    ValueError: another shape or type, or samples that are not finite.
    """
    target = Path(path)
    suffix = image_suffix(target)
    outputs.check_output(target, overwrite=True)
    samples = _samples_for(suffix, image)
    with outputs.replaced_when_complete(target) as temporary:
        if suffix in (".jpg", ".jpeg"):
            temporary.write_bytes(jpeg_bytes(samples))
        else:
            write_channels(temporary, samples, ("R", "G", "B") if samples.ndim == 3 else ("Y",), target, is_shown=True)


def image_suffix(path: Path) -> str:
    """The lower-case ending of a name; OutputPathError where images cannot be written with it."""
    suffix = path.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise OutputPathError(
            f"{path}: expected a name ending in {', '.join(IMAGE_SUFFIXES)}, got '{path.suffix}'; change the name"
        )
    return suffix


def write_channels(
    temporary: Path, samples: np.ndarray, channels: tuple[str, ...], target: Path, *, is_shown: bool = False
) -> None:
    """Write samples as they are, with these channel names, by OpenImageIO; errors speak of ``target``.

    Where colours are sRGB (``is_shown``) an EXR says so, which is taken for linear light otherwise.
    """
    height, width = samples.shape[:2]
    spec = OpenImageIO.ImageSpec(width, height, len(channels), OIIO_TYPES[str(samples.dtype)])
    spec.channelnames = channels
    spec["png:compressionLevel"] = PNG_COMPRESSION_LEVEL
    if is_shown and temporary.suffix.lower() == ".exr":
        spec[SHOWN_ATTRIBUTE] = 1
    spec["DateTime"] = ""  # OpenEXR would write the present time: equal pictures are equal files
    writer = OpenImageIO.ImageOutput.create(str(temporary))
    contiguous = np.ascontiguousarray(samples.reshape(height, width, len(channels)))
    is_written = writer is not None and writer.open(str(temporary), spec) and writer.write_image(contiguous)
    is_closed = writer is not None and writer.close()
    message = OpenImageIO.geterror() if writer is None else writer.geterror()
    complaints = [line.strip() for line in message.splitlines() if line.strip() and IGNORED_COMPLAINT not in line]
    if is_written and is_closed and not complaints:
        if temporary.suffix.lower() != ".exr" or _is_readable(temporary):
            return
        complaints = ["the disk may be full"]
    reason = complaints[0] if complaints else "no reason given"
    raise WriteError(f"{target}: expected to write it, got '{reason}'; check free space and permissions")


def _is_readable(path: Path) -> bool:
    """Whether the file can be read to its end: OpenImageIO keeps silent when the last of an EXR does not fit."""
    reader = OpenImageIO.ImageInput.open(str(path))
    if reader is None:
        OpenImageIO.geterror()
        return False
    spec = reader.spec()
    bottom = spec.y + spec.height
    last = reader.read_scanlines(0, 0, bottom - 1, bottom, 0, 0, spec.nchannels, spec.format)
    complaint = reader.geterror()
    reader.close()
    return last is not None and not complaint


def jpeg_bytes(samples: UInt8[np.ndarray, "height width *channels"], quality: int = JPEG_QUALITY) -> bytes:
    """An image of 8 bits as JPEG, of a quality from 1 to 100; ValueError: it is larger than JPEG allows."""
    # OpenImageIO's JPEG writer ends the whole process when the disk is full (libjpeg's default), so the file is made in
    # memory by OpenCV's.
    import cv2

    in_bgr_order = samples[..., ::-1] if samples.ndim == 3 else samples
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    is_encoded, data = cv2.imencode(".jpg", np.ascontiguousarray(in_bgr_order), options)
    if not is_encoded:
        raise ValueError(f"expected an image that fits JPEG's 65535 pixels, got {samples.shape}")
    return bytes(data.tobytes())


def data_uri(data: bytes, kind: str) -> str:
    """A picture file of a kind (``png``, ``jpeg``) as an address that holds all of it."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _samples_for(suffix: str, image: np.ndarray) -> np.ndarray:
    """Samples in the type that this kind of file holds; ValueError: another shape or type, or not finite."""
    is_picture = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if not is_picture or image.size == 0:
        raise ValueError(f"expected (height, width, 3) or (height, width) samples, got shape {image.shape}")
    name = str(image.dtype)
    if name not in PEAKS:
        if image.dtype.kind != "f":
            raise ValueError(f"expected uint8, uint16 or floating-point samples, got {name}")
        if not np.isfinite(image).all():
            raise ValueError("expected finite samples, got NaN or infinity")
        image = image.astype(np.float32)
    if suffix in (".tif", ".tiff") or (suffix == ".png" and name in PEAKS):
        return image
    unit = np.divide(image, np.float32(PEAKS[name]), dtype=np.float32) if name in PEAKS else image
    if suffix == ".exr":
        return unit
    return image if name == "uint8" else np.rint(np.clip(unit, 0, 1) * 255).astype(np.uint8)


DEFAULT_NUMBER = "%06d"  # of files in a folder: six digits last for nine hours at 30 frames a second
NUMBER = re.compile(r"%0?(\d{0,2})d")  # where a path has the number of a frame, as in FFmpeg
# Endings of videos, and of images that are not written here: such a name means a file.
UNSUPPORTED_SUFFIXES = (
    ".264", ".265", ".3g2", ".3gp", ".avi", ".bmp", ".gif", ".h264", ".h265", ".heic", ".hevc", ".ivf", ".m2ts", ".m4v",
    ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf", ".ogv", ".ts", ".webm", ".webp", ".wmv",
)  # fmt: skip
# Numbers and versions, as in ``walk_1.5m``, ``frames.2024`` and ``walk.v2``: no file's ending.
VERSION_SUFFIX = re.compile(r"\.v?\d.*", re.IGNORECASE)


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
    outputs.check_staged_folder(folder)
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
    with outputs.staged_folder(folder, overwrite=overwrite) as temporary:
        writer = ImageSequenceWriter(temporary, sequence, size)
        yield writer
        if writer.frame_count == 0:
            raise EncodingError(f"{folder}: expected a frame to write, got none; check the trajectory")
        check_sequence(sequence, overwrite)  # somebody else may have made frames in the meantime
    with outputs.write_errors(folder):
        index = writer.frame_count  # what follows without a gap is the rest of a longer sequence
        while (stale := folder / sequence.name(index)).exists():
            stale.unlink()
            index += 1
