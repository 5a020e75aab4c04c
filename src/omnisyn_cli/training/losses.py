"""The losses of depth and fusion networks, and the figures they are judged by.

Targets of depth are √(inverse depth × baseline). In losses every mean over pixels is weighted by the sine of the polar
angle, that is, by solid angle; figures of depth count pixels. Unknown truth is NaN: nothing is taught or judged there.
"""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.geometry.sphere import row_weights
from omnisyn_cli.networks.completion import FILLED_CHANNEL, CompletionPrediction, reliable_mask
from omnisyn_cli.networks.fusion import DirectFusionUNet, FusionConfig, ResidualFusionUNet
from omnisyn_cli.networks.interface import DepthPrediction
from omnisyn_cli.networks.paper import PaperPrediction

LOW_HEAD_WEIGHT = 0.5  # Weight of the low head's error; the paper's (section 3.6)
GRADIENT_WEIGHT = 0.5  # Weight of the error of gradients on surfaces
CONFIDENCE_WEIGHT = 0.05  # Weight of the confidence's log-loss: small, so that it does not cost accuracy of depth
MAX_CORRECT_RATIO = 1.1  # Factor to the truth within which a depth is correct: the confidence is its probability
INFINITY_INVERSE_DEPTH = 1e-3  # Inverse depth × baseline below which a point is infinitely far: a thousand baselines
SCORED_DEPTH_RANGE_METRES = (1.0, 50.0)  # Depths that are scored: the range of the paper's depth table
UNRELIABLE_WEIGHT = 3.0  # Additional, where matching is unreliable, and beside silhouettes, where it is often wrong
SILHOUETTE_WINDOW_PIXELS = 5  # Side of the window around a depth edge that is beside a silhouette: matching blurs it
MODE_ERROR_SCALE = 0.03  # Scale of the Laplace distribution of errors of √(inverse depth × baseline) around a mode
MODE_LOG_LOSS_WEIGHT = 0.02  # Weight of the modes' log-loss; its values are some thirty times the absolute errors
MIN_EDGE_STEP = 0.1  # Difference of √(inverse depth × baseline) between neighbours that makes an edge
EDGE_WEIGHT = 0.25  # Weight of the error of steps at edges


def polar_weights(like: Float[Tensor, "*batch height width"]) -> Float[Tensor, "height 1"]:
    """Sine of the polar angle of every row, divided by its mean."""
    weights = row_weights(like.shape[-2])
    return torch.as_tensor(weights / weights.mean(), dtype=like.dtype, device=like.device)[:, None]


def paper_loss(prediction: PaperPrediction, target: Float[Tensor, "batch 1 height width"]) -> Tensor:
    """L1 of the high head and half of that of the low one, a scalar (OmniSyn, section 3.6), clamped at infinity."""
    known, sqrt_inv_depth = _split_known(target)
    inverse_depth, weights = sqrt_inv_depth.square(), polar_weights(sqrt_inv_depth)
    high, low = (
        _masked_mean(signed_error(estimate, inverse_depth).abs() * weights, known)
        for estimate in (prediction.high, prediction.low)
    )
    return high + LOW_HEAD_WEIGHT * low


def sqrt_inv_depth_loss(
    sqrt_inv_depth: Float[Tensor, "*batch height width"], target: Float[Tensor, "*batch height width"]
) -> Tensor:
    """Mean absolute error, a scalar; an estimate below zero is right where the target is infinitely far."""
    known, target = _split_known(target)
    return _masked_mean(signed_error(sqrt_inv_depth, target).abs() * polar_weights(target), known)


def _split_known(target: Tensor) -> tuple[Tensor, Tensor]:
    """Where the truth is known, as zeros and ones, and the target with zeros elsewhere."""
    known = torch.isfinite(target)
    return known.to(target.dtype), torch.where(known, target, torch.zeros_like(target))


def _masked_mean(error: Tensor, known: Tensor) -> Tensor:
    """Mean over what is known; 0 where nothing is."""
    return (error * known).mean() / known.mean().clamp(min=torch.finfo(known.dtype).tiny)


def completion_loss(
    prediction: CompletionPrediction, target: Float[Tensor, "batch 1 height width"],
    reliable: Float[Tensor, "batch 1 height width"],
) -> Tensor:  # fmt: skip
    """L1 of both modes and of the likelier one, log-losses, gradients, edges; reliable pixels count less."""
    known, target = _split_known(target)
    area = polar_weights(target) * known
    weight = area * (1.0 + UNRELIABLE_WEIGHT * torch.maximum(1.0 - reliable, _silhouette_mask(target)))
    logit = prediction.mode_logit
    log_probability = torch.cat([functional.logsigmoid(logit), functional.logsigmoid(-logit)], dim=1)
    errors = signed_error(prediction.modes, target).abs()
    log_loss = -torch.logsumexp(log_probability - errors / MODE_ERROR_SCALE, dim=1, keepdim=True)
    expected = (log_probability.exp() * errors).sum(dim=1, keepdim=True)
    likelier = prediction.sqrt_inv_depth()
    error = (expected + signed_error(likelier, target).abs() + MODE_LOG_LOSS_WEIGHT * log_loss) * weight
    gradients, edges = _gradient_and_edge_error(likelier, target, known)
    correct, logit = _is_correct(prediction.inverse_depth(), target.square()), prediction.confidence_logit
    confidence = functional.binary_cross_entropy_with_logits(logit, correct, weight=area)
    return error.mean() + GRADIENT_WEIGHT * gradients + EDGE_WEIGHT * edges + CONFIDENCE_WEIGHT * confidence


def _silhouette_mask(target: Tensor) -> Tensor:
    """1 where the target jumps within a few pixels, over the seam, else 0."""
    reach = SILHOUETTE_WINDOW_PIXELS // 2
    wide = functional.pad(target, (reach, reach, 0, 0), mode="circular")
    greatest, least = (
        functional.max_pool2d(sign * wide, SILHOUETTE_WINDOW_PIXELS, 1, (reach, 0)) for sign in (1.0, -1.0)
    )
    return (greatest + least > MIN_EDGE_STEP).to(target.dtype)


def signed_error(sqrt_inv_depth: Tensor, target: Tensor) -> Tensor:
    """An estimate below zero is right where the target is zero: nothing is there."""
    return torch.where(target > 0, sqrt_inv_depth - target, sqrt_inv_depth.clamp(min=0.0))


def _gradient_and_edge_error(sqrt_inv_depth: Tensor, target: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """L1 of the differences of neighbours: on surfaces, and where the target jumps (the plain L1 has its position)."""
    gradients, edges, weights = [], [], polar_weights(target)
    for dimension, kept in ((-1, slice(None)), (-2, slice(-1))):  # to the right, over the seam, and below
        step, true_step = (x.roll(-1, dimension) - x for x in (sqrt_inv_depth, target))
        error, both_known = ((step - true_step).abs() * weights)[..., kept, :], known * known.roll(-1, dimension)
        is_edge, both_known = true_step.abs()[..., kept, :] >= MIN_EDGE_STEP, both_known[..., kept, :]
        gradients.append(_masked_mean(error * ~is_edge, both_known))
        edges.append((error * is_edge * both_known).mean())
    return torch.stack(gradients).sum(), torch.stack(edges).sum()


def _is_correct(inverse_depth: Tensor, target: Tensor, factor: float = MAX_CORRECT_RATIO) -> Tensor:
    with torch.no_grad():
        larger = torch.maximum(inverse_depth, target).clamp(min=INFINITY_INVERSE_DEPTH)
        smaller = torch.minimum(inverse_depth, target).clamp(min=INFINITY_INVERSE_DEPTH)
        return (larger < factor * smaller).to(inverse_depth.dtype)


@torch.no_grad()
def depth_scores(
    prediction: DepthPrediction, target: Float[Tensor, "batch 1 height width"], baseline: Float[Tensor, " batch"]
) -> dict[str, float]:
    """Figures of the paper's depth table on pixels with 1 m < true depth < 50 m; baselines are in metres.

    ``imae``, 1/m; shares within a factor of 1.05 (``delta_5``), 1.1 and 1.25; ``confidence_error``, the mean of
    |confidence − (within a factor of 1.1)|; ``sky_zero``, the share of infinity below 1e-3 (times baseline), NaN: none.
    """
    scale = baseline.view(-1, 1, 1, 1)
    estimate, truth = prediction.inverse_depth() / scale, target.square() / scale
    scored = (truth < 1.0 / SCORED_DEPTH_RANGE_METRES[0]) & (truth > 1.0 / SCORED_DEPTH_RANGE_METRES[1])
    ratio = torch.maximum(estimate / truth, truth / estimate.clamp(min=1e-6))[scored]
    known = torch.isfinite(target)
    correct = _is_correct(prediction.inverse_depth(), target.square())
    sky = target == 0
    return {
        "imae": float((estimate - truth).abs()[scored].mean()),
        "delta_5": float((ratio < 1.05).float().mean()),
        "delta_10": float((ratio < 1.10).float().mean()),
        "delta_25": float((ratio < 1.25).float().mean()),
        "confidence_error": float((prediction.confidence() - correct).abs()[known].mean()),
        "sky_zero": float((prediction.inverse_depth()[sky] < INFINITY_INVERSE_DEPTH).float().mean()),
    }


@torch.no_grad()
def completion_scores(
    prediction: DepthPrediction, channels: Float[Tensor, "batch channels height width"],
    target: Float[Tensor, "batch 1 height width"],
) -> dict[str, float]:  # fmt: skip
    """Accuracy where matching is unreliable, and elsewhere; means weigh pixels by solid angle.

    ``unsure`` is that share of the sphere; over it mean absolute ``error``, shares ``within_5`` and ``within_25`` %,
    ``confidence_error`` (see :func:`depth_scores`); elsewhere ``error_sure``. ``…_filled``: of the input's filled map.
    """
    filled, reliable = channels[:, FILLED_CHANNEL : FILLED_CHANNEL + 1], reliable_mask(channels)
    known, target = _split_known(target)
    area = polar_weights(target) * known
    unreliable = area * (1.0 - reliable)
    inverse_depth = prediction.inverse_depth()
    correct = _is_correct(inverse_depth, target.square())

    def mean(values: Tensor, weights: Tensor) -> float:
        return float((values * weights).sum() / weights.sum())

    def within(inverse_depth: Tensor, factor: float) -> float:
        return mean(_is_correct(inverse_depth, target.square(), factor), unreliable)

    return {
        "unsure": mean(1.0 - reliable, area), "error": mean((inverse_depth.sqrt() - target).abs(), unreliable),
        "error_filled": mean((filled - target).abs(), unreliable), "within_5": within(inverse_depth, 1.05),
        "within_5_filled": within(filled.square(), 1.05), "within_25": within(inverse_depth, 1.25),
        "within_25_filled": within(filled.square(), 1.25),
        "error_sure": mean((inverse_depth.sqrt() - target).abs(), area * reliable),
        "error_sure_filled": mean((filled - target).abs(), area * reliable),
        "confidence_error": mean((prediction.confidence() - correct).abs(), unreliable),
    }  # fmt: skip


# Weights of absolute errors, and of squared errors in units of the typical one.
ABSOLUTE_WEIGHT, SQUARED_WEIGHT = 0.5, 0.02
TYPICAL_SQUARED_ERROR = 5e-3  # Squared error of the geometric fusion where it is not known: 23 dB
# Floors: easy scenes count at most as those of 40 dB; no picture counts as better than 100 dB.
MIN_TYPICAL_ERROR, MIN_SQUARED_ERROR = 1e-4, 1e-10


def network_inputs(
    config: FusionConfig, channels: Float[Tensor, "batch channels height width"]
) -> Float[Tensor, "batch inputs height width"]:
    """The inputs of a network: all channels, or as in the paper both renderings and both visibility masks."""
    if not config.is_direct:
        return channels
    seen = range(channel.SEEN_MASKS, channel.SEEN_MASKS + 2)
    return channels[:, [*range(channel.FIRST_RGB, channel.SECOND_RGB + 3), *seen]]


def fuse_with(
    network: ResidualFusionUNet | DirectFusionUNet, channels: Float[Tensor, "batch channels height width"],
    pictures: Float[Tensor, "batch 15 rows cols"],
) -> Float[Tensor, "batch 3 _ _"]:  # fmt: skip
    """The fused picture: predicted directly, at the size of the channels, or a mix of the candidates, at theirs."""
    answer = network(network_inputs(network.config, channels))
    return answer if network.config.is_direct else mix_candidates(pictures, answer)


def mix_candidates(
    pictures: Float[Tensor, "batch 15 rows cols"], shares: Float[Tensor, "batch 4 height width"]
) -> Float[Tensor, "batch 3 rows cols"]:
    """The geometric fusion with shares of the candidates, as the program mixes them."""
    fused, *candidates = torch.split(pictures, 3, dim=1)
    shares = functional.interpolate(shares, size=tuple(fused.shape[-2:]), mode="bilinear")
    steps = [shares[:, k : k + 1] * (candidate - fused) for k, candidate in enumerate(candidates)]
    return fused + torch.stack(steps).sum(dim=0)


def downsample_to(picture: Float[Tensor, "batch 3 height width"], image: Tensor) -> Tensor:
    """An image at the size of a picture, which is smaller by a whole factor or has the same."""
    factor = image.shape[-1] // picture.shape[-1]
    return functional.avg_pool2d(image, factor) if factor > 1 else image


def fusion_loss(
    picture: Float[Tensor, "batch 3 height width"], truth: Tensor, typical_error: Float[Tensor, " batch"] | None = None
) -> Tensor:
    """Absolute and squared differences from the truth, weighted half by solid angle and half by pixels; a scalar.

    The truth may be larger by a whole factor. Squared errors are relative to the typical one, that of the geometric
    fusion, so that a decibel counts alike in all scenes. Source: OmniSyn, section 3.6, of the absolute differences.
    """
    if typical_error is None:
        typical_error = picture.new_full((len(picture),), TYPICAL_SQUARED_ERROR)
    truth = downsample_to(picture, truth)
    squared_weight = SQUARED_WEIGHT / (typical_error + MIN_TYPICAL_ERROR)
    error = (picture - truth).abs()
    both = ABSOLUTE_WEIGHT * error + squared_weight[:, None, None, None] * error.square()
    return (both * (0.5 + 0.5 * polar_weights(truth))).mean()


@torch.no_grad()
def fusion_scores(
    picture: Float[Tensor, "1 3 height width"], channels: Float[Tensor, "1 channels _ _"], truth: Tensor,
    geometric: Tensor,
) -> dict[str, float]:  # fmt: skip
    """``ws_psnr`` in dB, ``gain`` over the geometric fusion, absolute ``hole_error`` (NaN: none) and ``hole_gain``."""
    truth, geometric = (downsample_to(picture, image) for image in (truth, geometric))
    is_hole = (channels[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2].sum(dim=1, keepdim=True) == 0).to(picture.dtype)
    hole = functional.interpolate(is_hole, size=tuple(picture.shape[-2:])).expand_as(picture) > 0
    squared = [((x.clamp(0.0, 1.0) - truth).square() * polar_weights(truth)).mean() for x in (picture, geometric)]
    ours, theirs = (float(-10.0 * torch.log10(each.clamp(min=MIN_SQUARED_ERROR))) for each in squared)
    errors = [float((x - truth).abs()[hole].mean()) for x in (picture, geometric)]
    return {"ws_psnr": ours, "gain": ours - theirs, "hole_error": errors[0], "hole_gain": errors[1] - errors[0]}
