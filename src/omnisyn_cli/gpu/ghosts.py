"""Things that moved, found and silenced as in :mod:`omnisyn_cli.fusion.ghosts`, without leaving the device.

Regions of cells are told apart by letting the greatest number spread over neighbours; sums over regions are made of
whole numbers, so that they do not depend on the order of adding.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float32, Integer
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d, pad

from omnisyn_cli.fusion.ghosts import (
    ENDLESS,
    LEAST_CELL,
    NEARBY,
    ROWS_OF_CELLS,
    SAMPLES_ALONG_CELL,
    GhostOptions,
    samples_of_cells,
)
from omnisyn_cli.fusion.options import BlendOptions
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.gpu.blending import Shown
from omnisyn_cli.types import BELIEF, UNSEEN

__all__ = ["GpuGhosts"]

SPREADINGS = 16
"""Steps of spreading after which it is asked whether anything has changed."""

PREFERENCE_STEPS = 2.0**20
"""Parts of 1 in which preferences are added."""


class GpuGhosts:
    """Takes the worth of one of two renderings away where blending them would show a ghost."""

    def __init__(self, size: tuple[int, int], device: torch.device) -> None:
        self.size, self.blend, self.options = size, BlendOptions(), GhostOptions()
        self.cell = max(LEAST_CELL, -(-size[0] // ROWS_OF_CELLS))
        step = max(1, self.cell // SAMPLES_ALONG_CELL)
        self._along = -(-self.cell // step)
        self._grid = (-(-size[0] // self.cell), -(-size[1] // self.cell))
        self.rows, self.cols = (torch.from_numpy(samples_of_cells(count, self.cell, step)).to(device) for count in size)
        self._directions = torch.from_numpy(pixel_directions(*self._grid)).to(device, torch.float32)

    def losers(self, first: Shown, second: Shown, t: float, strictness: float) -> Float32[Tensor, "rows cols"]:
        """By cell: 1 in regions where the first view wins (the second loses), −1 where the second does, 0 elsewhere.

        Args:
            first: of the first view, where :attr:`rows` and :attr:`cols` cross.
            second: likewise.
            t: share of the way.
            strictness: how strictly the nearer surface hides the farther one in the blend, from 0 to 1.
        """
        sums = self._gathered(first, second)
        differs = self._differing(sums)
        preference = self._preference(sums, first.offset, second.offset, t, strictness)
        labels = _labelled(differs)
        votes = torch.zeros(labels.numel() + 1, dtype=torch.int64, device=labels.device)
        votes.scatter_add_(0, labels.flatten(), (preference * PREFERENCE_STEPS).round().to(torch.int64).flatten())
        return torch.where(differs, torch.where(votes[labels] >= 0, 1.0, -1.0), 0.0)

    def silence(self, first: Tensor, second: Tensor, losers: Float32[Tensor, "rows cols"], top: int) -> None:
        """Take worth of the losing view away, in place, gradually at the border of a region.

        Args:
            first: ``(rows, width, 4)`` RGB and worth of some rows.
            second: likewise.
            losers: of :meth:`losers`.
            top: row of the picture that the first of them is.
        """
        upper, lower, down = self._neighbours(torch.arange(len(first), device=first.device) + top)
        left, right, across = self._neighbours(torch.arange(self.size[1], device=first.device))
        rows, cols = losers.shape
        line = torch.lerp(losers[upper.clamp(0, rows - 1)], losers[lower.clamp(0, rows - 1)], down[:, None])
        value = torch.lerp(line[:, left % cols], line[:, right % cols], across)
        both = (first[..., 3] > float(UNSEEN)) & (second[..., 3] > float(UNSEEN))
        first[..., 3] *= torch.where(both, 1.0 + value.clamp_max(0.0), 1.0)
        second[..., 3] *= torch.where(both, 1.0 - value.clamp_min(0.0), 1.0)

    def _neighbours(self, pixel: Integer[Tensor, " pixels"]) -> tuple[Tensor, Tensor, Tensor]:
        """Cells whose centres a pixel's lies between, and how far it is from the first of them."""
        place = (pixel + 0.5) / self.cell - 0.5
        before = torch.floor(place)
        index = before.to(torch.int64)
        return index, index + 1, place - before

    def _gathered(self, first: Shown, second: Shown) -> Float32[Tensor, "rows cols 11"]:
        """Sums over the pixels of each cell that both see: count, colours, worths and inverse depths of both."""
        both = ((first.colour[..., 3] > float(UNSEEN)) & (second.colour[..., 3] > float(UNSEEN)))[..., None]
        values = [
            torch.ones_like(both, dtype=torch.float32), first.colour[..., :3], second.colour[..., :3],
            first.colour[..., 3:], second.colour[..., 3:],
            first.inverse_depth[..., None].clamp_min(0.0), second.inverse_depth[..., None].clamp_min(0.0),
        ]  # fmt: skip
        counted = torch.where(both, torch.cat(values, dim=-1), 0.0)
        rows, cols = (count * self._along for count in self._grid)
        whole = pad(counted, (0, 0, 0, cols - counted.shape[1], 0, rows - counted.shape[0]))
        return whole.reshape(self._grid[0], self._along, self._grid[1], self._along, 11).sum((1, 3))

    def _differing(self, sums: Float32[Tensor, "rows cols 11"]) -> Bool[Tensor, "rows cols"]:
        """Cells of different things: not thin, and grown by what an opening took from their edges."""
        count, reach = sums[..., 0], min(self.options.neighbourhood, *(n // 2 - 1 for n in self._grid))
        if reach < NEARBY:
            return torch.zeros_like(count, dtype=torch.bool)
        first, second = (sums[..., k : k + 3] / count.clamp_min(1.0)[..., None] for k in (1, 4))
        plain = first - second
        second = second + _box_mean(plain, count, reach)
        least, seen = self.options.difference, count > 0.0
        differs = seen & (plain.abs().amax(-1) > least) & ((first - second).abs().amax(-1) > least)
        differs &= torch.maximum(_beyond(first, second, seen), _beyond(second, first, seen)) > self.options.beyond
        core = -_greatest_near(-differs.to(torch.float32)[None], 1)
        return _greatest_near(core, 2)[0] > 0.0

    def _preference(
        self, sums: Tensor, first_offset: Tensor, second_offset: Tensor, t: float, strictness: float
    ) -> Float32[Tensor, "rows cols"]:
        """log(weight of the first / weight of the second) in the blend, by cell; 0 where only one sees anything."""
        count = sums[..., 0].clamp_min(1.0)
        worths = [(sums[..., k] / count).clamp_min(1e-6) for k in (7, 8)]
        rhos = [sums[..., k] / count for k in (9, 10)]
        near = [
            -1.5 * torch.log((self._directions - rho[..., None] * offset).square().sum(-1) + 1e-8)
            for rho, offset in zip(rhos, (first_offset, second_offset), strict=True)
        ]
        gap = (rhos[0] - rhos[1]) / (torch.maximum(*rhos) * self.blend.disagreement + 1e-9)
        believed = (BELIEF * torch.where(gap > 0.0, worths[0], worths[1])).clamp_max(1.0)
        rest = 1.0 - believed * (1.0 - torch.exp((-gap.square()).clamp_min(strictness * math.log(self.blend.hidden))))
        hides = -gap.sign() * torch.log(rest)
        share = math.log(max(1.0 - t, 1e-9) / max(t, 1e-9))
        found = share + torch.log(worths[0] / worths[1]) + near[0] - near[1] + hides
        return torch.where(sums[..., 0] > 0.0, found, 0.0)


def _around_the_seam(planes: Float32[Tensor, "planes rows cols"], reach: int) -> Tensor:
    """Columns repeated on either side."""
    return torch.cat([planes[..., -reach:], planes, planes[..., :reach]], dim=-1)


def _greatest_near(planes: Float32[Tensor, "planes rows cols"], reach: int) -> Float32[Tensor, "planes rows cols"]:
    """Maxima over squares that wrap at the seam and end at the poles."""
    wide = _around_the_seam(planes, reach)
    return max_pool2d(wide[None], 2 * reach + 1, stride=1, padding=(reach, 0))[0]


def _beyond(one: Tensor, other: Tensor, seen: Tensor) -> Float32[Tensor, "rows cols"]:
    """How far the colours of one lie outside of the range that the other has around the same place."""
    one, other = one.movedim(-1, 0), other.movedim(-1, 0)
    highest = _greatest_near(torch.where(seen, other, -ENDLESS), NEARBY)
    lowest = -_greatest_near(torch.where(seen, -other, -ENDLESS), NEARBY)
    return torch.maximum(one - highest, lowest - one).amax(0)


def _box_mean(values: Tensor, weight: Tensor, reach: int) -> Float32[Tensor, "rows cols 3"]:
    """Weighted means over squares that wrap at the seam and are mirrored at the poles."""
    planes = torch.cat([values * weight[..., None], weight[..., None]], dim=-1).movedim(-1, 0)
    tall = torch.cat([planes[:, :reach].flip(1), planes, planes[:, -reach:].flip(1)], dim=1)
    means = avg_pool2d(_around_the_seam(tall, reach)[None], 2 * reach + 1, stride=1)[0]
    return (means[:3] / means[3].clamp_min(1e-6)).movedim(0, -1)


def _labelled(differs: Bool[Tensor, "rows cols"]) -> Integer[Tensor, "rows cols"]:
    """A number > 0 for every region of neighbouring cells, diagonal ones and those across the seam included; else 0."""
    numbers = torch.arange(1, differs.numel() + 1, dtype=torch.float32, device=differs.device)
    inside = differs.to(torch.float32)[None]
    labels = numbers.reshape(inside.shape) * inside
    while True:
        before = labels
        for _ in range(SPREADINGS):
            labels = _greatest_near(labels, 1) * inside
        if torch.equal(before, labels):
            return labels[0].to(torch.int64)
