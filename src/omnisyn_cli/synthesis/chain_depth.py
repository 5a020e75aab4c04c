"""Depth along a chain: the estimates with all neighbours of a panorama, fused to one.

A panorama inside a chain is compared with the one before it and with the one after it; at a crossing there are more.
Each comparison is blind towards its neighbour and away from it, and behind things each neighbour sees something else.
All estimates are fused once, and the result serves the frames on all sides.

Where they agree the mean is taken, weighted by confidence and by how exactly each could measure: parallax grows with
the distance of a neighbour times the sine of the angle to it. Where they contradict each other the more confident one
is taken, but colours count as well: a place that is where an estimate says has the panorama's colour in at least one of
the neighbours, as the others may be looking at something in front of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import filter_across_seam, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.geometry.tolerances import SAME_POINT_TOLERANCE
from omnisyn_cli.synthesis.consistency import CROSS_CHECK_SIZE, equalize_exposure, resized_to, subsample_depth
from omnisyn_cli.types import DepthEstimate, DepthEstimator, KnownDepth, View

if TYPE_CHECKING:
    from omnisyn_cli.compute.stopwatch import Stopwatch

# Difference of colours that makes an estimate e times less likely where two contradict each other.
COLOUR_MISMATCH_SCALE = 0.02
MAX_COLOUR_MISMATCH = 0.2  # greater differences say no more, as masked pixels do
# Side in pixels, at the size of the check, of the squares that colours are compared in: 29°. In small ones chance
# decides. (Against 3 pixels, tours of five generated places and a corridor have a third fewer shards, and + 0.05 dB.)
MISMATCH_WINDOW_PIXELS = 41


@dataclass(frozen=True)
class PairDepth:
    """What was found of a panorama by comparing it with one neighbour."""

    depth: DepthEstimate  # 1/metre and confidence
    image: Float32[np.ndarray, "height width 3"]  # the panorama at the size of the check, as it was compared
    # the neighbour likewise, in one exposure with it; last, whether it may be used
    other: Float32[np.ndarray, "height width 4"]
    other_from_this: Pose  # takes points of the panorama's frame to the neighbour's, metres

    def parallax_weight(self, size: tuple[int, int]) -> Float[np.ndarray, "height width"]:
        """What a mean is weighted by: the square of the parallax in radians that 1/metre makes, for far things."""
        towards = self.other_from_this.inverse().position
        return np.asarray(np.maximum(towards @ towards - (pixel_directions(*size) @ towards) ** 2, 0.0))

    def mismatch(self, inverse_depth: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
        """How far the neighbour's colours are from the panorama's if its distances are these, at the check's size."""
        directions = pixel_directions(*inverse_depth.shape)
        seen = sample_nearest(
            self.other, sweep_directions(directions, inverse_depth.astype(np.float64), self.other_from_this)
        )
        gap = np.abs(seen[..., :3] - self.image).mean(axis=-1)
        gap = np.where(seen[..., 3] > 0.99, np.minimum(gap, MAX_COLOUR_MISMATCH), MAX_COLOUR_MISMATCH)
        blur = partial(cv2.blur, ksize=(MISMATCH_WINDOW_PIXELS, MISMATCH_WINDOW_PIXELS))
        return filter_across_seam(blur, gap.astype(np.float32), MISMATCH_WINDOW_PIXELS // 2)


def fuse_depth(*pair_depths: PairDepth) -> DepthEstimate:
    """All estimates for a panorama as one, of the size of the largest; their order changes nothing.

    Where they contradict each other, those that agree with the likeliest one are fused.
    """
    size = max(pair_depth.depth.inverse_depth.shape for pair_depth in pair_depths)
    depths = [_enlarged(pair_depth.depth, size) for pair_depth in pair_depths]
    order = [(depth.confidence * _likeness(depth, pair_depths), depth.inverse_depth) for depth in depths]
    _, likeliest = reduce(_likelier, order)
    is_fused = [_agree(likeliest, depth.inverse_depth) for depth in depths]
    fused = list(zip(is_fused, pair_depths, depths, strict=True))
    far = reduce(np.minimum, [np.where(is_in, depth.inverse_depth, np.inf) for is_in, _, depth in fused])
    weights = [np.where(is_in, depth.confidence * one.parallax_weight(size), 0.0) for is_in, one, depth in fused]
    total = reduce(np.add, weights)
    beyond = [weight * (depth.inverse_depth - far) for weight, depth in zip(weights, depths, strict=True)]
    inverse_depth = far + reduce(np.add, beyond) / np.where(total > 0.0, total, 1.0)
    confidence = reduce(np.maximum, [np.where(is_in, depth.confidence, 0.0) for is_in, _, depth in fused])
    return DepthEstimate(inverse_depth.astype(np.float32), confidence.astype(np.float32))


def _likelier(
    one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Of two pairs of a likelihood and an inverse depth the likelier one; of equal ones the farther."""
    (likely, rho), (other_likely, other_rho) = one, other
    is_first = (likely > other_likely) | ((likely == other_likely) & (rho <= other_rho))
    return np.where(is_first, likely, other_likely), np.where(is_first, rho, other_rho)


def _agree(rho: np.ndarray, other_rho: np.ndarray) -> np.ndarray:
    near = np.maximum(rho, other_rho)
    return np.asarray(near - np.minimum(rho, other_rho) <= SAME_POINT_TOLERANCE * near)


def _likeness(depth: DepthEstimate, pair_depths: Sequence[PairDepth]) -> Float32[np.ndarray, "height width"]:
    """How well colours fit to an estimate in the neighbour where they fit best, in (0, 1]."""
    reduced = subsample_depth(depth, pair_depths[0].image.shape[:2]).inverse_depth
    reduced = resized_to(reduced, pair_depths[0].image.shape[:2], cv2.INTER_NEAREST)
    mismatch = reduce(np.minimum, [pair_depth.mismatch(reduced) for pair_depth in pair_depths])
    likeness = np.exp(-mismatch / np.float32(COLOUR_MISMATCH_SCALE))
    return resized_to(likeness, depth.inverse_depth.shape, cv2.INTER_NEAREST)


def _enlarged(depth: DepthEstimate, size: tuple[int, int]) -> DepthEstimate:
    if depth.inverse_depth.shape == size:
        return depth
    directions = pixel_directions(*size)
    return DepthEstimate(*(sample_nearest(np.asarray(x), directions) for x in (depth.inverse_depth, depth.confidence)))


class ChainDepth:
    """The depth of the panoramas of a chain or of any graph, found when it is asked for.

    To know all about the second panorama of a pair, all its other pairs are compared too. What has been found and may
    be needed by the next pairs is kept, nothing else. Answers do not depend on the order in which they are asked for.

    The estimator finds the depth of a pair, in pictures of one exposure; :class:`~omnisyn_cli.types.KnownDepth` is
    taken as it is. ``links`` are indices of the two panoramas of every pair, the first one smaller; None is a chain.
    """

    def __init__(
        self, views: Sequence[View], estimator: DepthEstimator, clock: Stopwatch, threads: int | None = None,
        links: Sequence[tuple[int, int]] | None = None,
    ) -> None:  # fmt: skip
        self.views = views
        self.links = list(pairwise(range(len(views)))) if links is None else links
        self._estimator, self._clock, self._threads = estimator, clock, threads
        self._pair_depths: dict[tuple[int, int], PairDepth | None] = {}
        self._known: dict[int, DepthEstimate] = {}

    def __call__(self, index: int) -> tuple[DepthEstimate, DepthEstimate]:
        """Of both views of the pair number ``index``, which must not stand at one place."""
        first, second = self.links[index]
        if isinstance(self._estimator, KnownDepth):
            views = self.views[first], self.views[second]
            with self._clock("depth"):
                return self._estimator(*views)
        depths = self._fused_depth(first), self._fused_depth(second)
        needed = {view for link in self.links[index:] for view in link}
        self._known = {view: depth for view, depth in self._known.items() if view in needed}
        return depths

    def _fused_depth(self, view: int) -> DepthEstimate:
        if view not in self._known:
            others = [link[1] if link[0] == view else link[0] for link in self.links if view in link]
            pair_depths = [pair_depth for other in others if (pair_depth := self._pair_depth(view, other)) is not None]
            with self._clock("depth"):
                self._known[view] = pair_depths[0].depth if len(pair_depths) == 1 else fuse_depth(*pair_depths)
            for other in others:
                del self._pair_depths[view, other]
        return self._known[view]

    def _pair_depth(self, view: int, other: int) -> PairDepth | None:
        if (view, other) not in self._pair_depths:
            first, second = min(view, other), max(view, other)
            found = self._estimate_pair_depths(first, second)
            self._pair_depths.update({key: found[key] for key in found if key[0] not in self._known})
        return self._pair_depths[view, other]

    def _estimate_pair_depths(self, here: int, there: int) -> dict[tuple[int, int], PairDepth | None]:
        """What a pair says of both its views; nothing where they stand at one place."""
        first, second = self.views[here], self.views[there]
        if at_same_position(first.pose, second.pose):
            return {(here, there): None, (there, here): None}
        with self._clock("depth"):
            alike = equalize_exposure(first, second, self._threads)
            depths = self._estimator(*alike)
            size = min(CROSS_CHECK_SIZE, *(view.image.shape[:2] for view in alike))
            pictures = [_reduced(view, size) for view in alike]
            forth, back = (
                PairDepth(depths[k], pictures[k][..., :3], pictures[1 - k], alike[1 - k].pose.inverse() @ alike[k].pose)
                for k in (0, 1)
            )
        return {(here, there): forth, (there, here): back}


def _reduced(view: View, size: tuple[int, int]) -> Float32[np.ndarray, "height width 4"]:
    """The picture at the size of the check and, last, which of its pixels may be used."""
    usable = np.ones(size, np.float32) if view.mask is None else resize_area(view.mask, size)
    return np.dstack([resize_area(view.image, size), usable])
