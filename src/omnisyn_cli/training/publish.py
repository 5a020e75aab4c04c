"""From a checkpoint to a model of the program: exported, compared with torch, entered into the manifest."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.io.outputs import check_output, make_folder, staged_folder, write_parts
from omnisyn_cli.networks.export import PARITY, export_network, largest_difference
from omnisyn_cli.networks.interface import Network
from omnisyn_cli.networks.synsin import SynSinNetwork
from omnisyn_cli.runtime.models import MANIFEST, ModelEntry, manifest_text, read_manifest, sha256_of
from omnisyn_cli.training.checkpoint import load_network
from omnisyn_cli.training.data import list_scene_files
from omnisyn_cli.training.synsin import blend_points, draw_views
from omnisyn_cli.training.tasks import TASKS, Task, TrainConfig, parts_of, role_of

COMPARED_EXAMPLES = 3  # Examples of each kind that torch and ONNX Runtime are compared on

Examples = Iterator[tuple[np.ndarray, ...]]


@dataclass(frozen=True)
class Part:
    """A network that becomes a file of its own."""

    name: str
    role: str
    network: Network
    size: tuple[int, int]
    examples: Examples


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
    parts = _parts(network, state, name, pool)
    return publish_parts(
        parts, folder, training=training or f"{state['step']} steps", licence=licence, metrics=state.get("scores", {}),
        overwrite=overwrite,
    )  # fmt: skip


def publish_parts(
    parts: Sequence[Part], folder: Path, *, training: str, licence: str, metrics: Mapping[str, float], overwrite: bool
) -> list[tuple[ModelEntry, float]]:
    """Write networks and a new manifest into a folder of models; returns and raises what :func:`publish` does."""
    make_folder(folder, "models")
    for part in parts:
        check_output(folder / f"{part.name}.onnx", overwrite)
    with staged_folder(folder, overwrite=overwrite) as staged:
        made = []
        for part in parts:
            file = staged / f"{part.name}.onnx"
            export_network(part.network, file)
            entry = ModelEntry(
                part.name, part.role, variant=part.network.config.name, file=file.name, sha256=sha256_of(file),
                size=part.size, parameters=sum(parameter.numel() for parameter in part.network.parameters()),
                training=training, licence=licence, metrics=metrics,
            )  # fmt: skip
            made.append((entry, largest_difference(part.network, file, part.examples)))
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
            Part(f"{name or 'synsin'}-{word}", f"synsin-{word}", part, size, _views(network, part, pool))
            for word, part in held.items()
        ]
    held, parts = parts_of(network), []
    for kind, part in held.items():
        role, size = role_of(kind), part.ports.size or tuple(state["training"]["size"])
        own = f"{name}-{role}" if name and len(held) > 1 else name
        shown = _examples(TASKS[kind], part, size, pool if len(held) == 1 or role == "depth" else None)
        parts.append(Part(own or f"{role}-{part.config.name}", role, part, size, shown))
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
