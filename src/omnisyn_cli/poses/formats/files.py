"""What all readers of other programs' poses share: what they are asked and answer, axes, and what lies in folders.

Every format says camera-to-world or its inverse, in axes of its own. A pose of ours is
``ours_from_world · world_from_camera · camera_from_ours`` with one matrix for the world and one for the camera, both
rotations: what is left-handed (ZInD) is mirrored by its own reader.

Errors name the file and the line. Panoramas are kept inside the source's folder.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tokenize import TokenError
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_taking
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.io.documents import read_text
from omnisyn_cli.poses.file import stored_file

# ``camera_from_ours``: opengl x right, y up, −z forward (ours); opencv x right, y down, z forward; flu x forward, y
# left, z up (ROS bodies).
CAMERA_AXES = {
    "opengl": np.eye(3),
    "opencv": np.diag([1.0, -1.0, -1.0]),
    "flu": np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}
# ``ours_from_world`` by the world's axis that points up; x stays x. With z up, y (north) becomes −z.
WORLD_UP = {
    "y": np.eye(3),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}

# Length of the mean of the cameras' up vectors below which it has no direction: only rounding is left of it.
MIN_MEAN_UP_LENGTH = 1e-3
CAMERAS_UP = "world: up is the mean of the cameras' own"  # the note about :func:`levelled`
Origin = tuple[float, float, float]
"""WGS84 latitude and longitude in degrees, altitude in metres."""


@dataclass(frozen=True)
class ImportOptions:
    """What a user may say about a source."""

    images: Path | None = None  # folder with the panoramas; None looks where the format usually has them
    # where the world's origin lies; None leaves it where the format has it, or at the first panorama
    origin: Origin | None = None
    up: str | None = None  # a name of :data:`WORLD_UP` or ``cameras``; None is the format's own
    camera: str | None = None  # a name of :data:`CAMERA_AXES`; None is the format's own
    # which way the horizon turns in the picture as the roll of a place grows, ``counter-clockwise`` as GPano defines
    # it, or ``clockwise`` as some programs have it; None is the format's own
    roll: str | None = None
    floor: str | None = None  # the floor of a ZInD tour; None is the only one
    time_tolerance: float = 0.02  # seconds by which time stamps of poses and images may differ
    allow_outside: bool = False  # whether files that a source names may lie outside its folder

    def pose(self, foreign: Pose, *, camera: str, up: str) -> Pose:
        """Our pose of a camera-to-world one in the axes ``camera`` and ``up``, or in those that the user names."""
        ours_from_world, camera_from_ours = WORLD_UP[self.up or up], CAMERA_AXES[self.camera or camera]
        return Pose(ours_from_world @ foreign.rotation @ camera_from_ours, ours_from_world @ foreign.position)


@dataclass(frozen=True)
class ImportedView:
    """One panorama."""

    name: str  # as the source calls it, a path with forward slashes
    pose: Pose  # camera-to-world in our axes
    image: Path | None = None  # the file, or None where it was not found
    depth: Path | None = None  # a depth file that ``poses.json`` can refer to, or None


@dataclass(frozen=True)
class ImportedPoses:
    """What a source says."""

    views: tuple[ImportedView, ...]  # in the order of the source, or of the file names where it has none
    notes: tuple[str, ...]  # one line for everything that was assumed, in words for the user
    is_metric: bool = True  # whether the unit of positions is known to be the metre


def noted(notes: Mapping[str, object]) -> tuple[str, ...]:
    """The notes whose condition holds."""
    return tuple(note for note, holds in notes.items() if holds)


def foreign_from_pose(pose: Pose, *, camera: str, up: str) -> Pose:
    """A camera-to-world pose in other axes: the inverse of :meth:`ImportOptions.pose`."""
    world_from_ours = WORLD_UP[up].T
    return Pose(world_from_ours @ pose.rotation @ CAMERA_AXES[camera].T, world_from_ours @ pose.position)


def levelled(poses: Sequence[Pose]) -> list[Pose]:
    """The same poses in a world whose y axis is the mean of the cameras' own: level where cameras were held level."""
    mean_up = np.mean([pose.rotation[:, 1] for pose in poses], axis=0)
    length = float(np.linalg.norm(mean_up))
    if length < MIN_MEAN_UP_LENGTH:
        raise PoseError("expected cameras held roughly upright, got directions that cancel out; choose --up by axis")
    turn = Pose(rotation_taking(mean_up / length, UP), np.zeros(3))
    return [turn @ pose for pose in poses]


IMAGE_SUFFIXES = frozenset(
    {".avif", ".exr", ".hdr", ".heic", ".heif", ".jpeg", ".jpg", ".jxl", ".mpo", ".png", ".tif", ".tiff", ".webp"}
)

# What NumPy raises for broken headers, sizes beyond all memory and archives.
NUMPY_LOAD_ERRORS = (
    ValueError, EOFError, SyntaxError, TokenError, BadZipFile, RecursionError, MemoryError, TypeError,
    OverflowError,
)  # fmt: skip


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
    PoseError, which begins with ``where``: the name leads out of the folder without ``allow_outside``, or is no name.
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
