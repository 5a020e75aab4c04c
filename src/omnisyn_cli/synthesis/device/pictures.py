"""What is done to whole pictures on a device: another exposure, holes filled, numbers rounded to samples."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from omnisyn_cli.fusion.photometry.exposure_matcher import CLIPPING_SRGB


def change_colours(
    table: Float32[np.ndarray, "3 entries"], loss: np.float32
) -> Callable[[Float32[Tensor, "*pixels 4"]], None]:
    """What exposes colours on any device, in place, see :class:`omnisyn_cli.fusion.photometry.ExposureMatcher`.

    Args:
        table: new values for values from 0 to 1, evenly; others go on in proportion to its ends.
        loss: share of its weight that a white pixel loses.
    """
    last, clipping = table.shape[1] - 1, float(CLIPPING_SRGB)

    def change(colour: Tensor) -> None:
        there, channel = torch.from_numpy(table).to(colour.device), torch.arange(3, device=colour.device)
        value = colour[..., :3].clone()
        clipped = ((value.amax(-1) - clipping) / (1.0 - clipping)).clamp(0.0, 1.0)
        place = value.clamp(0.0, 1.0) * last
        index = place.to(torch.int64).clamp_max(last - 1)
        low, high = there[channel, index], there[channel, index + 1]
        found = low + (place - index) * (high - low)
        found = torch.where(value <= 0.0, value * there[:, 1] * last, found)
        colour[..., :3] = torch.where(value >= 1.0, value * there[:, last], found)
        colour[..., 3] *= 1.0 - float(loss) * clipped

    return change


def samples_of(image: Float32[Tensor, "height width 3"]) -> UInt8[Tensor, "height width 3"]:
    """Numbers in [0, 1] as one of 256 levels, rounded."""
    return (image.clamp(0.0, 1.0) * 255.0 + 0.5).to(torch.uint8)


def fill_holes(image: Float32[Tensor, "height width 3"], weight: Float32[Tensor, "height width"]) -> None:
    """:class:`omnisyn_cli.fusion.fill.HoleFiller`: fill, in place, the pixels of ``image`` whose ``weight`` is 0.

    Args:
        image: RGB; wraps at the seam.
        weight: >= 0; how much a pixel counts for the holes around it. Without any weight the image becomes black.
    """
    levels = [(image, weight)]
    while max(levels[-1][1].shape) > 1:
        levels.append(_pull_level(*levels[-1]))
    for finer, coarser in zip(levels[-2::-1], levels[:0:-1], strict=True):
        _fill_from_coarser(*coarser, *finer)


def _pull_level(colour: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted means over 2×2 pixels; an odd last row or column stands alone."""
    rows, cols = -(-weight.shape[0] // 2), -(-weight.shape[1] // 2)
    even = weight.new_zeros((2 * rows, 2 * cols, 4))
    some = even[: weight.shape[0], : weight.shape[1]]
    some[..., :3], some[..., 3] = torch.where(weight[..., None] > 0.0, colour, 0.0) * weight[..., None], weight
    sums = even.reshape(rows, 2, cols, 2, 4).sum((1, 3))
    total = sums[..., 3:]
    return sums[..., :3] / torch.where(total > 0.0, total, 1.0), sums[..., 3].contiguous()


def _fill_from_coarser(coarse_colour: Tensor, coarse_weight: Tensor, colour: Tensor, weight: Tensor) -> None:
    """Holes get the coarse colours, bilinearly and by weight, and a weight of their own; rows end at the poles."""
    row, col = (weight <= 0.0).nonzero(as_tuple=True)
    near_row, near_col = row // 2, col // 2
    far_row = (near_row - 1 + 2 * (row % 2)).clamp(0, len(coarse_weight) - 1)
    far_col = (near_col - 1 + 2 * (col % 2)) % coarse_weight.shape[1]
    rows, cols = ((near_row, 0.75), (far_row, 0.25)), ((near_col, 0.75), (far_col, 0.25))
    share = torch.stack([down * across * coarse_weight[i, j] for i, down in rows for j, across in cols])
    around = torch.stack([coarse_colour[i, j] for i, _ in rows for j, _ in cols])
    total = share.sum(0)
    colour[row, col] = (share[..., None] * around).sum(0) / torch.where(total > 0.0, total, 1.0)[:, None]
    weight[row, col] = 0.25 * total
