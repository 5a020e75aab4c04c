"""What each kind of network is taught, and how it is judged: all that the training loop needs to know of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import Module

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.depth import DepthNetwork
from omnisyn_cli.networks.depth_config import DepthConfig
from omnisyn_cli.networks.discriminator import PatchDiscriminator
from omnisyn_cli.networks.fusion import FusionConfig, FusionNetwork, PaintingNetwork, build_fusion
from omnisyn_cli.networks.joint import JointConfig, JointNetwork
from omnisyn_cli.networks.paper import PaperConfig, PaperNetwork
from omnisyn_cli.networks.refine import RefineConfig, RefineNetwork
from omnisyn_cli.networks.synsin import SynSinConfig, SynSinNetwork
from omnisyn_cli.training.adversarial import Contest
from omnisyn_cli.training.data import Augmentation, Batch, draw_batch, list_pool
from omnisyn_cli.training.evidence import draw_evidence, load_evidence
from omnisyn_cli.training.frames import forward_batch
from omnisyn_cli.training.fusion import draw_fusion, load_fusion
from omnisyn_cli.training.fusion_losses import FusionScores, fused_by, fusion_loss, fusion_scores
from omnisyn_cli.training.joint import joint_answer, joint_loss
from omnisyn_cli.training.lessons import draw_lessons
from omnisyn_cli.training.losses import DepthScores, depth_loss, depth_scores, paper_loss, refine_loss
from omnisyn_cli.training.pictures import depth_pictures, fused_pictures
from omnisyn_cli.training.synsin import contest_losses, make_pictures, own_loss, show_synsin, validate_synsin
from omnisyn_cli.training.triples import Triples, draw_triples

__all__ = ["TASKS", "NetworkConfig", "Task", "TrainConfig", "task_named", "task_of"]

VALIDATION_SEED = 1

NetworkConfig = DepthConfig | PaperConfig | RefineConfig | FusionConfig | JointConfig | SynSinConfig


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
        pictures: what a network makes of the first of these pairs, RGB in [0, 1] by name; None where nobody looks.
        contest: how it learns against an opponent, instead of by ``loss`` alone; None where it has none.
        pool: command that makes what it learns from, see :func:`omnisyn_cli.training.data.list_pool`.
    """

    config: type[Any]
    build: Callable[[Any], Any]
    loss: Callable[[Any, list[Path], np.random.Generator, TrainConfig], Tensor]
    validate: Callable[[Any, TrainConfig], dict[str, float]]
    pictures: Callable[[Any, TrainConfig], dict[str, np.ndarray]] | None = None
    contest: Contest | None = None
    pool: str = "pool"


def on_device(network: Module, *tensors: Tensor) -> list[Tensor]:
    """The tensors where the network's weights are."""
    device = next(network.parameters()).device
    return [tensor.to(device) for tensor in tensors]


def _depth_loss(network: DepthNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig) -> Tensor:
    batch = draw_batch(pool, rng, config.batch, config.size, Augmentation(), network.config.greatest_root)
    first, second, root = on_device(network, batch.first, batch.second, batch.root)
    return depth_loss(network(first, second), root)


def _paper_loss(network: PaperNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig) -> Tensor:
    height = config.size[0]
    drawn = draw_batch(pool, rng, config.batch, (height, 2 * height), Augmentation())
    batch = forward_batch(drawn, config.size)
    first, second, root = on_device(network, batch.first, batch.second, batch.root)
    return paper_loss(network(first, second), root)


@torch.no_grad()
def _validate_depth(network: DepthNetwork | PaperNetwork, config: TrainConfig) -> dict[str, float]:
    scores = []
    for index in range(config.validation_pairs):
        batch = _validation_batch(network, config, index)
        first, second, root, baseline = on_device(network, batch.first, batch.second, batch.root, batch.baseline)
        scores.append(depth_scores(network(first, second), root, baseline))
    return _mean(scores)


def _validation_batch(network: DepthNetwork | PaperNetwork, config: TrainConfig, index: int) -> Batch:
    """A pair of the scene at ``index``, always the same, in the network's frame."""
    pool, height = list_pool(Path(config.validation_pool)), config.size[0]
    rng, scenes = np.random.default_rng([VALIDATION_SEED, index]), [pool[index % len(pool)]]
    if isinstance(network, PaperNetwork):
        return forward_batch(draw_batch(scenes, rng, 1, (height, 2 * height)), config.size)
    return draw_batch(scenes, rng, 1, config.size, greatest_root=network.config.greatest_root)


@torch.no_grad()
def _show_depth(network: DepthNetwork | PaperNetwork, config: TrainConfig) -> dict[str, np.ndarray]:
    batch = _validation_batch(network, config, 0)
    found = network(*on_device(network, batch.first, batch.second)).inverse_depth().sqrt().cpu()
    return depth_pictures(batch.first[0].permute(1, 2, 0).numpy(), found[0, 0].numpy(), batch.root[0, 0].numpy())


def _refine_loss(network: RefineNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig) -> Tensor:
    batch = draw_evidence(pool, rng, config.batch)
    planes, root = on_device(network, batch.planes, batch.root)
    return refine_loss(network(planes), root)


@torch.no_grad()
def _validate_refine(network: RefineNetwork, config: TrainConfig) -> dict[str, float]:
    pool = list_pool(Path(config.validation_pool), "evidence")
    scores = []
    for index in range(config.validation_pairs):
        pair = load_evidence(pool[index % len(pool)])[index // len(pool) % 2]
        plain = torch.from_numpy(pair.planes)[None], torch.from_numpy(pair.root)[None, None]
        planes, root, baseline = on_device(network, *plain, torch.tensor([pair.baseline]))
        scores.append(depth_scores(network(planes), root, baseline))
    return _mean(scores)


def _fusion_loss(
    network: FusionNetwork | PaintingNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig
) -> Tensor:
    batch = draw_fusion(pool, rng, config.batch)
    planes, truth = on_device(network, batch.planes, batch.truth)
    return fusion_loss(fused_by(network, planes), truth)


@torch.no_grad()
def _validate_fusion(network: FusionNetwork | PaintingNetwork, config: TrainConfig) -> dict[str, float]:
    pool = list_pool(Path(config.validation_pool), "fusion-pool")
    scores = []
    for index in range(config.validation_pairs):
        sample = load_fusion(pool[index % len(pool)], index // len(pool))[0]
        planes, truth = on_device(network, torch.from_numpy(sample.planes)[None], torch.from_numpy(sample.truth)[None])
        scores.append(fusion_scores(fused_by(network, planes), planes, truth))
    return _mean(scores)


def _joint_loss(network: JointNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig) -> Tensor:
    drawn = _triples(network, pool, rng, config.batch, config.size, Augmentation())
    return joint_loss(joint_answer(network, drawn), drawn)


def _triples(
    network: JointNetwork, pool: list[Path], rng: np.random.Generator, batch: int, size: tuple[int, int],
    augmentation: Augmentation | None = None,
) -> Triples:  # fmt: skip
    """As the depth network wants them, where the weights are."""
    depth = network.config.depth
    greatest = {"greatest_root": depth.greatest_root} if isinstance(depth, DepthConfig) else {}
    drawn = draw_triples(pool, rng, batch, size, network.depth.frame, augmentation, **greatest)
    return drawn.to(next(network.parameters()).device)


def _joint_validation(network: JointNetwork, config: TrainConfig, index: int) -> Triples:
    """Views of the scene at ``index``, always the same."""
    pool, rng = list_pool(Path(config.validation_pool)), np.random.default_rng([VALIDATION_SEED, index])
    return _triples(network, [pool[index % len(pool)]], rng, 1, config.size)


@torch.no_grad()
def _validate_joint(network: JointNetwork, config: TrainConfig) -> dict[str, float]:
    depths, pictures = [], []
    for index in range(config.validation_pairs):
        drawn = _joint_validation(network, config, index)
        answer = joint_answer(network, drawn)
        depths.append(depth_scores(answer.prediction.stacked, drawn.roots.flatten(0, 1), drawn.baseline.repeat(2)))
        pictures.append(fusion_scores(answer.picture, answer.planes, drawn.middle))
    return _mean(depths) | _mean(pictures)


@torch.no_grad()
def _show_joint(network: JointNetwork, config: TrainConfig) -> dict[str, np.ndarray]:
    drawn = _joint_validation(network, config, 0)
    answer = joint_answer(network, drawn)
    image, root, truth = (
        x[0].cpu().numpy() for x in (drawn.first, answer.prediction.inverse_depth[0].sqrt(), drawn.roots[0, :, 0])
    )
    shown = depth_pictures(image.transpose(1, 2, 0), root, truth)
    return shown | fused_pictures(answer.planes[0], answer.picture[0], drawn.middle[0])


def _synsin_loss(network: SynSinNetwork, pool: list[Path], rng: np.random.Generator, config: TrainConfig) -> Tensor:
    lessons = draw_lessons(pool, rng, config.batch, config.size)
    return own_loss(make_pictures(network, lessons), lessons)


def _mean(scores: Sequence[DepthScores | FusionScores]) -> dict[str, float]:
    """Over pairs; NaN, as of pairs without sky, is left out."""
    rows = torch.tensor([list(asdict(score).values()) for score in scores])
    return dict(zip(asdict(scores[0]), rows.nanmean(dim=0).tolist(), strict=True))


TASKS: Mapping[str, Task] = MappingProxyType(
    {
        "depth": Task(DepthConfig, DepthNetwork, _depth_loss, _validate_depth, _show_depth),
        "paper": Task(PaperConfig, PaperNetwork, _paper_loss, _validate_depth, _show_depth),
        "refine": Task(RefineConfig, RefineNetwork, _refine_loss, _validate_refine, pool="evidence"),
        "fusion": Task(FusionConfig, build_fusion, _fusion_loss, _validate_fusion, pool="fusion-pool"),
        "joint": Task(JointConfig, JointNetwork, _joint_loss, _validate_joint, _show_joint),
        "synsin": Task(
            SynSinConfig,
            SynSinNetwork,
            _synsin_loss,
            validate_synsin,
            show_synsin,
            Contest(PatchDiscriminator, contest_losses),
        ),
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
