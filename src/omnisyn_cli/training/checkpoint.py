"""One file with everything to go on training, written so that a kill at any moment leaves a whole one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from omnisyn_cli.errors import InputError, WriteError

REQUIRED_KEYS = frozenset({"kind", "network", "training", "step", "average"})
"""What every checkpoint has, compact or not."""

MAX_REASON_CHARS = 200
"""Characters of what torch says that are passed on."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write beside ``path``, then rename over it.

    Raises WriteError: the disk is full, or the folder went away; the former checkpoint is still there.
    """
    partial = path.with_suffix(path.suffix + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            torch.save(state, file)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except (OSError, RuntimeError) as error:  # torch's own writer raises the latter on a full disk
        partial.unlink(missing_ok=True)
        reason = " ".join(str(error).split())[:MAX_REASON_CHARS]
        raise WriteError(f"{path}: expected to write it, got '{reason}'; check free space and permissions") from error


def compact(state: dict[str, Any]) -> dict[str, Any]:
    """The averaged weights in half precision and what is known about them: an eighth of the checkpoint, to be kept.

    It can be exported, and a run that starts from it goes on with these weights and a fresh optimiser.
    """
    kept: dict[str, Any] = {
        key: state[key] for key in ("kind", "network", "training", "step", "scores", "best") if key in state
    }
    average = {name: value.half() if value.is_floating_point() else value for name, value in state["average"].items()}
    return {**kept, "average": average}


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The state, on the CPU. Only tensors and plain values are accepted: a checkpoint cannot run code.

    Raises InputError: no such file, or no checkpoint.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError(f"expected a checkpoint at {path}, found no file; give the path `train` wrote to") from None
    except UnpicklingError:
        raise InputError(f"expected a checkpoint in {path}, got another file; give the path `train` wrote to") from None
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise InputError(
            f"expected a checkpoint in {path}, got a file torch cannot read: {reason:.{MAX_REASON_CHARS}}"
        ) from error
    if not isinstance(state, dict) or REQUIRED_KEYS - state.keys():
        raise InputError(f"expected a checkpoint in {path}, got other tensors; give the path `train` wrote to")
    return state


@contextmanager
def of_this_version(path: Path) -> Iterator[None]:
    """While a network is made of the checkpoint at ``path``: InputError where it is of another one's settings."""
    try:
        yield
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:MAX_REASON_CHARS]
        raise InputError(
            f"expected a checkpoint of this version's networks in {path}, got '{reason}'; train anew, or use the "
            "version that wrote it"
        ) from error
