"""All kinds of networks, and what each is taught."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from omnisyn_cli.networks.completion import (
    COMPLETION_VARIANTS,
    FILLED_CHANNEL,
    CompletionConfig,
    CompletionNetwork,
    CompletionPrediction,
    reliable_mask,
)
from omnisyn_cli.networks.fusion import FUSION_VARIANTS, FusionConfig, build_fusion
from omnisyn_cli.networks.guided_depth import (
    GUIDED_DEPTH_VARIANTS,
    GuidedDepthConfig,
    GuidedDepthNetwork,
    GuidedDepthPrediction,
)
from omnisyn_cli.networks.interface import DepthPrediction
from omnisyn_cli.networks.paper import PAPER_VARIANTS, PaperConfig, PaperNetwork
from omnisyn_cli.networks.synsin import SYNSIN_VARIANTS, SynSinConfig, SynSinNetwork
from omnisyn_cli.training import fusion_losses, joint, losses, synsin
from omnisyn_cli.training.completion import FeatureBatch, draw_completion
from omnisyn_cli.training.fusion_scenes import draw_fusion, load_fusion
from omnisyn_cli.training.guided_depth import GuidedBatch, draw_guided, guided_loss, guided_scores
from omnisyn_cli.training.pairs import Batch, draw_pairs, draw_triples
from omnisyn_cli.training.pictures import as_array, depth_pictures
from omnisyn_cli.training.synsin import draw_views
from omnisyn_cli.training.task import Task

NetworkConfig = GuidedDepthConfig | PaperConfig | CompletionConfig | FusionConfig | joint.JointConfig | SynSinConfig


def _depth_pictures(answer: DepthPrediction, batch: Batch) -> dict[str, np.ndarray]:
    found = answer.inverse_depth().sqrt()
    return depth_pictures(*(as_array(x) for x in (batch.first[0], found[0, 0], batch.sqrt_inv_depth[0, 0])))


def _guided_pictures(answer: GuidedDepthPrediction, batch: GuidedBatch) -> dict[str, np.ndarray]:
    """The first pair, with the confidence from black to white."""
    found = answer.inverse_depth().sqrt()
    shown = depth_pictures(*(as_array(x) for x in (batch.first[0], found[0, 0], batch.sqrt_inv_depth[0, 0])))
    return shown | {"confidence": np.stack([as_array(answer.confidence()[0, 0])] * 3, axis=-1)}


def _completion_scores(answer: CompletionPrediction, batch: FeatureBatch) -> dict[str, float]:
    filled = batch.channels[:, FILLED_CHANNEL : FILLED_CHANNEL + 1]
    return losses.completion_scores(answer, filled, batch.sqrt_inv_depth, reliable_mask(batch.channels))


def _completion_pictures(answer: CompletionPrediction, batch: FeatureBatch) -> dict[str, np.ndarray]:
    """The prediction, the reliable matches, and the map that was filled from these."""
    channels, found = batch.channels[0], answer.inverse_depth().sqrt()[0, 0]
    image, truth = as_array(channels[:3]), as_array(batch.sqrt_inv_depth[0, 0])
    predicted, filled = (depth_pictures(image, as_array(depth), truth) for depth in (found, channels[FILLED_CHANNEL]))
    is_reliable = as_array(reliable_mask(batch.channels)[0]) > 0
    known = np.where(is_reliable, filled["truth"], np.float32(0.0))
    return predicted | {"filled": filled["prediction"], "known": known}


TASKS: Mapping[str, Task] = {
    "paper": Task(
        PaperConfig,
        PAPER_VARIANTS,
        PaperNetwork,
        draw=lambda pool, rng, stage, network, varied: draw_pairs(
            pool, rng, stage.batch, stage.size, varied, network.config.max_sqrt_inv_depth
        ),
        loss=lambda answer, batch: losses.paper_loss(answer, batch.sqrt_inv_depth),
        scores=lambda answer, batch: losses.depth_scores(answer, batch.sqrt_inv_depth, batch.baseline),
        pictures=_depth_pictures,
        role="depth",
    ),
    "guided": Task(
        GuidedDepthConfig,
        GUIDED_DEPTH_VARIANTS,
        GuidedDepthNetwork,
        draw=lambda pool, rng, stage, network, varied: draw_guided(
            pool, rng, stage.batch, stage.size, network.config.max_sqrt_inv_depth, varied, stage.guided
        ),
        loss=guided_loss,
        scores=guided_scores,
        pictures=_guided_pictures,
        role="guided-depth",
    ),
    "completion": Task(
        CompletionConfig,
        COMPLETION_VARIANTS,
        CompletionNetwork,
        draw=lambda pool, rng, stage, _, varied: draw_completion(
            pool, rng, stage.batch, stage.size, augment=varied is not None
        ),
        loss=lambda answer, batch: losses.completion_loss(answer, batch.sqrt_inv_depth, reliable_mask(batch.channels)),
        scores=_completion_scores,
        pictures=_completion_pictures,
        pool="evidence",
    ),
    "fusion": Task(
        FusionConfig,
        FUSION_VARIANTS,
        build_fusion,
        draw=lambda pool, rng, stage, *_: draw_fusion(pool, rng, stage.batch),
        inputs=lambda network, batch: (fusion_losses.network_inputs(network.config, batch.channels),),
        answer=lambda network, batch: fusion_losses.fuse_with(network, batch.channels, batch.pictures),
        loss=lambda answer, batch: fusion_losses.fusion_loss(answer, batch.truth, batch.fused_error),
        scores=lambda answer, batch: fusion_losses.fusion_scores(
            answer, batch.channels, batch.truth, batch.pictures[:, :3]
        ),
        held_out=lambda path, turn, _: load_fusion(path, turn),
        pool="fusion-pool",
    ),
    "joint": Task(
        joint.JointConfig,
        {},
        joint.JointNetwork,
        draw=lambda pool, rng, stage, network, varied: draw_triples(
            pool, rng, stage.batch, stage.size, varied, network.depth.config.max_sqrt_inv_depth
        ),
        answer=joint.joint_answer,
        loss=joint.joint_loss,
        scores=joint.joint_scores,
        pictures=joint.joint_pictures,
    ),
    "synsin": Task(
        SynSinConfig,
        SYNSIN_VARIANTS,
        SynSinNetwork,
        draw=lambda pool, rng, stage, *_: draw_views(pool, rng, stage.batch, stage.size),
        answer=synsin.render_pictures,
        loss=synsin.reconstruction_loss,
        scores=synsin.synsin_scores,
        pictures=synsin.synsin_pictures,
        held_out=lambda path, _, stage: synsin.load_views(path, stage.size),
        is_repeated=False,
    ),
}
"""By the kind that a checkpoint names."""


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
