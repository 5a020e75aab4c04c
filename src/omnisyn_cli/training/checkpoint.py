"""One file with everything to go on training, written so that a kill at any moment leaves a whole one.

It becomes a model of the program: exported, compared with torch, entered into the manifest. Training may begin with an
exported network too: it becomes a checkpoint of its weights by name.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch

from omnisyn_cli.errors import InputError, OmnisynError, WriteError
from omnisyn_cli.io.outputs import check_output, make_folder, replaced_when_complete, staged_folder, write_parts
from omnisyn_cli.networks.export import PARITY, export_network, largest_difference, read_weights
from omnisyn_cli.networks.interface import Network
from omnisyn_cli.networks.synsin import SynSinNetwork
from omnisyn_cli.runtime.models import MANIFEST, ModelEntry, manifest_text, read_manifest, sha256_of
from omnisyn_cli.training.data import list_scene_files
from omnisyn_cli.training.synsin import blend_points, draw_views
from omnisyn_cli.training.tasks import TASKS, Task, TrainConfig, kinds_for, parts_of, role_of

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


COMPARED_EXAMPLES = 3  # Examples of each kind that torch and ONNX Runtime are compared on

Examples = Iterator[tuple[np.ndarray, ...]]
Part = tuple[str, str, Network, tuple[int, int], Examples]  # What becomes a file: name, role, network, size, examples.


def publish(
    checkpoint: Path, folder: Path, *, name: str | None = None, pool: Path | None = None, training: str = "",
    licence: str = "Apache-2.0", overwrite: bool = False,
) -> list[tuple[ModelEntry, float]]:  # fmt: skip
    """Write the averaged networks of a checkpoint into a folder of models: one, two trained jointly, or SynSin's three.

    The folder gets ``NAME.onnx`` (of several ``NAME-ROLE.onnx``; the name is ``ROLE-VARIANT`` or ``synsin`` unless
    given) and a new manifest, which says on what they were trained (``training``). They are compared with torch on
    noise and scenes of a ``pool``. Returns their entries, each with the largest relative difference.

    InputError: no checkpoint, no scenes, or a name that is a path; OutputPathError: there is such a model already;
    OmnisynError: ONNX Runtime and torch do not agree, and nothing is left behind.
    """
    if name is not None and Path(name).name != name:
        raise InputError(f"expected a name without folders, got {name!r}; choose another (--name)")
    network, state = load_network(checkpoint)
    return publish_parts(
        _parts(network, state, name, pool), folder, training=training or f"{state['step']} steps", licence=licence,
        metrics=state.get("scores", {}), overwrite=overwrite,
    )  # fmt: skip


def publish_parts(
    parts: Sequence[Part], folder: Path, *, training: str, licence: str, metrics: Mapping[str, float], overwrite: bool
) -> list[tuple[ModelEntry, float]]:
    """Write networks and a new manifest into a folder of models; returns and raises what :func:`publish` does."""
    make_folder(folder, "models")
    for own_name, *_ in parts:
        check_output(folder / f"{own_name}.onnx", overwrite)
    with staged_folder(folder, overwrite=overwrite) as staged:
        made = []
        for own_name, role, part, size, examples in parts:
            file = staged / f"{own_name}.onnx"
            export_network(part, file)
            entry = ModelEntry(
                own_name, role, variant=part.config.name, file=file.name, sha256=sha256_of(file), size=size,
                parameters=sum(parameter.numel() for parameter in part.parameters()),
                training=training, licence=licence, metrics=metrics,
            )  # fmt: skip
            made.append((entry, largest_difference(part, file, examples)))
        worst = max(difference for _, difference in made)
        if not worst <= PARITY:
            raise OmnisynError(
                f"expected ONNX Runtime to agree with torch within {PARITY}, got {worst:.1e}; not exported: "
                "train it longer, weights of the first steps may answer with nothing but rounding"
            )
    entries = read_manifest(folder) | {entry.name: entry for entry, _ in made}
    write_parts(folder / MANIFEST, [manifest_text(entries).encode()])
    return made


def _parts(network: Any, state: Mapping[str, Any], name: str | None, pool: Path | None) -> list[Part]:
    held: dict[str, Any]
    if isinstance(network, SynSinNetwork):
        held, size = dict(network.named_children()), network.config.size
        return [
            (f"{name or 'synsin'}-{word}", f"synsin-{word}", part, size, _views(network, part, pool))
            for word, part in held.items()
        ]
    held, parts = parts_of(network), list[Part]()
    for kind, part in held.items():
        role, size = role_of(kind), part.ports.size or tuple(state["training"]["size"])
        own = f"{name}-{role}" if name and len(held) > 1 else name
        shown = _examples(TASKS[kind], part, size, pool if len(held) == 1 or role == "depth" else None)
        parts.append((own or f"{role}-{part.config.name}", role, part, size, shown))
    return parts


def _examples(task: Task, network: Network, size: tuple[int, int], pool: Path | None) -> Examples:
    """Noise, and what the network would be judged by in a pool."""
    yield from noise(network, size)
    if pool is not None:
        stage = TrainConfig(str(pool), str(pool), size=size, validation_pairs=COMPARED_EXAMPLES)
        for batch in task.validation(network, stage):
            yield tuple(value[:1].numpy() for value in task.inputs(network, batch))


def _views(network: SynSinNetwork, part: Network, pool: Path | None) -> Examples:
    """Noise, and panoramas of a pool or what the decoder would see of them."""
    yield from noise(part, network.config.size)
    rng, size = np.random.default_rng(0), network.config.size
    samples = draw_views(list_scene_files(pool), rng, COMPARED_EXAMPLES, size) if pool else []
    for sample in samples:
        yield (blend_points(network, sample)[None].numpy() if part is network.decoder else sample.images[:1].numpy(),)


def noise(network: Network, size: tuple[int, int]) -> Examples:
    """Of the trained size; where the file takes any, of half of it and a little more as well."""
    rng, height, multiple = np.random.default_rng(0), size[0], network.config.size_multiple
    half, more = max(multiple, height // 2 // multiple * multiple), height + multiple
    free = [(rows, 2 * rows) for rows in (height, half, more)]
    for shape in free if network.ports.size is None else [size] * COMPARED_EXAMPLES:
        inputs = network.ports.input_shapes(shape).values()
        yield tuple(rng.random((1, *each), dtype=np.float32) for each in inputs)
