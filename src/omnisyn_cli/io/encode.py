"""Images written to files: whole or not at all."""

from pathlib import Path

import numpy as np
import OpenImageIO
from jaxtyping import Shaped, UInt8

from omnisyn_cli.errors import OutputPathError, WriteError
from omnisyn_cli.io.decode import SHOWN_ATTRIBUTE
from omnisyn_cli.io.images import INTEGER_PEAKS as PEAKS
from omnisyn_cli.io.outputs import check_output, replaced_when_complete

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".tif", ".tiff")
"""Files that frames and pictures can be written to."""

JPEG_QUALITY = 95
"""Nearly without visible loss. Set by hand."""

PNG_COMPRESSION_LEVEL = 1
"""Ten times faster than zlib's default level, for files a few percent larger."""

OIIO_TYPES = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}
"""OpenImageIO's names of numpy's types."""

IGNORED_COMPLAINT = "Exif data"
"""OpenImageIO's TIFF writer always complains about an EXIF directory that nobody asked for."""


def write_image(path: Path | str, image: Shaped[np.ndarray, "height width *channels"]) -> None:
    """Write ``(height, width, 3)`` RGB or ``(height, width)`` grey; the name's ending chooses the format.

    Samples are uint8, uint16 or floating point in [0, 1]. PNG holds uint8 and uint16 exactly (floats are rounded to
    8 bits), JPEG 8 bits at quality 95, TIFF any of the three exactly, EXR float32. An existing file is replaced.

    Raises:
        OutputPathError: unknown ending, or no folder to write into.
        WriteError: the disk is full, or the folder went away.
        ValueError: another shape or type, or samples that are not finite.
    """
    target = Path(path)
    suffix = image_suffix(target)
    check_output(target, overwrite=True)
    samples = _samples_for(suffix, image)
    with replaced_when_complete(target) as temporary:
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
