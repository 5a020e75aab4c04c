"""Training that begins with an exported network: its weights by name, as a checkpoint has them."""

from pathlib import Path
from typing import Any

import torch

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.export import read_weights
from omnisyn_cli.runtime.models import ModelEntry, read_manifest
from omnisyn_cli.training.checkpoint import load_checkpoint, of_this_version
from omnisyn_cli.training.tasks import TASKS, kinds_for

SYNSIN = "synsin"
"""The kind whose network is exported in parts, each with a role of its own: ``synsin-depth``, …"""


def load_state(path: Path) -> dict[str, Any]:
    """A checkpoint, or one made of an ONNX file of a folder with a manifest.

    Raises InputError: no such file, no checkpoint, or an ONNX file that the manifest beside it does not name.
    """
    if path.suffix != ".onnx":
        return load_checkpoint(path)
    entries = {entry.file: entry for entry in read_manifest(path.parent).values()}
    if path.name not in entries or not path.is_file():
        raise InputError(f"expected a network of the manifest beside {path}, found none; name another file")
    entry = entries[path.name]
    kind = SYNSIN if entry.role.startswith(SYNSIN) else _kind(entry)
    config = TASKS[kind].variants[entry.variant]
    found: dict[str, torch.Tensor] = {}
    for part in entries.values():
        if part == entry and kind != SYNSIN:
            found |= read_weights(path)
        elif kind == SYNSIN and part.role.startswith(SYNSIN) and part.variant == entry.variant:
            prefix = part.role.removeprefix(f"{SYNSIN}-")
            found |= {f"{prefix}.{name}": value for name, value in read_weights(path.parent / part.file).items()}
    with of_this_version(path):
        own = TASKS[kind].build(config).state_dict()
        average = {name: found[name].reshape(value.shape).to(value.dtype) for name, value in own.items()}
    about = {"training": {"size": entry.size}, "step": 0, "scores": dict(entry.metrics)}
    return {"kind": kind, "network": config.as_dict(), **about, "average": average}


def _kind(entry: ModelEntry) -> str:
    for kind in kinds_for(entry.role):
        if entry.variant in TASKS[kind].variants:
            return kind
    raise InputError(f"expected a network that can be trained, got {entry.name}, a {entry.role} network; name another")
