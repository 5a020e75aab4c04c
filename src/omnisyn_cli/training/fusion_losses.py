"""The losses of fusion networks, and the figures they are judged by."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.networks.fusion import DirectFusionUNet, FusionConfig, ResidualFusionUNet
from omnisyn_cli.training.losses import polar_weights

ABSOLUTE_WEIGHT, SQUARED_WEIGHT = 0.5, 0.02
"""Weights of absolute errors, and of squared errors in units of the typical one."""

TYPICAL_SQUARED_ERROR = 5e-3  # Squared error of the geometric fusion where it is not known: 23 dB

MIN_TYPICAL_ERROR, MIN_SQUARED_ERROR = 1e-4, 1e-10
"""Floors: easy scenes count at most as those of 40 dB; no picture counts as better than 100 dB."""


def network_inputs(
    config: FusionConfig, channels: Float[Tensor, "batch channels height width"]
) -> Float[Tensor, "batch inputs height width"]:
    """The inputs of a network: all channels, or as in the paper both renderings and both visibility masks."""
    if not config.is_direct:
        return channels
    return torch.cat(
        [
            channels[:, channel.FIRST_RGB : channel.SECOND_RGB + 3],
            channels[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2],
        ],
        dim=1,
    )


def fuse_with(
    network: ResidualFusionUNet | DirectFusionUNet,
    channels: Float[Tensor, "batch channels height width"],
    pictures: Float[Tensor, "batch 15 rows cols"],
) -> Float[Tensor, "batch 3 _ _"]:
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

    The truth has the size of the picture, or is larger by a whole factor. Squared errors are divided by the typical
    one, that of the geometric fusion: a decibel in an easy scene then counts as much as one in a hard scene.

    Source: OmniSyn, section 3.6, of the absolute differences.
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
    picture: Float[Tensor, "1 3 height width"],
    channels: Float[Tensor, "1 channels _ _"],
    truth: Tensor,
    geometric: Tensor,
) -> dict[str, float]:
    """Compare a picture, and the geometric fusion, with the truth; these are made as small as the picture.

    Returns:
        ``ws_psnr`` in dB; ``gain``, dB more than the geometric fusion; ``hole_error``, the mean absolute error in
        holes, NaN where there are none; ``hole_gain``, by how much it is less than that of the geometric fusion.
    """
    truth, geometric = (downsample_to(picture, image) for image in (truth, geometric))
    is_hole = (channels[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2].sum(dim=1, keepdim=True) == 0).to(picture.dtype)
    hole = functional.interpolate(is_hole, size=tuple(picture.shape[-2:])).expand_as(picture) > 0
    ours, theirs = (_ws_psnr(x, truth) for x in (picture, geometric))
    errors = [float((x - truth).abs()[hole].mean()) for x in (picture, geometric)]
    return {"ws_psnr": ours, "gain": ours - theirs, "hole_error": errors[0], "hole_gain": errors[1] - errors[0]}


def _ws_psnr(picture: Tensor, truth: Tensor) -> float:
    squared = ((picture.clamp(0.0, 1.0) - truth).square() * polar_weights(truth)).mean()
    return float(-10.0 * torch.log10(squared.clamp(min=MIN_SQUARED_ERROR)))
