"""The entries of ``poses.json``, of either kind, as pydantic models, and the pose that one means."""

import math
import re
from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry import pose as geometry
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io.documents import expected

# Deviation of a quaternion from unit length, or of a matrix from orthonormal: room for four written digits.
UNIT_TOLERANCE = 1e-3
POSITION_TOLERANCE = 1e-6  # Metres by which a position and a 4×4 matrix may disagree, and deviation of its last row
MAX_COORDINATE = 1e8  # Metres, more than twice around the earth; coordinates beyond are a mistake in units
MAX_TEXT_CHARS = 2000  # Of a title, a caption or the text of a hotspot

# Those that no text of a user has; a line may end.
CONTROL_CHARACTERS = re.compile(r"[\0-\x09\x0b-\x1f\x7f\ud800-\udfff]")

Metres = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Vector = Annotated[list[Metres], Field(min_length=3, max_length=3)]


def path_problem(name: str, *, allow_outside: bool = False) -> str | None:
    """What keeps a name from being a file inside the pose file's folder (or anywhere, if allowed), or None."""
    if not name or name in (".", ".."):
        return "empty"
    if re.search(r"[\0-\x1f\\\ud800-\udfff]", name):
        return "with a backslash, or a character that is no text"
    if allow_outside:
        return None
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive:
        return "absolute"
    return "leading out of the folder" if ".." in PurePosixPath(name).parts else None


def _inside_folder(name: str, info: ValidationInfo) -> str:
    if problem := path_problem(name, allow_outside=(info.context or {}).get("allow_outside", False)):
        hint = "" if path_problem(name, allow_outside=True) else "; commands with --allow-outside accept it"
        raise ValueError(f"a file name relative to the pose file and inside its folder (this is {problem}{hint})")
    return name


File = Annotated[str, AfterValidator(_inside_folder)]

Matrix = Annotated[
    list[list[Metres]],
    expected(
        "a 3×3 or 4×4 matrix as a list of rows", lambda rows: len(rows) in (3, 4) and {*map(len, rows)} == {len(rows)}
    ),
]

Quaternion = Annotated[list[float], expected("a unit quaternion [w, x, y, z]", lambda numbers: len(numbers) == 4)]

Text = Annotated[
    str,
    Field(max_length=MAX_TEXT_CHARS),
    expected("text without control characters", lambda text: not CONTROL_CHARACTERS.search(text)),
]

FirstVersion = Annotated[Any, expected("1, the only version there is", lambda n: type(n) is int and n == 1)]

LinkEntry = Annotated[
    list[str], expected("the names of two different panoramas", lambda names: len(names) == 2 == len(set(names)))
]


class Model(BaseModel):
    """Part of a file that users write: unknown keys are errors, and numbers are finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class PoseDocument(Model):
    """The whole file; entries are checked one by one, by the kind their keys announce."""

    version: FirstVersion
    panoramas: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]
    links: list[LinkEntry] | None = None
    metric: bool = True


class UncertaintyEntry(Model):
    """One standard deviation relative to the entry before; per cent of the distance between both."""

    rotation_deg: Annotated[float, Field(ge=0)]
    position_percent: Annotated[float, Field(ge=0)] | None = None


class RigidEntry(Model):
    """A pose in metres."""

    position: Vector | None = None
    rotation: Quaternion | None = None
    matrix: Matrix | None = None
    uncertainty: UncertaintyEntry | None = None
    depth: File | None = None
    mask: File | None = None
    title: Text = ""
    caption: Text = ""


class GeographicEntry(Model):
    """A place on earth; degrees, metres, and the compass heading of the image centre."""

    latitude: Annotated[float, Field(ge=-90, le=90)]
    longitude: Annotated[float, Field(ge=-180, le=180)]
    altitude: Annotated[float, Field(ge=-1e6, le=1e6)]
    heading: Annotated[float, Field(ge=-360, le=360)]
    pitch: Annotated[float, Field(ge=-90, le=90)] = 0.0
    roll: Annotated[float, Field(ge=-180, le=180)] = 0.0
    depth: File | None = None
    mask: File | None = None
    title: Text = ""
    caption: Text = ""

    @property
    def origin(self) -> tuple[float, float, float]:
        """Latitude and longitude in degrees and altitude in metres: where a world may begin."""
        return self.latitude, self.longitude, self.altitude


Entry = RigidEntry | GeographicEntry
COMMON_KEYS = frozenset({"depth", "mask", "title", "caption"})
RIGID_KEYS = frozenset(RigidEntry.model_fields) - COMMON_KEYS
GEOGRAPHIC_KEYS = frozenset(GeographicEntry.model_fields) - COMMON_KEYS


def pose_from_entry(entry: Entry, where: str, origin: tuple[float, float, float] | None) -> Pose:
    """Camera-to-world, metres, in the world that begins at ``origin``, else at the entry; ``where`` begins errors."""
    if isinstance(entry, RigidEntry):
        return _rigid_pose(where, entry)
    # Headings are taken as if north were the same everywhere, which is right within arc seconds over a walk.
    east, north, up = geometry.enu_from_geographic(*entry.origin, origin or entry.origin)
    angles = (math.radians(angle) for angle in (entry.heading, entry.pitch, entry.roll))
    return Pose(geometry.rotation_from_heading(*angles), np.array([east, up, -north]))


def _rigid_pose(where: str, entry: RigidEntry) -> Pose:
    if (entry.rotation is None) == (entry.matrix is None):
        found = "both" if entry.rotation else "neither"
        raise PoseError(f"{where}: expected either rotation or matrix, got {found}; write one of them")
    position = entry.position
    if entry.matrix is None:
        rotation = checked_quaternion(f"{where}.rotation", np.array(entry.rotation))
    else:
        matrix = np.array(entry.matrix)
        position = _translation(where, matrix, position) if len(matrix) == 4 else position
        rotation = checked_rotation(f"{where}.matrix", matrix[:3, :3])
    if position is None:
        raise PoseError(f"{where}: expected the key 'position', got none; add it as [x, y, z] in metres")
    return Pose(rotation, np.array(position, float))


def _translation(where: str, matrix: np.ndarray, position: list[float] | None) -> list[float]:
    """That of a 4×4 transform, with which a position agrees if there is one."""
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > POSITION_TOLERANCE:
        raise PoseError(f"{where}.matrix: expected a last row [0, 0, 0, 1], got {matrix[3].tolist()}; transpose it")
    translation: list[float] = matrix[:3, 3].tolist()
    if position is not None and np.abs(np.subtract(translation, position)).max() > POSITION_TOLERANCE:
        raise PoseError(
            f"{where}: expected position to agree with the 4×4 matrix, got {position} and {translation}; remove "
            "position"
        )
    return translation


def checked_rotation(where: str, matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation that a matrix of few digits stands for.

    PoseError, which begins with ``where``: scale, shear, a mirror image, NaN.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # giant numbers are refused as well
        deviation = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if not deviation <= UNIT_TOLERANCE:
        raise PoseError(
            f"{where}: expected a rigid rotation (RᵀR = 1), got a deviation of {deviation:.3g}; remove scale and "
            "shear, or check the format"
        )
    if np.linalg.det(matrix) < 0:
        raise PoseError(
            f"{where}: expected a rotation (determinant +1), got a mirror image (−1); flip two axes, not one, or check "
            "the format"
        )
    return geometry.nearest_rotation(matrix)


def checked_quaternion(where: str, quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """Rotation of a quaternion ``[w, x, y, z]`` of about unit length; else a PoseError that begins with ``where``."""
    length = math.hypot(*quaternion)  # which, unlike a sum of squares, does not overflow
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise PoseError(
            f"{where}: expected a unit quaternion, got length {length:.6g}; check its order, or divide it by its length"
        )
    return geometry.rotation_from_quaternion(quaternion)
