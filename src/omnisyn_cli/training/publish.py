"""From a checkpoint to a model of the program: exported, compared with torch, entered into the manifest."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.io.paths import replaced_when_complete
from omnisyn_cli.networks.depth import DepthConfig
from omnisyn_cli.networks.export import PARITY, export_depth, export_fusion, export_refine, largest_difference
from omnisyn_cli.networks.fusion import FusionConfig
from omnisyn_cli.networks.paper import PaperConfig
from omnisyn_cli.networks.refine import RefineConfig
from omnisyn_cli.runtime.models import MANIFEST, MANIFEST_VERSION, ModelEntry, read_manifest, sha256_of
from omnisyn_cli.training.data import draw_batch, list_pool
from omnisyn_cli.training.evidence import draw_evidence
from omnisyn_cli.training.frames import forward_batch
from omnisyn_cli.training.fusion import draw_fusion
from omnisyn_cli.training.fusion_losses import inputs_of
from omnisyn_cli.training.joint import Part, parts_of
from omnisyn_cli.training.loop import load_network
from omnisyn_cli.training.tasks import TASKS

__all__ = ["publish", "publish_all", "write_manifest"]

ROLES: Mapping[str, str] = MappingProxyType({"paper": "depth"})
"""What a model is for, by the kind of its network, where that is not the kind itself."""

COMPARED = 3
"""Examples of each kind that torch and ONNX Runtime are compared on."""


def publish(
    checkpoint: Path, folder: Path, *, name: str | None, pool: Path | None, training: str, licence: str
) -> tuple[ModelEntry, float]:
    """Write the averaged network of a checkpoint into a folder of models; see :func:`publish_all`.

    Raises:
        InputError: there is more than one network in it.
    """
    kind = load_network(checkpoint)[1]["kind"]
    if kind == "joint":
        raise InputError(f"expected a checkpoint of one network, got {kind} in {checkpoint}; publish all of it")
    return publish_all(checkpoint, folder, name=name, pool=pool, training=training, licence=licence)[0]


def publish_all(
    checkpoint: Path, folder: Path, *, name: str | None, pool: Path | None, training: str, licence: str
) -> list[tuple[ModelEntry, float]]:
    """Write the averaged networks of a checkpoint into a folder of models, one file each.

    Args:
        checkpoint: of :func:`omnisyn_cli.training.loop.train`.
        folder: gets ``NAME.onnx`` and a new manifest.
        name: ``ROLE-VARIANT`` unless given; of two networks trained together ``NAME-ROLE``.
        pool: scenes to compare on, besides random inputs; of networks trained together only the depth.
        training: on what and for how long, for the manifest.
        licence: of the weights.

    Returns:
        The entries of the manifest, and the largest relative difference found of each.

    Raises:
        InputError: no checkpoint, or no scenes.
        OmnisynError: ONNX Runtime and torch do not agree; nothing is left behind.
    """
    state = load_network(checkpoint)[1]
    parts = parts_of(state)
    options = {"training": training or f"{state['step']} steps", "licence": licence}
    size, scores = tuple(state["training"]["size"]), state.get("scores", {})
    if len(parts) == 1:
        return [_publish(parts[0], folder, name, size, pool, metrics=scores, **options)]
    pools = {"depth": pool}
    return [
        _publish(part, folder, name and f"{name}-{role}", size, pools.get(role), metrics=scores, **options)
        for part, role in zip(parts, map(_role, parts), strict=True)
    ]


def _role(part: Part) -> str:
    return ROLES.get(part.kind, part.kind)


def _publish(
    part: Part, folder: Path, name: str | None, size: tuple[int, int], pool: Path | None, **noted: Any
) -> tuple[ModelEntry, float]:
    """One network; ``noted`` goes into its entry as it is."""
    task, role = TASKS[part.kind], _role(part)
    network = task.build(task.config.from_dict(part.config))
    network.load_state_dict(part.average)
    network.eval()
    name = name or f"{role}-{network.config.name}"
    folder.mkdir(parents=True, exist_ok=True)
    path, partial = folder / f"{name}.onnx", folder / f"{name}.partial.onnx"
    export, examples = EXPORTS[part.kind]
    export(network, partial)
    size = network.config.size if role == "depth" else size
    difference = largest_difference(network, partial, examples(network.config, size, pool))
    if not difference <= PARITY:
        partial.unlink()
        raise OmnisynError(
            f"expected ONNX Runtime to agree with torch within {PARITY}, got {difference:.1e}; not exported"
        )
    partial.replace(path)
    entry = ModelEntry(
        name=name,
        role=role,
        variant=network.config.name,
        file=path.name,
        sha256=sha256_of(path),
        size=(size[0], size[1]),
        parameters=sum(parameter.numel() for parameter in network.parameters()),
        **noted,
    )
    write_manifest(folder, read_manifest(folder) | {name: entry})
    return entry, difference


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
        yield (draw_evidence(list_pool(pool or Path()), rng, 1).planes[:1].numpy(),)


def _fusion_planes(config: FusionConfig, size: tuple[int, int], pool: Path | None) -> Iterator[tuple[np.ndarray, ...]]:
    rng = np.random.default_rng(0)
    for _ in range(COMPARED):
        yield (rng.random((1, config.planes, *size), dtype=np.float32),)
    for _ in range(COMPARED if pool is not None else 0):
        yield (inputs_of(config, draw_fusion(list_pool(pool or Path()), rng, 1).planes).numpy(),)


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
