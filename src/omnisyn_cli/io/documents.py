"""Text and JSON files that users and other programs write, read whole, and what is wrong with them said in one line.

Files of one JSON object in each line are those of runs that may be killed at any moment, and go on with them.
"""

import difflib
import json
import os
import re
import stat
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Never, TypeVar
from xml.etree.ElementTree import Element, ParseError, fromstring

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.io.outputs import write_errors

Model = TypeVar("Model", bound=BaseModel)

MAX_DOCUMENT_BYTES = 1 << 30  # a gigabyte: reconstructions carry their point clouds along
MAX_SHOWN_CHARS = 60  # of a value that a message quotes
MAX_LISTED_KEYS = 20  # keys of a model that a message names when another came
# Parts of pydantic's messages that do not say what was expected.
PYDANTIC_PHRASES = (
    r"^(Input|List|Dictionary|String) should (be|have) | after validation, .*|, unable to .*"
    r"|, got a number with a fractional part"
)


class ForeignModel(BaseModel):
    """Part of another program's file: what is not needed here is ignored."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)


def expected(what: str, holds: Callable[[Any], object]) -> AfterValidator:
    """A condition of a value in a file that users write, and the words of its error."""

    def checked(value: Any) -> Any:
        if not holds(value):
            raise ValueError(what)
        return value

    return AfterValidator(checked)


class _DisagreementError(Exception):
    """What JSON readers disagree on; no ``ValueError``, which the reader takes for its own."""


def read_text(
    path: Path, what: str = "a readable file", largest: int = MAX_DOCUMENT_BYTES, error: type[InputError] = PoseError
) -> str:
    """The text of a file that users write, in UTF-8 with or without a byte order mark.

    Every end of a line is a line feed. What is missing, unreadable, a device, larger than ``largest`` bytes or no UTF-8
    raises ``error``, which expects ``what``.
    """
    try:
        status = path.stat()
        if stat.S_ISCHR(status.st_mode) or stat.S_ISBLK(status.st_mode):
            raise error(f"{path}: expected {what}, got a device; check the name")
        if status.st_size > largest:
            raise error(f"{path}: expected at most {largest:,} bytes, got {status.st_size:,}; split the file")
        with path.open("rb") as file:
            data = file.read(largest + 1)  # a pipe does not say beforehand how much there is
        if len(data) > largest:
            raise error(f"{path}: expected at most {largest:,} bytes, got more; split the file")
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except OSError as failure:
        raise error(f"{path}: expected {what}, got '{failure.strerror}'; check the name") from failure
    except ValueError as failure:
        raise error(f"{path}: expected {what} in UTF-8, got '{failure}'; check name and encoding") from failure


def read_file_itself(path: Path) -> bytes | None:
    """What is in a file; None where there is none, or a link or something else in its place."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return None
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    except OSError:
        return None
    with os.fdopen(descriptor, "rb") as file:
        return file.read()


def read_json(path: Path, what: str = "a readable file", largest: int = MAX_DOCUMENT_BYTES) -> Any:
    """The JSON of a file; PoseError: as :func:`read_text`, and what :func:`parse_json` refuses."""
    try:
        return parse_json(read_text(path, what, largest, PoseError))
    except ValueError as error:
        raise PoseError(f"{path}: {error}") from error


def read_xml(path: Path) -> Element:
    """The root of an XML file; PoseError: as :func:`read_text`, no XML, or declarations of entities, as in attacks."""
    text = read_text(path)
    try:
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise ParseError("a declaration of entities")
        return fromstring(text)  # noqa: S314 - there are no entities in it
    except (ParseError, ValueError) as error:
        raise PoseError(f"{path}: expected XML, got '{error}'; correct it there, or export it anew") from error


def parse_json(text: str) -> Any:
    """The value that a text says. ValueError: no JSON, or repeated keys, NaN or infinity: readers disagree there."""
    try:
        return json.loads(text, object_pairs_hook=_once, parse_constant=_refuse)
    except _DisagreementError as error:
        raise ValueError(str(error)) from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"expected JSON, got '{error}'; correct it there") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    seen: dict[str, Any] = {}
    for key, value in pairs:
        if key in seen:
            raise _DisagreementError(f"expected every key once, got '{key:.60}' twice in one object; remove one")
        seen[key] = value
    return seen


def _refuse(constant: str) -> Never:
    raise _DisagreementError(f"expected finite numbers, got {constant}; write a number")


def validated(path: Path, model: type[Model], value: Any, where: tuple[str, ...] = (), **context: Any) -> Model:
    """What a file says below the keys ``where`` as a ``model``, in a context of the validation.

    A PoseError says the first thing that is wrong, with its place in the file, and how many more there are.
    """
    try:
        return model.model_validate(value, context=context)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        place = json_path((*where, *problems[0]["loc"]))
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise PoseError(f"{path}: {place}: {problem_sentence(problems[0], model)}{more}") from error


def json_path(parts: tuple[str | int, ...]) -> str:
    """A JSON path such as ``panoramas.'a.jpg'.position[1]``."""
    text = ""
    for part in parts:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if part.isidentifier() and len(part) <= MAX_SHOWN_CHARS else f"'{part:.{MAX_SHOWN_CHARS}}'"
            text += f".{name}" if text else name
    return text or "top level"


def problem_sentence(problem: Mapping[str, Any], model: type[BaseModel]) -> str:
    """What was expected, what came and what to do about one of pydantic's problems."""
    key = problem["loc"][-1] if problem["loc"] else ""
    match problem["type"]:
        case "extra_forbidden":
            near = difflib.get_close_matches(str(key), model.model_fields, n=1)
            hint = f"did you mean '{near[0]}'?" if near else "remove it"
            known = (
                f"one of the keys {', '.join(model.model_fields)}"
                if len(model.model_fields) <= MAX_LISTED_KEYS
                else "a known key"
            )
            return f"expected {known}, got '{key!s:.{MAX_SHOWN_CHARS}}'; {hint}"
        case "missing":
            return f"expected the key '{key}', got none; add it"
        case "value_error":
            return f"expected {problem['ctx']['error']}, got {_shown(problem['input'])}; correct it"
        case "dict_type" | "model_type":
            return f"expected an object in braces, got {_shown(problem['input'])}; correct it"
        case "bool_parsing":
            return f"expected true or false, got {_shown(problem['input'])}; correct it"
    wanted = re.sub(r"^(?=greater|less)", "a number ", re.sub(PYDANTIC_PHRASES, "", problem["msg"]))
    return f"expected {wanted}, got {_shown(problem['input'])}; correct it"


def listed(names: Iterable[str], most: int = 5) -> str:
    """Some names for a message."""
    quoted = [f"'{name:.{MAX_SHOWN_CHARS}}'" for name in names]
    return ", ".join(quoted[:most]) + (f" and {len(quoted) - most} more" if len(quoted) > most else "")


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MAX_SHOWN_CHARS else f"{text[:MAX_SHOWN_CHARS]}…"


def append_line(path: Path, value: Any) -> None:
    """Add a line that has reached the disk when this returns; what a killed run left of one is removed first.

    ValueError: a number is infinite or undefined. WriteError: the disk is full, or the folder went away.
    """
    line = json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n"
    with write_errors(path), path.open("a+b") as file:
        _drop_unfinished_line(file)
        file.write(line.encode("utf-8", "backslashreplace"))
        file.flush()
        os.fsync(file.fileno())


def complete_lines(path: Path) -> list[str]:
    """All lines but what a killed run left of one; none without a file. InputError: the file cannot be read."""
    if not path.exists():
        return []
    try:
        complete, _, _ = path.read_bytes().rpartition(b"\n")  # what was cut short may end inside a character
        return complete.decode("utf-8").split("\n") if complete else []
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected results of an earlier run, got '{error}'; name another folder") from error


def _drop_unfinished_line(file: BinaryIO) -> None:
    end = file.seek(0, os.SEEK_END)
    if end == 0:
        return
    file.seek(end - 1)
    if file.read(1) != b"\n":
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)
        file.seek(0, os.SEEK_END)


class Keyframe(ForeignModel):
    """Where the picture looks at a share of the video; degrees from the first panorama's centre, level."""

    at: Annotated[float, Field(ge=0, le=1)]
    yaw: Annotated[float, Field(ge=-3600, le=3600)]
    pitch: Annotated[float, Field(ge=-90, le=90)] = 0.0


class Keyframes(ForeignModel):
    """The file: a list of them, which may stand under one key."""

    keyframes: Annotated[list[Keyframe], Field(min_length=1)]


def read_keyframes(path: Path) -> list[Keyframe]:
    """The keyframes of a file, in the order of time; PoseError: missing, malformed or empty."""
    document = read_json(path, "keyframes")
    known = validated(path, Keyframes, {"keyframes": document} if isinstance(document, list) else document)
    return sorted(known.keyframes, key=lambda key: key.at)
