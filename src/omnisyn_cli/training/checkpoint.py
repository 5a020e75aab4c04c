"""One file with everything to go on training, written so that a kill at any moment leaves a whole one.

Training may begin with an exported network too: it becomes a checkpoint of its weights by name.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from omnisyn_cli.errors import InputError, WriteError
from omnisyn_cli.io.outputs import make_folder, replaced_when_complete
from omnisyn_cli.networks.export import read_weights
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.training.tasks import TASKS, kinds_for, parts_of

# What every checkpoint has, compact or not.
REQUIRED_KEYS = frozenset({"kind", "network", "training", "step", "average"})
# What compact ones keep besides weights, as far as there is any.
KEPT_KEYS = ("kind", "network", "training", "step", "scores", "best", "pool", "curve")
MAX_REASON_CHARS = 200  # Characters of what torch says that are passed on
SYNSIN = "synsin"  # The kind whose network is exported in parts, each with a role of its own: ``synsin-depth``, …


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Replace ``path`` when all is written. WriteError: no space, the former one stays; OutputPathError: no folder."""
    make_folder(path.parent, "a network that is trained")
    try:
        with replaced_when_complete(path) as temporary, temporary.open("wb") as file:
            torch.save(state, file)
            file.flush()
            os.fsync(file.fileno())
    except RuntimeError as error:  # of torch's own writer on a full disk
        raise WriteError(f"{path}: expected to write it, got '{_reason(error)}'; check free space") from error


def _reason(error: Exception) -> str:
    """In one short line."""
    return " ".join(str(error).split())[:MAX_REASON_CHARS]


def compact(state: dict[str, Any]) -> dict[str, Any]:
    """Averaged weights in half precision, an eighth of the checkpoint: to be kept, exported, or begun with anew."""
    average = {name: value.half() if value.is_floating_point() else value for name, value in state["average"].items()}
    return {key: state[key] for key in KEPT_KEYS if key in state} | {"average": average}


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The state, on the CPU; only tensors and plain values, so no code runs. InputError: no file, or no checkpoint."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError(f"expected a checkpoint at {path}, found no file; give the path `train` wrote to") from None
    except UnpicklingError:
        raise InputError(f"expected a checkpoint in {path}, got another file; give the path `train` wrote to") from None
    except Exception as error:
        reason = _reason(error) or type(error).__name__
        raise InputError(f"expected a checkpoint in {path}, got a file torch cannot read: {reason}") from error
    if not isinstance(state, dict) or REQUIRED_KEYS - state.keys():
        raise InputError(f"expected a checkpoint in {path}, got other tensors; give the path `train` wrote to")
    return state


@contextmanager
def of_this_version(path: Path) -> Iterator[None]:
    """While a network is made of the checkpoint at ``path``: InputError where it is of another one's settings."""
    try:
        yield
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(
            f"expected a checkpoint of this version's networks in {path}, got '{_reason(error)}'; train anew, or use "
            "the version that wrote it"
        ) from error


def load_state(path: Path) -> dict[str, Any]:
    """A checkpoint, or one made of an ONNX file that a manifest beside it names; InputError: neither is there."""
    if path.suffix != ".onnx":
        return load_checkpoint(path)
    entries = {entry.file: entry for entry in read_manifest(path.parent).values()}
    if path.name not in entries or not path.is_file():
        raise InputError(f"expected a network of the manifest beside {path}, found none; name another file")
    entry = entries[path.name]
    if entry.role.startswith(SYNSIN):
        kind, found = SYNSIN, dict[str, torch.Tensor]()
        for part in entries.values():
            if part.role.startswith(SYNSIN) and part.variant == entry.variant:
                prefix, weights = part.role.removeprefix(f"{SYNSIN}-"), read_weights(path.parent / part.file)
                found |= {f"{prefix}.{name}": value for name, value in weights.items()}
    else:
        kinds = [kind for kind in kinds_for(entry.role) if entry.variant in TASKS[kind].variants]
        if not kinds:
            what = f"{entry.name}, a {entry.role} network"
            raise InputError(f"expected a network that can be trained, got {what}; name another")
        kind, found = kinds[0], read_weights(path)
    config = TASKS[kind].variants[entry.variant]
    with of_this_version(path):
        own = TASKS[kind].build(config).state_dict()
        average = {name: found[name].reshape(value.shape).to(value.dtype) for name, value in own.items()}
    about = {"training": {"size": entry.size}, "step": 0, "scores": dict(entry.metrics)}
    return {"kind": kind, "network": config.as_dict(), **about, "average": average}


def load_network(path: Path) -> tuple[Any, dict[str, Any]]:
    """The averaged network of a checkpoint or exported file, and its state; InputError: none, or another version's."""
    state = load_state(path)
    if state["kind"] not in TASKS:
        raise InputError(f"expected a checkpoint of kind {' or '.join(TASKS)} in {path}, got kind {state['kind']!r}")
    task = TASKS[state["kind"]]
    with of_this_version(path):
        network = task.build(task.config.from_dict(state["network"]))
        network.load_state_dict(state["average"])
    return network.eval(), state


def part_of(path: Path, kinds: tuple[str, ...]) -> Any:
    """The averaged network of one of these kinds in a checkpoint, joint or not; InputError: it has none."""
    held = parts_of(load_network(path)[0])
    found = [part for kind, part in held.items() if kind in kinds]
    if not found:
        expected, got = " or ".join(kinds), " and ".join(held)
        raise InputError(f"expected a {expected} network in {path}, got {got}; name another checkpoint")
    return found[0]
