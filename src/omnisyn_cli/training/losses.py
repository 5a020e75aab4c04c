"""The losses of depth networks, and the figures they are judged by.

Targets are square roots of inverse depth × baseline. In losses every mean over pixels is weighted by the sine of the
polar angle, that is, by solid angle; figures count pixels. Targets are NaN where the truth is not known: nothing is
taught or judged there.
"""

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.geometry.sphere import row_weights
from omnisyn_cli.networks.completion import CompletionPrediction
from omnisyn_cli.networks.interface import DepthAnswer
from omnisyn_cli.networks.paper import PaperPrediction

STAGE_WEIGHT = 0.5
"""Weight of the coarse estimates together (the paper's 0.5 × low head)."""

GRADIENT_WEIGHT = 0.5
CONFIDENCE_WEIGHT = 0.05

RIGHT_WITHIN = 1.1
"""A depth is called right, in the confidence, when it is within this factor of the truth."""

FARTHEST = 1e-3
"""Inverse depth × baseline below this is called infinitely far when confidence is judged."""

SCORED_DEPTH = (1.0, 50.0)
"""Metres between which depth is scored (the paper's range)."""

COMPLETED_WEIGHT = 3.0
"""How much more the answer counts where matching is not sure, and beside silhouettes, where it is often wrong."""

BESIDE = 5
"""Pixels across: what lies so close around a jump is beside a silhouette."""

MODE_SCALE = 0.03
"""Error of a root that makes a mode e times less likely."""

MODE_WEIGHT = 0.02

JUMP = 0.1
"""Difference of neighbouring true roots that is called an edge."""

EDGE_WEIGHT = 0.25


def polar_weights(like: Float[Tensor, "*batch height width"]) -> Float[Tensor, "height 1"]:
    """Sine of the polar angle of every row, divided by its mean."""
    weights = row_weights(like.shape[-2])
    return torch.as_tensor(weights / weights.mean(), dtype=like.dtype, device=like.device)[:, None]


def paper_loss(prediction: PaperPrediction, target: Float[Tensor, "batch 1 height width"]) -> Tensor:
    """L1 of inverse depth · baseline of the high head, and half of that of the low head, a scalar.

    Source: OmniSyn, section 3.6. Unlike there an estimate below zero is right where the target is infinitely far.

    Args:
        prediction: of the paper's network.
        target: true roots.
    """
    known, root = _known(target)
    inverse_depth, weights = root.square(), polar_weights(root)
    high, low = (
        _mean_of(_beyond_zero(estimate, inverse_depth) * weights, known)
        for estimate in (prediction.high, prediction.low)
    )
    return high + STAGE_WEIGHT * low


def root_loss(root: Float[Tensor, "*batch height width"], target: Float[Tensor, "*batch height width"]) -> Tensor:
    """Mean absolute error of roots, a scalar; an estimate below zero is right where the target is infinitely far."""
    known, target = _known(target)
    return _mean_of(_beyond_zero(root, target) * polar_weights(target), known)


def _known(target: Tensor) -> tuple[Tensor, Tensor]:
    """Where the truth is known, as zeros and ones, and the target with zeros elsewhere."""
    known = torch.isfinite(target)
    return known.to(target.dtype), torch.where(known, target, torch.zeros_like(target))


def _mean_of(error: Tensor, known: Tensor) -> Tensor:
    """Mean over what is known; 0 where nothing is."""
    return (error * known).mean() / known.mean().clamp(min=torch.finfo(known.dtype).tiny)


def completion_loss(
    prediction: CompletionPrediction,
    target: Float[Tensor, "batch 1 height width"],
    sure: Float[Tensor, "batch 1 height width"],
) -> Tensor:
    """Expected L1 of both modes, L1 of the likelier one, their log-loss, gradients, edges, log-loss of the confidence.

    Args:
        prediction: of the completion network.
        target: true roots; NaN where they are not known.
        sure: 1 where matching is sure, else 0; there, away from silhouettes, everything but the gradients counts less.
    """
    known, target = _known(target)
    area = polar_weights(target) * known
    weight = area * (1.0 + COMPLETED_WEIGHT * torch.maximum(1.0 - sure, _beside_silhouettes(target)))
    shares = torch.cat([functional.logsigmoid(prediction.logit), functional.logsigmoid(-prediction.logit)], dim=1)
    errors = _beyond_zero(prediction.roots, target)
    surprise = -torch.logsumexp(shares - errors / MODE_SCALE, dim=1, keepdim=True)
    expected = (shares.exp() * errors).sum(dim=1, keepdim=True)
    root = prediction.root()
    answer = _beyond_zero(root, target)
    told = (expected + answer + MODE_WEIGHT * surprise) * weight
    shape = GRADIENT_WEIGHT * _gradient_error(root, target, known) + EDGE_WEIGHT * _edge_error(root, target, known)
    return told.mean() + shape + CONFIDENCE_WEIGHT * (_confidence_loss(prediction, target) * area).mean()


def _beside_silhouettes(target: Tensor) -> Tensor:
    """1 where the target jumps within a few pixels, over the seam, else 0."""
    reach = BESIDE // 2
    wide = functional.pad(target, (reach, reach, 0, 0), mode="circular")
    greatest, least = (functional.max_pool2d(sign * wide, BESIDE, 1, (reach, 0)) for sign in (1.0, -1.0))
    return (greatest + least > JUMP).to(target.dtype)


def _beyond_zero(root: Tensor, target: Tensor) -> Tensor:
    """Absolute error; an estimate below zero is right where the target is zero."""
    return torch.where(target > 0, (root - target).abs(), root.clamp(min=0.0))


def _gradient_error(root: Tensor, target: Tensor, known: Tensor) -> Tensor:
    """L1 of the differences of neighbours, with edges of the target forgiven.

    Where the target jumps by more than a tenth the position of the edge is left to the plain L1.
    """
    steps = _step_errors(root, target, known)
    return torch.stack([_mean_of(error * ~is_edge, both_known) for error, is_edge, both_known in steps]).sum()


def _edge_error(root: Tensor, target: Tensor, known: Tensor) -> Tensor:
    """L1 of the differences of neighbours where the target jumps, over all pixels."""
    steps = _step_errors(root, target, known)
    return torch.stack([(error * is_edge * both_known).mean() for error, is_edge, both_known in steps]).sum()


def _step_errors(root: Tensor, target: Tensor, known: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Of the differences to the right neighbour (over the seam) and to the one below.

    Each with its weighted error, whether the target jumps there, and whether both are known.
    """
    weights = polar_weights(target)
    for dimension, kept in ((-1, slice(None)), (-2, slice(-1))):
        step, true_step = (x.roll(-1, dimension) - x for x in (root, target))
        error, both_known = (step - true_step).abs() * weights, known * known.roll(-1, dimension)
        yield error[..., kept, :], true_step.abs()[..., kept, :] >= JUMP, both_known[..., kept, :]


def _confidence_loss(prediction: DepthAnswer, target: Tensor) -> Tensor:
    """Log-loss of the confidence, pixel by pixel."""
    right = _is_right(prediction.inverse_depth(), target.square())
    return functional.binary_cross_entropy_with_logits(prediction.confidence_logit, right, reduction="none")


def _is_right(inverse_depth: Tensor, target: Tensor, factor: float = RIGHT_WITHIN) -> Tensor:
    with torch.no_grad():
        larger = torch.maximum(inverse_depth, target).clamp(min=FARTHEST)
        smaller = torch.minimum(inverse_depth, target).clamp(min=FARTHEST)
        return (larger < factor * smaller).to(inverse_depth.dtype)


@torch.no_grad()
def depth_scores(
    prediction: DepthAnswer, target: Float[Tensor, "batch 1 height width"], baseline: Float[Tensor, " batch"]
) -> dict[str, float]:
    """Figures of the paper's depth table on pixels with 1 m < true depth < 50 m.

    Args:
        prediction: of a depth network.
        target: true roots.
        baseline: metres.

    Returns:
        ``imae``, the mean absolute error of inverse depth, 1/m; ``delta_5``, the share of pixels whose depth is within
        a factor of 1.05, ``delta_10`` and ``delta_25``; ``confidence_error``, the mean of |confidence − (within a
        factor of 1.1)|; ``sky_zero``, the share of the pixels at infinity that are predicted below 1e-3 (times
        baseline), NaN without sky.
    """
    scale = baseline.view(-1, 1, 1, 1)
    estimate, truth = prediction.inverse_depth() / scale, target.square() / scale
    scored = (truth < 1.0 / SCORED_DEPTH[0]) & (truth > 1.0 / SCORED_DEPTH[1])
    ratio = torch.maximum(estimate / truth, truth / estimate.clamp(min=1e-6))[scored]
    known = torch.isfinite(target)
    right = _is_right(prediction.inverse_depth(), target.square())
    sky = target == 0
    return {
        "imae": float((estimate - truth).abs()[scored].mean()),
        "delta_5": float((ratio < 1.05).float().mean()),
        "delta_10": float((ratio < 1.10).float().mean()),
        "delta_25": float((ratio < 1.25).float().mean()),
        "confidence_error": float((prediction.confidence() - right).abs()[known].mean()),
        "sky_zero": float((prediction.inverse_depth()[sky] < FARTHEST).float().mean()),
    }


@torch.no_grad()
def completion_scores(
    prediction: DepthAnswer,
    filled: Float[Tensor, "batch 1 height width"],
    target: Float[Tensor, "batch 1 height width"],
    sure: Float[Tensor, "batch 1 height width"],
) -> dict[str, float]:
    """How well is answered where matching is not sure, and elsewhere; means weigh pixels by solid angle.

    Args:
        prediction: of a depth network.
        filled: roots of the map that it began with; what is said of it ends with ``_filled``.
        target: true roots; NaN where they are not known.
        sure: 1 where matching is sure, else 0.

    Returns:
        ``unsure``, the share of the sphere; over that ``error``, the mean absolute error of the root, ``within_5`` and
        ``within_25``, the shares whose depth is within a factor of 1.05 and 1.25, and ``confidence_error``, the mean of
        |confidence − (within a factor of 1.1)|; over the rest ``error_sure``.
    """
    known, target = _known(target)
    area = polar_weights(target) * known
    unsure = area * (1.0 - sure)
    answer = prediction.inverse_depth()
    right = _is_right(answer, target.square())

    def mean(values: Tensor, weights: Tensor) -> float:
        return float((values * weights).sum() / weights.sum())

    def within(inverse_depth: Tensor, factor: float) -> float:
        return mean(_is_right(inverse_depth, target.square(), factor), unsure)

    return {
        "unsure": mean(1.0 - sure, area),
        "error": mean((answer.sqrt() - target).abs(), unsure),
        "error_filled": mean((filled - target).abs(), unsure),
        "within_5": within(answer, 1.05),
        "within_5_filled": within(filled.square(), 1.05),
        "within_25": within(answer, 1.25),
        "within_25_filled": within(filled.square(), 1.25),
        "error_sure": mean((answer.sqrt() - target).abs(), area * sure),
        "error_sure_filled": mean((filled - target).abs(), area * sure),
        "confidence_error": mean((prediction.confidence() - right).abs(), unsure),
    }
