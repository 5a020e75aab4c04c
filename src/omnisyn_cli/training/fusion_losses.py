"""What the fusion network is told about its pictures, and the figures it is judged by."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.networks.fusion import FusionConfig, FusionNetwork, PaintingNetwork
from omnisyn_cli.training.losses import polar_weights

ABSOLUTE_WEIGHT, SQUARED_WEIGHT = 0.5, 0.02
"""Of absolute errors, and of squared ones over those that are usual."""

USUAL_ERROR = 5e-3
"""Squared error that is usual where nobody says otherwise."""

LEAST_USUAL, LEAST_ERROR = 1e-4, 1e-10


def inputs_of(
    config: FusionConfig, planes: Float[Tensor, "batch planes height width"]
) -> Float[Tensor, "batch inputs height width"]:
    """What a network takes of the planes: all, or as in the paper both renderings and both visibility masks."""
    if not config.paints:
        return planes
    return torch.cat([planes[:, channel.FIRST_RGB : channel.SECOND_RGB + 3], planes[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2]], dim=1)


def fused_by(
    network: FusionNetwork | PaintingNetwork,
    planes: Float[Tensor, "batch planes height width"],
    shown: Float[Tensor, "batch 15 rows cols"],
) -> Float[Tensor, "batch 3 _ _"]:
    """The picture that a network makes of the planes: painted, at their size; else mixed of what is shown, at its."""
    answer = network(inputs_of(network.config, planes))
    return answer if network.config.paints else mixed(shown, answer)


def mixed(
    shown: Float[Tensor, "batch 15 rows cols"], shares: Float[Tensor, "batch 4 height width"]
) -> Float[Tensor, "batch 3 rows cols"]:
    """The geometric fusion with shares of the candidates, as the program mixes them."""
    fused, *candidates = torch.split(shown, 3, dim=1)
    shares = functional.interpolate(shares, size=tuple(fused.shape[-2:]), mode="bilinear")
    steps = [shares[:, k : k + 1] * (candidate - fused) for k, candidate in enumerate(candidates)]
    return fused + torch.stack(steps).sum(dim=0)


def at_size_of(picture: Float[Tensor, "batch 3 height width"], image: Tensor) -> Tensor:
    """An image at the size of a picture, which is smaller by a whole factor or has the same."""
    factor = image.shape[-1] // picture.shape[-1]
    return functional.avg_pool2d(image, factor) if factor > 1 else image


def fusion_loss(
    picture: Float[Tensor, "batch 3 height width"], truth: Tensor, usual: Float[Tensor, " batch"] | None = None
) -> Tensor:
    """Absolute and squared differences from the truth, weighted half by solid angle and half by pixels; a scalar.

    Args:
        picture: what is judged.
        truth: likewise.
        usual: squared error that pictures of such scenes have, over which squares are taken: a decibel in an easy scene
            then counts as much as one in a hard scene.

    Source: OmniSyn, section 3.6, of the absolute differences.
    """
    usual, truth = (
        picture.new_full((len(picture),), USUAL_ERROR) if usual is None else usual,
        at_size_of(picture, truth),
    )
    squared_weight = SQUARED_WEIGHT / (usual + LEAST_USUAL)
    error = (picture - truth).abs()
    both = ABSOLUTE_WEIGHT * error + squared_weight[:, None, None, None] * error.square()
    return (both * (0.5 + 0.5 * polar_weights(truth))).mean()


@torch.no_grad()
def fusion_scores(
    picture: Float[Tensor, "1 3 height width"], planes: Float[Tensor, "1 planes _ _"], truth: Tensor, geometric: Tensor
) -> dict[str, float]:
    """Compare a picture, and the geometric fusion, with the truth; these are made as small as the picture.

    Returns:
        ``ws_psnr`` in dB; ``gain``, dB more than the geometric fusion; ``hole_error``, the mean absolute error in
        holes, NaN where there are none; ``hole_gain``, by how much it is less than that of the geometric fusion.
    """
    truth, geometric = (at_size_of(picture, image) for image in (truth, geometric))
    is_hole = (planes[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2].sum(dim=1, keepdim=True) == 0).to(picture.dtype)
    hole = functional.interpolate(is_hole, size=tuple(picture.shape[-2:])).expand_as(picture) > 0
    ours, theirs = (_decibels(x, truth) for x in (picture, geometric))
    errors = [float((x - truth).abs()[hole].mean()) for x in (picture, geometric)]
    return {"ws_psnr": ours, "gain": ours - theirs, "hole_error": errors[0], "hole_gain": errors[1] - errors[0]}


def _decibels(picture: Tensor, truth: Tensor) -> float:
    squared = ((picture.clamp(0.0, 1.0) - truth).square() * polar_weights(truth)).mean()
    return float(-10.0 * torch.log10(squared.clamp(min=LEAST_ERROR)))
