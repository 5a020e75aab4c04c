"""What each kind of network is taught, and how it is judged: all that the training loop needs to know of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.depth import DepthConfig, DepthNetwork
from omnisyn_cli.networks.refine import RefineConfig, RefineNetwork
from omnisyn_cli.training.data import Augmentation, draw_batch, list_pool
from omnisyn_cli.training.evidence import draw_evidence, load_evidence
from omnisyn_cli.training.losses import DepthScores, depth_loss, depth_scores, refine_loss

__all__ = ["TASKS", "NetworkConfig", "Task", "TrainConfig", "task_named", "task_of"]

VALIDATION_SEED = 1

NetworkConfig = DepthConfig | RefineConfig


@dataclass(frozen=True)
class TrainConfig:
    """One stage of training; a later stage may change any of it.

    Attributes:
        pool, validation_pool: folders of scenes, see :mod:`omnisyn_cli.training.data` and
            :mod:`omnisyn_cli.training.evidence`.
        size: of the images, a whole fraction of the pool's.
        batch: pairs per step.
        rate: learning rate after the warm-up.
        warmup_steps: steps over which the rate rises from zero.
        cooldown_steps: 0, or the number of steps over which the rate falls to zero, counted from the first step of this
            call; then training ends.
        weight_decay, clip: of AdamW, and the greatest norm of a gradient.
        ema: decay of the average per step (smaller at the beginning).
        seed: of the weights and of all batches.
        validate_every, save_every: in steps.
        validation_pairs: how many pairs are scored.
    """

    pool: str
    validation_pool: str
    size: tuple[int, int] = (256, 512)
    batch: int = 4
    rate: float = 6e-4
    warmup_steps: int = 200
    cooldown_steps: int = 0
    weight_decay: float = 1e-4
    clip: float = 1.0
    ema: float = 0.998
    seed: int = 0
    validate_every: int = 250
    save_every: int = 50
    validation_pairs: int = 32


@dataclass(frozen=True)
class Task:
    """A kind of network.

    Attributes:
        config: class of its configuration, with ``as_dict`` and ``from_dict``.
        build: a fresh network of a configuration.
        loss: of a network on a batch drawn from a pool, a scalar.
        validate: figures of a network on fixed pairs without augmentation, the mean over pairs.
    """

    config: type[Any]
    build: Callable[[Any], Any]
    loss: Callable[[Any, list[Path], np.random.Generator, TrainConfig], Tensor]
    validate: Callable[[Any, TrainConfig], dict[str, float]]


def _depth_loss(network: DepthNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig) -> Tensor:
    batch = draw_batch(pool, rng, config.batch, config.size, Augmentation(), network.config.greatest_root)
    return depth_loss(network(batch.first, batch.second), batch.root)


@torch.no_grad()
def _validate_depth(network: DepthNetwork, config: TrainConfig) -> dict[str, float]:
    pool = list_pool(Path(config.validation_pool))
    scores = []
    for index in range(config.validation_pairs):
        rng = np.random.default_rng([VALIDATION_SEED, index])
        scene = pool[index % len(pool)]
        batch = draw_batch([scene], rng, 1, config.size, greatest_root=network.config.greatest_root)
        scores.append(depth_scores(network(batch.first, batch.second), batch.root, batch.baseline))
    return _mean(scores)


def _refine_loss(network: RefineNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig) -> Tensor:
    batch = draw_evidence(pool, rng, config.batch)
    return refine_loss(network(batch.planes), batch.root)


@torch.no_grad()
def _validate_refine(network: RefineNetwork, config: TrainConfig) -> dict[str, float]:
    pool = list_pool(Path(config.validation_pool))
    scores = []
    for index in range(config.validation_pairs):
        pair = load_evidence(pool[index % len(pool)])[index // len(pool) % 2]
        planes = torch.from_numpy(pair.planes)[None]
        root, baseline = torch.from_numpy(pair.root)[None, None], torch.tensor([pair.baseline])
        scores.append(depth_scores(network(planes), root, baseline))
    return _mean(scores)


def _mean(scores: list[DepthScores]) -> dict[str, float]:
    """Over pairs; NaN, as of pairs without sky, is left out."""
    rows = torch.tensor([list(asdict(score).values()) for score in scores])
    return asdict(DepthScores(*rows.nanmean(dim=0).tolist()))


TASKS: Mapping[str, Task] = MappingProxyType(
    {
        "depth": Task(DepthConfig, DepthNetwork, _depth_loss, _validate_depth),
        "refine": Task(RefineConfig, RefineNetwork, _refine_loss, _validate_refine),
    }
)
"""By the kind that a checkpoint names."""


def task_of(config: NetworkConfig) -> str:
    """The kind of network that a configuration belongs to."""
    return next(kind for kind, task in TASKS.items() if isinstance(config, task.config))


def task_named(kind: object, path: Path) -> Task:
    """The task of a checkpoint.

    Raises:
        InputError: there is no such kind.
    """
    if kind not in TASKS:
        raise InputError(f"expected a checkpoint of kind {' or '.join(TASKS)} in {path}, got kind {kind!r}")
    return TASKS[str(kind)]
