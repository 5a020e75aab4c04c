"""Depth along a tour: what both neighbours of a panorama say of it, joined to one estimate.

A panorama inside a chain is compared with the one before it and with the one after it. Each comparison is blind towards
its neighbour and away from it, and behind things each neighbour sees something else. What both found is joined once and
serves the frames on both sides.

Where they agree the mean is taken, weighted by confidence and by how exactly each could measure: parallax grows with
the distance of a neighbour times the sine of the angle to it. Where they contradict each other the more confident one
is taken, but colours count as well: a place that is where an estimate says has the panorama's colour in at least one of
the neighbours, as the other one may be looking at something in front of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.geometry.sampling import filter_across_seam, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.geometry.tolerances import SAME_POINT_TOLERANCE
from omnisyn_cli.synthesis.consistency import CROSS_CHECK_SIZE, equalize_exposure, resized_to, subsample_depth
from omnisyn_cli.types import DepthEstimate, DepthEstimator, KnownDepth, View

if TYPE_CHECKING:
    from omnisyn_cli.compute.stopwatch import Stopwatch

__all__ = ["ChainDepth"]

COLOUR_MISMATCH_SCALE = 0.02
"""Difference of colours that makes an estimate e times less likely where two contradict each other."""

MAX_COLOUR_MISMATCH = 0.2
"""Greater differences say no more, as masked pixels do."""

MISMATCH_WINDOW_PIXELS = 3
"""Side in pixels, at the size of the check, of the squares that colours are compared in."""


@dataclass(frozen=True)
class PairDepth:
    """What was found of a panorama by comparing it with one neighbour.

    Attributes:
        depth: 1/metre and confidence.
        image: ``(height, width, 3)`` the panorama at the size of the check, as it was compared.
        other: ``(height, width, 4)`` the neighbour likewise, in one exposure with it; last, whether it may be used.
        other_from_this: takes points of the panorama's frame to the neighbour's, metres.
    """

    depth: DepthEstimate
    image: Float32[np.ndarray, "height width 3"]
    other: Float32[np.ndarray, "height width 4"]
    other_from_this: Pose

    def exactness(self, size: tuple[int, int]) -> Float[np.ndarray, "height width"]:
        """What a mean is weighted by: the square of the parallax in radians that 1/metre makes, for far things."""
        towards = self.other_from_this.inverse().position
        return np.asarray(np.maximum(towards @ towards - (pixel_directions(*size) @ towards) ** 2, 0.0))

    def mismatch(self, inverse_depth: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
        """How far the neighbour's colours are from the panorama's if its distances are these, at the check's size."""
        moved = sweep_directions(
            pixel_directions(*inverse_depth.shape), inverse_depth.astype(np.float64), self.other_from_this
        )
        seen = sample_nearest(self.other, moved)
        gap = np.abs(seen[..., :3] - self.image).mean(axis=-1)
        gap = np.where(seen[..., 3] > 0.99, np.minimum(gap, MAX_COLOUR_MISMATCH), MAX_COLOUR_MISMATCH)
        return filter_across_seam(
            partial(cv2.blur, ksize=(MISMATCH_WINDOW_PIXELS, MISMATCH_WINDOW_PIXELS)),
            gap.astype(np.float32),
            MISMATCH_WINDOW_PIXELS // 2,
        )


def fuse_depth(one: PairDepth, other: PairDepth) -> DepthEstimate:
    """Both opinions of a panorama as one estimate, of the size of the larger; their order changes nothing."""
    size = max(one.depth.inverse_depth.shape, other.depth.inverse_depth.shape)
    depths = [_enlarged(pair_depth.depth, size) for pair_depth in (one, other)]
    (rho, sure), (other_rho, other_sure) = ((depth.inverse_depth, depth.confidence) for depth in depths)
    near, far = np.maximum(rho, other_rho), np.minimum(rho, other_rho)
    likely, other_likely = (depth.confidence * _likeness(depth, (one, other)) for depth in depths)
    is_first = (likely > other_likely) | ((likely == other_likely) & (rho == far))
    weight, other_weight = sure * one.exactness(size), other_sure * other.exactness(size)
    weight_of_near = np.where(rho == near, weight, other_weight)
    share = weight_of_near / np.where(weight + other_weight > 0.0, weight + other_weight, 1.0)
    agree = near - far <= SAME_POINT_TOLERANCE * near
    inverse_depth = np.where(agree, far + share * (near - far), np.where(is_first, rho, other_rho))
    confidence = np.where(agree, np.maximum(sure, other_sure), np.where(is_first, sure, other_sure))
    return DepthEstimate(inverse_depth.astype(np.float32), confidence.astype(np.float32))


def _likeness(depth: DepthEstimate, pair_depths: tuple[PairDepth, PairDepth]) -> Float32[np.ndarray, "height width"]:
    """How well colours fit to an estimate in the neighbour where they fit better, in (0, 1]."""
    reduced = subsample_depth(depth, pair_depths[0].image.shape[:2]).inverse_depth
    reduced = resized_to(reduced, pair_depths[0].image.shape[:2], cv2.INTER_NEAREST)
    mismatch = np.minimum(*(pair_depth.mismatch(reduced) for pair_depth in pair_depths))
    return resized_to(
        np.exp(-mismatch / np.float32(COLOUR_MISMATCH_SCALE)), depth.inverse_depth.shape, cv2.INTER_NEAREST
    )


def _enlarged(depth: DepthEstimate, size: tuple[int, int]) -> DepthEstimate:
    if depth.inverse_depth.shape == size:
        return depth
    directions = pixel_directions(*size)
    return DepthEstimate(*(sample_nearest(np.asarray(x), directions) for x in (depth.inverse_depth, depth.confidence)))


class ChainDepth:
    """The depth of the panoramas of a chain, found when it is asked for.

    To know all about the second panorama of a pair, the pair after it is compared too. What has been found and may be
    needed by the next pair is kept, nothing else; whatever is asked for in whatever order, the answers are the same.

    Args:
        views: the panoramas, in order.
        estimator: finds the depth of a pair, in pictures of one exposure; :class:`~omnisyn_cli.types.KnownDepth` is
            taken as it is.
        clock: collects seconds by stage.
        threads: at most this many; None is one per core.
    """

    def __init__(
        self, views: Sequence[View], estimator: DepthEstimator, clock: Stopwatch, threads: int | None = None
    ) -> None:
        self.views = views
        self._estimator, self._clock, self._threads = estimator, clock, threads
        self._pair_depths: dict[tuple[int, int], PairDepth | None] = {}
        self._known: dict[int, DepthEstimate] = {}

    def __call__(self, index: int) -> tuple[DepthEstimate, DepthEstimate]:
        """Of the views ``index`` and ``index + 1``, which must not stand at one place."""
        if isinstance(self._estimator, KnownDepth):
            views = self.views[index], self.views[index + 1]
            with self._clock("depth"):
                return self._estimator(*views)
        depths = self._of(index), self._of(index + 1)
        self._known = {view: depth for view, depth in self._known.items() if view in (index, index + 1)}
        self._pair_depths = {
            (view, other): pair_depth for (view, other), pair_depth in self._pair_depths.items()
            if view in (index - 1, index + 2) and other in (index, index + 1)
        }  # fmt: skip
        return depths

    def _of(self, view: int) -> DepthEstimate:
        if view not in self._known:
            others = [other for other in (view - 1, view + 1) if 0 <= other < len(self.views)]
            pair_depths = [pair_depth for other in others if (pair_depth := self._pair_depth(view, other)) is not None]
            with self._clock("depth"):
                self._known[view] = (
                    pair_depths[0].depth if len(pair_depths) == 1 else fuse_depth(pair_depths[0], pair_depths[1])
                )
        return self._known[view]

    def _pair_depth(self, view: int, other: int) -> PairDepth | None:
        if (view, other) not in self._pair_depths:
            self._pair_depths.update(self._found(min(view, other)))
        return self._pair_depths[view, other]

    def _found(self, index: int) -> dict[tuple[int, int], PairDepth | None]:
        """What a pair says of both its views; nothing where they stand at one place."""
        first, second = self.views[index], self.views[index + 1]
        if at_same_position(first.pose, second.pose):
            return {(index, index + 1): None, (index + 1, index): None}
        with self._clock("depth"):
            alike = equalize_exposure(first, second, self._threads)
            depths = self._estimator(*alike)
            size = min(CROSS_CHECK_SIZE, *(view.image.shape[:2] for view in alike))
            pictures = [_reduced(view, size) for view in alike]
            there, back = (
                PairDepth(depths[k], pictures[k][..., :3], pictures[1 - k], alike[1 - k].pose.inverse() @ alike[k].pose)
                for k in (0, 1)
            )
        return {(index, index + 1): there, (index + 1, index): back}


def _reduced(view: View, size: tuple[int, int]) -> Float32[np.ndarray, "height width 4"]:
    """The picture at the size of the check and, last, which of its pixels may be used."""
    image = resized_to(np.asarray(view.image, np.float32), size, cv2.INTER_AREA)
    usable = np.ones(view.image.shape[:2], np.float32) if view.mask is None else view.mask.astype(np.float32)
    return np.dstack([image, resized_to(usable, size, cv2.INTER_AREA)])
