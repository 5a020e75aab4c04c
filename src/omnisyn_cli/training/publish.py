"""From a checkpoint to a model of the program: exported, compared with torch, entered into the manifest."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.io.paths import check_output, make_folder, replaced_when_complete
from omnisyn_cli.networks.depth_config import DepthConfig
from omnisyn_cli.networks.export import (
    PARITY,
    export_depth,
    export_fusion,
    export_refine,
    export_synsin,
    largest_difference,
)
from omnisyn_cli.networks.fusion import FusionConfig
from omnisyn_cli.networks.paper import PaperConfig
from omnisyn_cli.networks.refine import RefineConfig
from omnisyn_cli.networks.synsin import SynSinNetwork
from omnisyn_cli.runtime.models import MANIFEST, MANIFEST_VERSION, ModelEntry, read_manifest, sha256_of
from omnisyn_cli.training.data import draw_batch, list_pool
from omnisyn_cli.training.evidence import draw_evidence
from omnisyn_cli.training.frames import forward_batch
from omnisyn_cli.training.fusion import draw_fusion
from omnisyn_cli.training.fusion_losses import inputs_of
from omnisyn_cli.training.joint import Part, parts_of
from omnisyn_cli.training.lessons import draw_lessons
from omnisyn_cli.training.loop import load_network
from omnisyn_cli.training.synsin import blend_points
from omnisyn_cli.training.tasks import TASKS

__all__ = ["publish", "write_manifest"]

ROLES: Mapping[str, str] = MappingProxyType({"paper": "depth"})
"""What a model is for, by the kind of its network, where that is not the kind itself."""

COLOURS = 3
"""Channels of a panorama."""

COMPARED = 3
"""Examples of each kind that torch and ONNX Runtime are compared on."""


@dataclass(frozen=True)
class _Part:
    """A network of a checkpoint that becomes a file of its own."""

    name: str
    role: str
    variant: str
    network: Any
    size: tuple[int, int]
    export: Callable[[Any, Path], None]
    examples: Iterator[tuple[np.ndarray, ...]]


def publish(
    checkpoint: Path,
    folder: Path,
    *,
    name: str | None,
    pool: Path | None,
    training: str,
    licence: str,
    overwrite: bool = False,
) -> list[tuple[ModelEntry, float]]:
    """Write the averaged networks of a checkpoint into a folder of models: one, two trained jointly, or SynSin's three.

    Args:
        checkpoint: of :func:`omnisyn_cli.training.loop.train`.
        folder: gets ``NAME.onnx`` (of several networks ``NAME-ROLE.onnx``) and a new manifest.
        name: ``ROLE-VARIANT`` unless given (``synsin``).
        pool: scenes to compare on, besides random inputs; of networks trained together only the depth.
        training: on what and for how long, for the manifest.
        licence: of the weights.
        overwrite: replace models of the same names.

    Returns:
        The entries of the manifest, each with the largest relative difference found.

    Raises:
        InputError: no checkpoint, no scenes, or a name that is a path.
        OutputPathError: there is a model of that name already.
        OmnisynError: ONNX Runtime and torch do not agree; nothing is left behind.
    """
    if name is not None and Path(name).name != name:
        raise InputError(f"expected a name without folders, got {name!r}; choose another (--name)")
    network, state = load_network(checkpoint)
    parts = _parts(network, state, name, pool)
    make_folder(folder, "models")
    for part in parts:
        check_output(folder / f"{part.name}.onnx", overwrite)
    partials = [folder / f"{part.name}.partial.onnx" for part in parts]
    try:
        differences = [_exported(part, partial) for part, partial in zip(parts, partials, strict=True)]
        if not max(differences) <= PARITY:
            raise OmnisynError(
                f"expected ONNX Runtime to agree with torch within {PARITY}, got {max(differences):.1e}; not exported: "
                "train it longer, weights of the first steps may answer with nothing but rounding"
            )
        for part, partial in zip(parts, partials, strict=True):
            partial.replace(folder / f"{part.name}.onnx")
    finally:
        for partial in partials:
            partial.unlink(missing_ok=True)
    entries = [_entry(part, folder / f"{part.name}.onnx", state, training, licence) for part in parts]
    write_manifest(folder, read_manifest(folder) | {entry.name: entry for entry in entries})
    return list(zip(entries, differences, strict=True))


def _entry(part: _Part, path: Path, state: Mapping[str, Any], training: str, licence: str) -> ModelEntry:
    """What the manifest says about an exported network."""
    return ModelEntry(
        name=part.name,
        role=part.role,
        variant=part.variant,
        file=path.name,
        sha256=sha256_of(path),
        size=part.size,
        parameters=sum(parameter.numel() for parameter in part.network.parameters()),
        training=training or f"{state['step']} steps",
        licence=licence,
        metrics=state.get("scores", {}),
    )


def _exported(part: _Part, path: Path) -> float:
    part.export(part.network, path)
    return largest_difference(part.network, path, part.examples)


def _parts(network: Any, state: Mapping[str, Any], name: str | None, pool: Path | None) -> list[_Part]:
    if state["kind"] == "synsin":
        return _synsin_parts(network, name or "synsin", pool)
    held, size = parts_of(dict(state)), tuple(state["training"]["size"])
    if len(held) == 1:
        return [_part(held[0], name, size, pool)]
    roles = [ROLES.get(part.kind, part.kind) for part in held]
    return [
        _part(part, name and f"{name}-{role}", size, pool if role == "depth" else None)
        for part, role in zip(held, roles, strict=True)
    ]


def _part(held: Part, name: str | None, size: tuple[int, int], pool: Path | None) -> _Part:
    """One network, with its averaged weights."""
    task, role = TASKS[held.kind], ROLES.get(held.kind, held.kind)
    network = task.build(task.config.from_dict(held.config))
    network.load_state_dict(held.average)
    network.eval()
    config = network.config
    height, width = config.size if role == "depth" else size
    export, examples = EXPORTS[held.kind]
    made = examples(config, (height, width), pool)
    return _Part(name or f"{role}-{config.name}", role, config.name, network, (height, width), export, made)


def _synsin_parts(network: SynSinNetwork, name: str, pool: Path | None) -> list[_Part]:
    """Depth, encoder and decoder."""
    config = network.config
    inputs = {"depth": 3, "encoder": 3, "decoder": config.features + 1}
    return [
        _Part(
            f"{name}-{part}", f"synsin-{part}", config.name, getattr(network, part), config.size, export_synsin,
            _synsin_examples(network, channels, pool),
        )
        for part, channels in inputs.items()
    ]  # fmt: skip


def _synsin_examples(network: SynSinNetwork, channels: int, pool: Path | None) -> Iterator[tuple[np.ndarray, ...]]:
    """Noise, and panoramas of a pool or what the decoder would see of them."""
    rng, size = np.random.default_rng(0), network.config.size
    for _ in range(COMPARED):
        yield (rng.random((1, channels, *size), dtype=np.float32),)
    lessons = draw_lessons(list_pool(pool), rng, COMPARED, size) if pool is not None else []
    for lesson in lessons:
        yield (lesson.images[:1].numpy() if channels == COLOURS else blend_points(network, lesson)[None].numpy(),)


def write_manifest(folder: Path, entries: Mapping[str, ModelEntry]) -> None:
    """Write ``manifest.toml``, the inverse of :func:`omnisyn_cli.runtime.models.read_manifest`."""
    lines = [f"version = {MANIFEST_VERSION}"]
    for entry in entries.values():
        lines += ["", "[[models]]"]
        plain = [key.name for key in fields(entry) if key.name != "metrics"]
        lines += [f"{key} = {json.dumps(getattr(entry, key), ensure_ascii=False)}" for key in plain]
        if entry.metrics:
            lines += ["", "[models.metrics]", *(f"{key} = {value!r}" for key, value in entry.metrics.items())]
    with replaced_when_complete(folder / MANIFEST) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _pairs(_config: DepthConfig, size: tuple[int, int], pool: Path | None) -> Iterator[tuple[np.ndarray, ...]]:
    rng = np.random.default_rng(0)
    for _ in range(COMPARED):
        yield tuple(rng.random((2, 1, 3, *size), dtype=np.float32))
    for _ in range(COMPARED if pool is not None else 0):
        batch = draw_batch(list_pool(pool or Path()), rng, 1, size)
        yield batch.first.numpy(), batch.second.numpy()


def _paper_pairs(_config: PaperConfig, size: tuple[int, int], pool: Path | None) -> Iterator[tuple[np.ndarray, ...]]:
    rng = np.random.default_rng(0)
    for _ in range(COMPARED):
        yield tuple(rng.random((2, 1, 3, *size), dtype=np.float32))
    for _ in range(COMPARED if pool is not None else 0):
        batch = forward_batch(draw_batch(list_pool(pool or Path()), rng, 1, (size[0], 2 * size[0])), size)
        yield batch.first.numpy(), batch.second.numpy()


def _planes(config: RefineConfig, size: tuple[int, int], pool: Path | None) -> Iterator[tuple[np.ndarray, ...]]:
    rng = np.random.default_rng(0)
    for _ in range(COMPARED):
        yield (rng.random((1, config.planes, *size), dtype=np.float32),)
    for _ in range(COMPARED if pool is not None else 0):
        yield (draw_evidence(list_pool(pool or Path(), "evidence"), rng, 1).planes[:1].numpy(),)


def _fusion_planes(config: FusionConfig, size: tuple[int, int], pool: Path | None) -> Iterator[tuple[np.ndarray, ...]]:
    rng = np.random.default_rng(0)
    for _ in range(COMPARED):
        yield (rng.random((1, config.planes, *size), dtype=np.float32),)
    for _ in range(COMPARED if pool is not None else 0):
        yield (inputs_of(config, draw_fusion(list_pool(pool or Path(), "fusion-pool"), rng, 1).planes).numpy(),)


EXPORTS: Mapping[str, tuple[Callable[[Any, Path], None], Callable[..., Iterator[tuple[np.ndarray, ...]]]]] = (
    MappingProxyType(
        {
            "depth": (export_depth, _pairs),
            "paper": (export_depth, _paper_pairs),
            "refine": (export_refine, _planes),
            "fusion": (export_fusion, _fusion_planes),
        }
    )
)
"""By the kind of network: how it is written, and what it is compared on."""
