"""Text, JSON and NumPy files of other programs, read whole, with errors that name the file and the line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.paths import read_text as read
from omnisyn_cli.io.pose_models import parsed_json

__all__ = ["ForeignModel", "data_lines", "numbers", "read_array", "read_json", "read_text"]

LARGEST_FILE = 1 << 30
"""Bytes; reconstructions carry their point clouds along."""

UNREADABLE_ARRAY = (
    ValueError, EOFError, SyntaxError, TokenError, BadZipFile, RecursionError, MemoryError, TypeError,
    OverflowError,
)  # fmt: skip
"""What NumPy raises for broken headers, sizes beyond all memory and archives."""


class ForeignModel(BaseModel):
    """Part of another program's file: what is not needed here is ignored."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        PoseError: missing, unreadable, too large, or no UTF-8.
    """
    return read(path, "a readable file", LARGEST_FILE, PoseError)


def data_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number (from 1) and text of every line that is neither empty nor a comment (``#``)."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if (text := line.strip()) and not text.startswith("#"):
            yield number, text


def numbers(where: str, fields: Sequence[str], count: int, what: str) -> Float[np.ndarray, " count"]:
    """``count`` finite numbers.

    Raises:
        PoseError: more, fewer, or something else; ``where`` (file and line) begins the message.
    """
    if len(fields) != count:
        raise PoseError(f"{where}: expected {count} numbers ({what}), got {len(fields)} fields; correct the line")
    try:
        values = [float(field) for field in fields]
    except ValueError as error:
        raise PoseError(f"{where}: expected numbers ({what}), got '{error!s:.200}'; correct the line") from error
    if not all(math.isfinite(value) for value in values):
        raise PoseError(f"{where}: expected finite numbers ({what}), got {' '.join(fields):.200}; correct the line")
    return np.array(values)


def read_json(path: Path) -> Any:
    """The JSON of a file.

    Raises:
        PoseError: as :func:`read_text` and :func:`omnisyn_cli.io.pose_models.parsed_json`.
    """
    return parsed_json(path, read_text(path))


def read_array(path: Path) -> Float[np.ndarray, "*shape"]:
    """A ``.npy`` file of finite numbers as float64; pickled objects are refused.

    Raises:
        PoseError: missing, no NumPy array, pickled, no numbers, or NaN and infinity among them.
    """
    try:
        array = np.load(path, allow_pickle=False)
    except OSError as error:
        raise PoseError(f"{path}: expected a NumPy array, got '{error.strerror or error}'; check the name") from error
    except UNREADABLE_ARRAY as error:
        reason = " ".join(f"{error!s:.200}".split())
        raise PoseError(f"{path}: expected a plain NumPy array, got '{reason}'; save it with numpy.save") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        found = f"type {array.dtype}" if isinstance(array, np.ndarray) else "an archive"
        raise PoseError(f"{path}: expected a NumPy array of numbers, got {found}; save it with numpy.save")
    if not np.isfinite(array).all():
        raise PoseError(f"{path}: expected finite numbers, got NaN or infinity; repair it")
    return array.astype(np.float64)
