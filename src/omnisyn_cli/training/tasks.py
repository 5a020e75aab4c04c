"""All kinds of networks, and what the training loop has to know of each."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from omnisyn_cli.networks import completion, guided_depth
from omnisyn_cli.networks.completion import FILLED_CHANNEL, CompletionConfig, reliable_mask
from omnisyn_cli.networks.descriptors import DESCRIPTOR_VARIANTS, DescriptorConfig, DescriptorNetwork
from omnisyn_cli.networks.fusion import FUSION_VARIANTS, FusionConfig, build_fusion
from omnisyn_cli.networks.guided_depth import GuidedDepthConfig
from omnisyn_cli.networks.interface import DepthPrediction
from omnisyn_cli.networks.paper import PAPER_VARIANTS, PaperConfig, PaperNetwork
from omnisyn_cli.networks.synsin import SYNSIN_VARIANTS, SynSinConfig, SynSinNetwork
from omnisyn_cli.training import joint, losses, synsin
from omnisyn_cli.training.completion import FeatureBatch, draw_completion
from omnisyn_cli.training.data import Augmentation, list_scene_files, load_samples, stacked
from omnisyn_cli.training.descriptor_pairs import descriptor_loss, descriptor_scores, draw_descriptors
from omnisyn_cli.training.fusion_scenes import FusionBatch, draw_fusion
from omnisyn_cli.training.guided_depth import draw_guided, guided_loss, guided_scores
from omnisyn_cli.training.pairs import Batch, Triples, draw_pairs
from omnisyn_cli.training.pictures import as_array, depth_pictures
from omnisyn_cli.training.synsin import draw_views

VALIDATION_SEED = 1  # Of the draws of held-out batches: the same in every run, so that losses can be compared
HELD_OUT_LOSS = "held_out_loss"  # Name among the figures of the loss of what networks are judged by


@dataclass(frozen=True)
class TrainConfig:
    """One stage of training; a later stage may change any of it."""

    pool: str  # folders of scenes, see data
    validation_pool: str
    size: tuple[int, int] = (256, 512)  # of the images, a whole fraction of the pool's
    batch: int = 4  # pairs per step
    rate: float = 6e-4  # learning rate after the warm-up
    warmup_steps: int = 200  # steps over which the rate rises from zero
    cooldown_steps: int = 0  # over which the rate falls to zero, from the first step of this call on; then it ends
    weight_decay: float = 1e-4  # of AdamW, and the greatest norm of a gradient
    clip: float = 1.0
    ema: float = 0.998  # decay of the average per step (smaller at the beginning)
    seed: int = 0  # of the weights and of all batches
    validate_every: int = 250  # in steps
    save_every: int = 50
    validation_pairs: int = 32  # how many pairs are scored


@dataclass(frozen=True)
class Task:
    """A kind of network: what it is shown, how it is taught, how it is judged.

    Batches are dataclasses of tensors, or lists of them. ``draw`` makes that of a step: of a pool, random numbers, a
    stage, the network and the variation of colours, or None. ``held_out`` makes one to be judged by of a scene's file,
    how often it was looked at before, and the stage; None draws it without varying colours.
    """

    config: type[Any]  # class of its configuration, with ``as_dict`` and ``from_dict``
    variants: Mapping[str, Any]  # the configurations by name
    build: Callable[[Any], Any]  # a fresh network of a configuration
    draw: Callable[[list[Path], np.random.Generator, TrainConfig, Any, Augmentation | None], Any]
    loss: Callable[[Any, Any], Tensor]  # of an answer to a batch, a scalar
    scores: Callable[[Any, Any], dict[str, float]]  # figures of an answer to a batch
    # what a network is shown of a batch: both panoramas of pairs
    inputs: Callable[[Any, Any], tuple[Tensor, ...]] = lambda network, batch: (batch.first, batch.second)
    answer: Callable[[Any, Any], Any] | None = None  # of a network to a batch; None calls it with ``inputs``
    pictures: Callable[[Any, Any], dict[str, np.ndarray]] | None = None  # RGB in [0, 1] by name; None: nobody looks
    held_out: Callable[[Path, int, TrainConfig], Any] | None = None
    pool: str = "pool"  # command that makes what it learns from, see list_scene_files
    role: str | None = None  # what it is for; None where that is the kind itself

    def answer_of(self, network: Any, batch: Any) -> Any:
        """What a network says to a batch."""
        return network(*self.inputs(network, batch)) if self.answer is None else self.answer(network, batch)

    def validation(self, network: Any, stage: TrainConfig) -> Iterator[Any]:
        """What networks are judged by: always the same, where the weights are."""
        pool = list_scene_files(Path(stage.validation_pool), self.pool)
        for index in range(stage.validation_pairs):
            path = pool[index % len(pool)]
            if self.held_out is None:
                rng = np.random.default_rng([VALIDATION_SEED, index])
                batch = self.draw([path], rng, replace(stage, batch=1), network, None)
            else:
                batch = self.held_out(path, index // len(pool), stage)
            yield on_device(batch, next(network.parameters()).device)

    @torch.no_grad()
    def validate(self, network: Any, stage: TrainConfig) -> dict[str, float]:
        """Mean figures, of which NaN, as of pairs without sky, is left out; and the mean loss, which may be NaN."""
        scores, losses = [], []
        for batch in self.validation(network, stage):
            answer = self.answer_of(network, batch)
            scores.append(self.scores(answer, batch))
            losses.append(float(self.loss(answer, batch)))
        rows = torch.tensor([list(score.values()) for score in scores])
        means = dict(zip(scores[0], rows.nanmean(dim=0).tolist(), strict=True))
        return means | {HELD_OUT_LOSS: float(torch.tensor(losses).mean())}


def on_device(batch: Any, device: torch.device) -> Any:
    """A batch on another device."""
    if isinstance(batch, list):
        return [on_device(sample, device) for sample in batch]
    tensors = {name: value.to(device) for name, value in vars(batch).items() if isinstance(value, Tensor)}
    return replace(batch, **tensors)


NetworkConfig = (
    GuidedDepthConfig | PaperConfig | DescriptorConfig | CompletionConfig | FusionConfig | joint.JointConfig
    | SynSinConfig
)  # fmt: skip


def _depth_pictures(answer: DepthPrediction, batch: Any) -> dict[str, np.ndarray]:
    return depth_pictures(batch.first[0], answer.inverse_depth()[0, 0].sqrt(), batch.sqrt_inv_depth[0, 0])


def _completion_pictures(answer: completion.CompletionPrediction, batch: FeatureBatch) -> dict[str, np.ndarray]:
    """The prediction, the reliable matches, and the map that was filled from these."""
    channels, truth = batch.channels[0], batch.sqrt_inv_depth[0, 0]
    predicted = depth_pictures(channels[:3], answer.inverse_depth()[0, 0].sqrt(), truth)
    filled = depth_pictures(channels[:3], channels[FILLED_CHANNEL], truth)
    known = np.where(as_array(reliable_mask(batch.channels)[0]) > 0, filled["truth"], np.float32(0.0))
    return predicted | {"filled": filled["prediction"], "known": known}


# By the kind that a checkpoint names.
TASKS: Mapping[str, Task] = {
    "paper": Task(
        PaperConfig, PAPER_VARIANTS, PaperNetwork,
        draw=lambda pool, rng, stage, network, varied: draw_pairs(
            Batch, pool, rng, stage.batch, stage.size, varied, network.config.max_sqrt_inv_depth
        ),
        loss=lambda answer, batch: losses.paper_loss(answer, batch.sqrt_inv_depth),
        scores=lambda answer, batch: losses.depth_scores(answer, batch.sqrt_inv_depth, batch.baseline),
        pictures=_depth_pictures, role="depth",
    ),
    "guided": Task(
        GuidedDepthConfig, guided_depth.GUIDED_DEPTH_VARIANTS, guided_depth.GuidedDepthNetwork,
        draw=lambda pool, rng, stage, network, varied: draw_guided(
            pool, rng, stage.batch, stage.size, network.config.max_sqrt_inv_depth, varied
        ),
        inputs=lambda _, batch: (batch.first, batch.second, batch.towards),
        loss=guided_loss, scores=guided_scores, role="guided-depth",
        pictures=lambda answer, batch: (
            _depth_pictures(answer, batch) | {"confidence": as_array(answer.confidence()[0].expand(3, -1, -1))}
        ),
    ),
    "descriptors": Task(
        DescriptorConfig, DESCRIPTOR_VARIANTS, DescriptorNetwork,
        draw=lambda pool, rng, stage, _, varied: draw_descriptors(pool, rng, stage.batch, stage.size, varied),
        answer=lambda network, batch: (network(batch.first), network(batch.second)),
        loss=descriptor_loss, scores=descriptor_scores,
    ),
    "completion": Task(
        CompletionConfig, completion.COMPLETION_VARIANTS, completion.CompletionNetwork,
        draw=lambda pool, rng, stage, _, varied: draw_completion(
            pool, rng, stage.batch, stage.size, augment=varied is not None
        ),
        inputs=lambda _, batch: (batch.channels,),
        loss=lambda answer, batch: losses.completion_loss(answer, batch.sqrt_inv_depth, reliable_mask(batch.channels)),
        scores=lambda answer, batch: losses.completion_scores(answer, batch.channels, batch.sqrt_inv_depth),
        pictures=_completion_pictures, pool="evidence",
    ),
    "fusion": Task(
        FusionConfig, FUSION_VARIANTS, build_fusion,
        draw=lambda pool, rng, stage, *_: draw_fusion(pool, rng, stage.batch),
        inputs=lambda network, batch: (losses.network_inputs(network.config, batch.channels),),
        answer=lambda network, batch: losses.fuse_with(network, batch.channels, batch.pictures),
        loss=lambda answer, batch: losses.fusion_loss(answer, batch.truth, batch.fused_error),
        scores=lambda answer, batch: losses.fusion_scores(answer, batch.channels, batch.truth, batch.pictures[:, :3]),
        held_out=lambda path, turn, _: stacked(load_samples(path, FusionBatch, turn)),
        pool="fusion-pool",
    ),
    "joint": Task(
        joint.JointConfig, {}, joint.JointNetwork,
        draw=lambda pool, rng, stage, network, varied: draw_pairs(
            Triples, pool, rng, stage.batch, stage.size, varied, network.depth.config.max_sqrt_inv_depth
        ),
        answer=joint.joint_answer, loss=joint.joint_loss, scores=joint.joint_scores, pictures=joint.joint_pictures,
    ),
    "synsin": Task(
        SynSinConfig, SYNSIN_VARIANTS, SynSinNetwork,
        draw=lambda pool, rng, stage, *_: draw_views(pool, rng, stage.batch, stage.size),
        answer=synsin.render_pictures, loss=synsin.reconstruction_loss, scores=synsin.synsin_scores,
        pictures=synsin.synsin_pictures,
        held_out=lambda path, _, stage: synsin.load_views(path, stage.size),
    ),
}  # fmt: skip


def task_of(config: NetworkConfig) -> str:
    """The kind of network that a configuration belongs to."""
    return next(kind for kind, task in TASKS.items() if isinstance(config, task.config))


def role_of(kind: str) -> str:
    """What a kind of network is for: there may be several for one role."""
    return TASKS[kind].role or kind


def kinds_for(role: str) -> tuple[str, ...]:
    """The kinds of network for a role."""
    return tuple(kind for kind in TASKS if role_of(kind) == role)


def parts_of(network: Any) -> dict[str, Any]:
    """The networks by kind that one consists of: both of a joint one, itself otherwise."""
    held = (network.depth, network.fusion) if isinstance(network, joint.JointNetwork) else (network,)
    return {task_of(part.config): part for part in held}
