"""The shape of ``poses.json`` as pydantic models, and what pydantic finds said in one line."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, ValidationInfo

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.strict_json import parse_json

__all__ = [
    "ALLOW_OUTSIDE",
    "GEOGRAPHIC_KEYS",
    "RIGID_KEYS",
    "GeographicEntry",
    "PoseDocument",
    "RigidEntry",
    "parsed_json",
    "path_problem",
    "place_of",
    "sentence",
    "validated",
]

Model = TypeVar("Model", bound=BaseModel)

LONGEST_SHOWN = 60

MOST_LISTED = 20
"""Keys of a model that a message names when another came."""

PYDANTICS_OWN = (
    r"^(Input|List|Dictionary|String) should (be|have) | after validation, .*|, unable to .*"
    r"|, got a number with a fractional part"
)
"""What its messages have besides what was expected."""

ALLOW_OUTSIDE = "allow_outside"
"""Key of the validation context; true where depth and masks may lie anywhere."""

EARTH = 1e8
"""Metres; coordinates beyond are a mistake in units."""

Metres = Annotated[float, Field(ge=-EARTH, le=EARTH)]

Vector = Annotated[list[Metres], Field(min_length=3, max_length=3)]


def path_problem(name: str, *, allow_outside: bool = False) -> str | None:
    """What keeps a name from being a file inside the pose file's folder (or anywhere, if allowed), or None."""
    if not name or name in (".", ".."):
        return "empty"
    if re.search(r"[\0-\x1f\\]", name):
        return "with a backslash or control character"
    if allow_outside:
        return None
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive:
        return "absolute"
    return "leading out of the folder" if ".." in PurePosixPath(name).parts else None


def _inside_folder(name: str, info: ValidationInfo) -> str:
    if problem := path_problem(name, allow_outside=(info.context or {}).get(ALLOW_OUTSIDE, False)):
        hint = "" if path_problem(name, allow_outside=True) else "; commands with --allow-outside accept it"
        raise ValueError(f"a file name relative to the pose file and inside its folder (this is {problem}{hint})")
    return name


def _square(matrix: list[list[float]]) -> list[list[float]]:
    lengths = {len(row) for row in matrix}
    if lengths != {len(matrix)} or len(matrix) not in (3, 4):
        raise ValueError("a 3×3 or 4×4 matrix as a list of rows")
    return matrix


def _quaternion(numbers: list[float]) -> list[float]:
    if len(numbers) != 4:
        raise ValueError("a unit quaternion [w, x, y, z]")
    return numbers


def _first_version(version: Any) -> int:
    if type(version) is not int or version != 1:
        raise ValueError("1, the only version there is")
    return version


File = Annotated[str, AfterValidator(_inside_folder)]

Matrix = Annotated[list[list[Metres]], AfterValidator(_square)]

Quaternion = Annotated[list[float], AfterValidator(_quaternion)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class PoseDocument(_Model):
    """The whole file; entries are checked one by one, by the kind their keys announce."""

    version: Annotated[Any, AfterValidator(_first_version)]
    panoramas: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]


class RigidEntry(_Model):
    """A pose in metres."""

    position: Vector | None = None
    rotation: Quaternion | None = None
    matrix: Matrix | None = None
    depth: File | None = None
    mask: File | None = None


class GeographicEntry(_Model):
    """A place on earth; degrees, metres, and the compass heading of the image centre."""

    latitude: Annotated[float, Field(ge=-90, le=90)]
    longitude: Annotated[float, Field(ge=-180, le=180)]
    altitude: Annotated[float, Field(ge=-1e6, le=1e6)]
    heading: Annotated[float, Field(ge=-360, le=360)]
    pitch: Annotated[float, Field(ge=-90, le=90)] = 0.0
    roll: Annotated[float, Field(ge=-180, le=180)] = 0.0
    depth: File | None = None
    mask: File | None = None


FILE_KEYS = frozenset({"depth", "mask"})

RIGID_KEYS = frozenset(RigidEntry.model_fields) - FILE_KEYS

GEOGRAPHIC_KEYS = frozenset(GeographicEntry.model_fields) - FILE_KEYS


def _explained(error: ValidationError, model: type[BaseModel], where: tuple[str, ...]) -> str:
    """One line for the first thing that is wrong: place, expected, got, next step; and how many more there are."""
    problems = error.errors(include_url=False)
    first = problems[0]
    place = place_of((*where, *(str(part) if isinstance(part, str) else part for part in first["loc"])))
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{place}: {sentence(first, model)}{more}"


def validated(
    path: Path, model: type[Model], value: Any, where: tuple[str, ...] = (), *, allow_outside: bool = False
) -> Model:
    """``value`` as a ``model``.

    Args:
        path: of the file, for errors.
        model: what it has to be.
        value: what the file says.
        where: the keys that lead to it.
        allow_outside: see :data:`ALLOW_OUTSIDE`.

    Raises:
        PoseError: the first thing that is wrong, with its place in the file.
    """
    try:
        return model.model_validate(value, context={ALLOW_OUTSIDE: allow_outside})
    except ValidationError as error:
        raise PoseError(f"{path}: {_explained(error, model, where)}") from error


def parsed_json(path: Path, text: str) -> Any:
    """The JSON in the text of a file.

    Raises:
        PoseError: what :func:`omnisyn_cli.io.strict_json.parse_json` refuses.
    """
    try:
        return parse_json(text)
    except ValueError as error:
        raise PoseError(f"{path}: {error}") from error


def place_of(parts: tuple[str | int, ...]) -> str:
    """A JSON path such as ``panoramas.'a.jpg'.position[1]``."""
    text = ""
    for part in parts:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if part.isidentifier() and len(part) <= LONGEST_SHOWN else f"'{part:.{LONGEST_SHOWN}}'"
            text += f".{name}" if text else name
    return text or "top level"


def sentence(problem: Mapping[str, Any], model: type[BaseModel]) -> str:
    """What was expected, what came and what to do about one of pydantic's problems."""
    key = problem["loc"][-1] if problem["loc"] else ""
    match problem["type"]:
        case "extra_forbidden":
            near = difflib.get_close_matches(str(key), model.model_fields, n=1)
            hint = f"did you mean '{near[0]}'?" if near else "remove it"
            known = (
                f"one of the keys {', '.join(model.model_fields)}"
                if len(model.model_fields) <= MOST_LISTED
                else "a known key"
            )
            return f"expected {known}, got '{key!s:.{LONGEST_SHOWN}}'; {hint}"
        case "missing":
            return f"expected the key '{key}', got none; add it"
        case "value_error":
            return f"expected {problem['ctx']['error']}, got {_shown(problem['input'])}; correct it"
        case "dict_type" | "model_type":
            return f"expected an object in braces, got {_shown(problem['input'])}; correct it"
        case "bool_parsing":
            return f"expected true or false, got {_shown(problem['input'])}; correct it"
    wanted = re.sub(r"^(?=greater|less)", "a number ", re.sub(PYDANTICS_OWN, "", problem["msg"]))
    return f"expected {wanted}, got {_shown(problem['input'])}; correct it"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…"
