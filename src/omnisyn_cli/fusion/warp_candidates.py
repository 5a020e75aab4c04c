"""A second look at the photographs, where their surfaces may be wrong.

What a rendering shows is what its own depth makes of a photograph. Where that depth is wrong, mostly beside edges, the
right colour is in none of the renderings, but it is in the photographs: they show every point somewhere. So for every
pixel two surfaces are supposed, the nearest and the farthest one that either rendering shows around it, and both
photographs are asked what they show there (:class:`omnisyn_cli.types.SourceSampler`). That makes four more candidates for the
colour of a pixel, also where only one view or none shows anything. What each photograph shows where the *other* view's
surface is, and whether its own depth agrees, tells which of the renderings to believe.

Planes for the network, ``LOOKS`` of them, float32, after those of :mod:`omnisyn_cli.fusion.input_channels`:

* ``CONFRONTED``: for what the first rendering shows, and then for what the second does, at the same point in the other
  view: its colour (3), the mean difference of the colours, how much nearer its surface is, and how much farther,
  both in [0, 1];
* ``CANDIDATES``: colours of both photographs at the farthest surface, then at the nearest (3 each),
* ``SUPPOSED``: roots of inverse depth × baseline of the farthest surface and of the nearest,
* ``CONTRADICTED``: how much nearer (positive) or farther the views' own surfaces are, for each candidate, in [−1, 1],
* ``UNLIKE``: mean difference of the colours of both photographs at the farthest surface and at the nearest.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.fusion.blend_kernels import Quantization, quantization_for
from omnisyn_cli.fusion.blend_rule import BlendOptions, LayerArrays
from omnisyn_cli.fusion.ghost_grid import greatest_near
from omnisyn_cli.fusion.input_channels import GREATEST_GAP, PLANES, sqrt_inverse_depth
from omnisyn_cli.fusion.layer_pair import ROWS
from omnisyn_cli.fusion.warp_candidate_kernels import add_rows, average_candidates, hypothesis_rows, join_rows
from omnisyn_cli.types import SourceSampler

__all__ = ["CANDIDATES", "LOOKS", "SUPPOSED", "WarpCandidates"]

CONFRONTED, CANDIDATES, SUPPOSED, CONTRADICTED, UNLIKE = (PLANES + k for k in (0, 12, 24, 26, 30))
LOOKS = 32

FINER = 2
"""Second looks are taken at so many times the height of the planes, and averaged."""

REACH = 4
"""Rows and columns of a second look to every side, within which the nearest and the farthest surface are taken."""

LEAST = 1e-3
"""Inverse depth × baseline that is next to nothing."""

MOST_NEARER = BlendOptions().disagreement * GREATEST_GAP
"""Share of inverse depth by which a surface is as much nearer, or farther, as is told."""

LEAST_SHARE = np.float32(0.02)
"""Of a candidate, below which it is not looked up; up to twice that it sets in. A fresh network gives less."""

NOWHERE = np.float32(1e9)
"""Inverse depth of what is not seen, nearer than everything."""

Picture = Shaped[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class WarpCandidates:
    """What both photographs show where surfaces are supposed.

    Attributes:
        planes: ``(LOOKS, height, width)``, at the size of the network's planes.
        supposed: ``(2, rows, cols)`` inverse depth from the target of the farthest and of the nearest surface around
            every pixel, at :data:`FINER` times that size.
        witnesses: of both views.
    """

    planes: Float32[np.ndarray, "planes height width"]
    supposed: Float32[np.ndarray, "2 rows cols"]
    source_samplers: tuple[SourceSampler, SourceSampler]

    def mix_in(self, shares: Float32[np.ndarray, "4 height width"], picture: Picture, threads: int | None) -> None:
        """Give candidates their share of a picture.

        Args:
            shares: of the farthest surface in the first and in the second photograph, and of the nearest, at any size;
                what they leave of 1 is the picture's own.
            picture: numbers or samples, changed.
            threads: at most this many.
        """
        height, storing = len(picture), quantization_for(picture)
        shares = shares * np.clip(shares / LEAST_SHARE - np.float32(1.0), 0.0, 1.0)
        per_row = shares.max(axis=(0, 2))

        def mix(begin: int, end: int) -> None:
            for top in range(begin * ROWS, min(end * ROWS, height), ROWS):
                bottom = min(top + ROWS, height)
                above, below = (row * len(per_row) // height for row in (top, bottom - 1))
                if per_row[max(above - 1, 0) : below + 2].any():
                    self._mix_rows(shares, picture[top:bottom], top, height, storing)

        run_bands(mix, -(-height // ROWS), threads)

    def candidates(self, size: tuple[int, int]) -> Float32[np.ndarray, "4 height width 4"]:
        """RGB and alpha of both photographs at the farthest surface, then at the nearest, for a frame of a size."""
        points, everywhere = np.empty(size, np.float32), np.ones((1, 1), np.float32)
        colours = np.empty((4, *size, 4), np.float32)
        for k, (colour, source_sampler) in enumerate(zip(colours, 2 * self.source_samplers, strict=True)):
            hypothesis_rows(self.supposed[k // 2], everywhere, 0, size[0], points)
            source_sampler.colour_rows(points, 0, colour)
        return colours

    def _mix_rows(self, shares: np.ndarray, rows: Picture, top: int, height: int, storing: Quantization) -> None:
        points, colour = np.empty(rows.shape[:2], np.float32), np.empty((*rows.shape[:2], 4), np.float32)
        total = np.zeros_like(colour)
        for k, (share, source_sampler) in enumerate(zip(shares, 2 * self.source_samplers, strict=True)):
            if hypothesis_rows(self.supposed[k // 2], share, top, height, points):
                source_sampler.colour_rows(points, top, colour)
                add_rows(share, colour, top, height, total)
        join_rows(total, storing, rows)


def make_warp_candidates(
    first: LayerArrays, second: LayerArrays, source_samplers: tuple[SourceSampler, SourceSampler], baseline: float, threads: int | None
) -> WarpCandidates:
    """Ask both photographs.

    Args:
        first: what the target sees of the first view, at :data:`FINER` times the size of the planes.
        second: of the second view.
        witnesses: of both.
        baseline: how far apart both views are, in the unit that depth is measured in.
        threads: at most this many.
    """
    supposed, shown = depth_hypotheses(first, second), (first.colour, second.colour)
    points = [*map(_points, (first, second)), *supposed.repeat(2, axis=0)]
    asked = [*source_samplers[::-1], *source_samplers, *source_samplers]
    colours = np.stack([source_sampler.colour(each) for source_sampler, each in zip(asked, points, strict=True)])
    least = LEAST / baseline
    nearer = np.stack([source_sampler.nearer(each, least) for source_sampler, each in zip(asked, points, strict=True)])
    roots, unit = sqrt_inverse_depth(supposed * np.float32(baseline)), np.float32(MOST_NEARER)
    planes = np.empty((LOOKS, *(count // FINER for count in supposed.shape[1:])), np.float32)
    seen = np.stack(points[:2])
    average = partial(average_candidates, shown, seen, colours, nearer, roots, unit, planes)
    run_bands(average, planes.shape[1], threads)
    return WarpCandidates(planes, supposed, source_samplers)


def depth_hypotheses(first: LayerArrays, second: LayerArrays) -> Float32[np.ndarray, "2 rows cols"]:
    """Inverse depth of the farthest and of the nearest surface that is seen around every pixel; 0 where none is."""
    seen = [_points(view) for view in (first, second)]
    nearest = greatest_near(np.maximum(*seen), REACH)
    farthest = -greatest_near(-np.minimum(*(np.where(near < 0.0, NOWHERE, near) for near in seen)), REACH)
    nearest = np.maximum(nearest, np.float32(0.0))
    return np.stack([np.minimum(farthest, nearest), nearest])


def _points(view: LayerArrays) -> Float32[np.ndarray, "rows cols"]:
    """Inverse depth of what a view shows; −1 where it shows nothing."""
    return np.asarray(np.where(view.is_seen, view.near, -1.0), np.float32)
