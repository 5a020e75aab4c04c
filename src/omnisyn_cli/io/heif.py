"""HEIC and AVIF, which OpenImageIO is seldom built with: Pillow decodes them, with pillow-heif for HEIC.

What they say of themselves (EXIF, XMP, colours) is handed on in a PNG, so that one reader knows what it means.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io.outputs import scratch_folder

HEIC_SUFFIXES = frozenset({".heic", ".heif", ".hif"})  # HEIF with HEVC pictures, which a plugin reads
AVIF_SUFFIX = ".avif"  # HEIF with AV1 pictures
EXTRA = "pip install 'omnisyn-cli[heic]'"  # how to install the plugin


@contextmanager
def png_of(path: Path, *, with_pixels: bool) -> Iterator[tuple[Path, tuple[int, int]]]:
    """A PNG that says what a HEIC or AVIF file says, and the picture's height and width; the PNG is gone afterwards.

    Without pixels it has one pixel. ImageError: damaged, or there is no reader; then how to convert it is said.
    """
    pillow, info = _pillow(path)
    with scratch_folder() as folder:
        png = folder / "picture.png"
        try:
            with warnings.catch_warnings(action="ignore"), pillow.open(path) as image:
                width, height = image.size
                mode = "RGBA" if "A" in image.mode else "RGB"
                shown = image.convert(mode) if with_pixels else pillow.new(mode, (1, 1))
                if xmp := image.info.get("xmp"):
                    info.add_itxt("XML:com.adobe.xmp", xmp.decode("utf-8", "replace"))
                known = {key: image.info[key] for key in ("exif", "icc_profile") if image.info.get(key)}
                shown.save(png, pnginfo=info, compress_level=0, **known)
        except MemoryError:
            raise
        except Exception as error:  # of Pillow and its plugins, of many kinds
            raise damaged(path, f"{' '.join(str(error).split()):.200}") from error
        yield png, (height, width)


def damaged(path: Path, complaint: str) -> ImageError:
    """The error for a file that begins as an image and does not hold together."""
    return ImageError(
        f"{path}: expected a complete image, got '{complaint}'; the file is damaged, copy or export it anew"
    )


def _pillow(path: Path) -> tuple[Any, Any]:
    """Pillow's module of images that can open the file, and its metadata of a new PNG."""
    is_heic = path.suffix.lower() in HEIC_SUFFIXES
    try:
        from PIL import Image, PngImagePlugin, features  # an optional dependency

        if is_heic:
            import pillow_heif  # likewise

            pillow_heif.register_heif_opener()
        elif not features.check("avif"):
            raise ImportError("no AVIF")
    except ImportError as error:
        kind = "HEIC" if is_heic else "AVIF"
        raise ImageError(
            f"{path}: expected an image that can be read, got {kind} without a reader for it; install one ({EXTRA}), "
            f"or convert it: magick {path.name} {path.stem}.jpg"
        ) from error
    return Image, PngImagePlugin.PngInfo()
