"""What other programs leave in folders: lines of numbers, NumPy arrays, and the panoramas that they speak of.

Errors name the file and the line. Panoramas are kept inside the source's folder.
"""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from tokenize import TokenError
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io.documents import read_text
from omnisyn_cli.poses.file import stored_file
from omnisyn_cli.poses.formats.model import ImportedView, ImportOptions

IMAGE_SUFFIXES = frozenset(
    {".avif", ".exr", ".hdr", ".heic", ".heif", ".jpeg", ".jpg", ".jxl", ".mpo", ".png", ".tif", ".tiff", ".webp"}
)

NUMPY_LOAD_ERRORS = (
    ValueError, EOFError, SyntaxError, TokenError, BadZipFile, RecursionError, MemoryError, TypeError,
    OverflowError,
)  # fmt: skip
"""What NumPy raises for broken headers, sizes beyond all memory and archives."""


def data_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number (from 1) and text of every line that is neither empty nor a comment (``#``)."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if (text := line.strip()) and not text.startswith("#"):
            yield number, text


def numbers(where: str, fields: Sequence[str], count: int, what: str) -> Float[np.ndarray, " count"]:
    """``count`` finite numbers; PoseError, which begins with ``where`` (file and line): more, fewer, or others."""
    if len(fields) != count:
        raise PoseError(f"{where}: expected {count} numbers ({what}), got {len(fields)} fields; correct the line")
    try:
        values = [float(field) for field in fields]
    except ValueError as error:
        raise PoseError(f"{where}: expected numbers ({what}), got '{error!s:.200}'; correct the line") from error
    if not all(math.isfinite(value) for value in values):
        raise PoseError(f"{where}: expected finite numbers ({what}), got {' '.join(fields):.200}; correct the line")
    return np.array(values)


def read_array(path: Path) -> Float[np.ndarray, "*shape"]:
    """A ``.npy`` file of finite numbers as float64; pickled objects are refused."""
    try:
        array = np.load(path, allow_pickle=False)
    except OSError as error:
        raise PoseError(f"{path}: expected a NumPy array, got '{error.strerror or error}'; check the name") from error
    except NUMPY_LOAD_ERRORS as error:
        reason = " ".join(f"{error!s:.200}".split())
        raise PoseError(f"{path}: expected a plain NumPy array, got '{reason}'; save it with numpy.save") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        found = f"type {array.dtype}" if isinstance(array, np.ndarray) else "an archive"
        raise PoseError(f"{path}: expected a NumPy array of numbers, got {found}; save it with numpy.save")
    if not np.isfinite(array).all():
        raise PoseError(f"{path}: expected finite numbers, got NaN or infinity; repair it")
    return array.astype(np.float64)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key that puts ``frame9`` before ``frame10``."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"([0-9]+)", name) if part]


def entries(folder: Path) -> list[Path]:
    """What lies in a folder, in no particular order; PoseError: no such folder, or it must not be read."""
    try:
        return list(folder.iterdir())
    except OSError as error:
        raise PoseError(f"{folder}: expected a readable folder, got '{error.strerror}'; check the name") from error


def images_in(folder: Path) -> list[Path]:
    """Image files of a folder (not below it) in natural order of their names."""
    found = [path for path in entries(folder) if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()]
    return sorted((path for path in found if not path.name.startswith(".")), key=lambda path: natural_key(path.name))


def default_folder(folder: Path, options: ImportOptions) -> Path:
    """Where the panoramas of a trajectory lie: ``--images``, or the first of ``.``, ``images`` and ``rgb`` with any."""
    if options.images is not None:
        return options.images
    candidates = [folder, folder / "images", folder / "rgb"]
    return next((path for path in candidates if path.is_dir() and images_in(path)), folder)


def find_image(where: str, name: str, folders: list[Path], options: ImportOptions) -> Path | None:
    """The file that a source calls ``name``, in the first of ``folders`` that has it, or None.

    A name without ending may mean any image (instant-ngp writes such). With ``options.images`` its folder comes first.

    Raises:
        PoseError: the name leads out of the folder and ``allow_outside`` is off, or no file can have it; ``where``
            begins the message.
    """
    if not options.allow_outside and (PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts):
        raise PoseError(f"{where}: expected a file inside the source's folder, got '{name}'; use --allow-outside")
    searched = folders if options.images is None else [options.images, *folders]
    candidates = (folder / part for folder in searched for part in (name, PurePosixPath(name).name))
    try:
        return next((found for candidate in candidates if (found := _existing(candidate))), None)
    except (OSError, ValueError) as error:
        raise PoseError(f"{where}: expected a file name, got '{name:.60}' ({error!s:.60}); correct it") from error


def find_view(where: str, name: str, pose: Pose, folders: list[Path], options: ImportOptions) -> ImportedView:
    """A panorama with its file as :func:`find_image` finds it."""
    return ImportedView(name, pose, find_image(where, name, folders, options))


def _existing(candidate: Path) -> Path | None:
    if (stored := stored_file(candidate)).is_file():
        return stored
    if candidate.suffix.lower() in IMAGE_SUFFIXES or not candidate.parent.is_dir():
        return None
    named = (candidate.with_name(candidate.name + suffix) for suffix in sorted(IMAGE_SUFFIXES))
    return next((path for path in named if path.is_file()), None)
