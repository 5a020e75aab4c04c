"""Depth of a pair by matching, made better by a network that has seen many rooms and streets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.geometry.sweep import free_space_agreement
from omnisyn_cli.stereo.evidence import Evidence, evidence_planes
from omnisyn_cli.stereo.matching import MatchingDepthEstimator
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["RefinedDepthEstimator", "Refinement"]

WINDOW = 5
"""Side in pixels of the squares whose median answers where matching is unsure."""

SAME = 0.1
"""Relative difference of inverse depth up to which what was found at two sizes is the same surface."""

FINE_CONFIDENCE = 0.8
"""Least confidence of what matching at the larger size is sure of."""

Answer = tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]
"""Inverse depth × baseline, and the probability that it is within 10 %."""


class Refinement(Protocol):
    """A trained refinement network, however it is run."""

    def __call__(self, planes: Float32[np.ndarray, "planes height width"]) -> Answer:
        """Inverse depth × baseline, and the probability that it is within 10 %; ``planes`` as in ``evidence``."""
        ...


@dataclass(frozen=True)
class RefinedDepthEstimator:
    """Inverse depth of both panoramas; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Estimates have half of the (finer) matching's size: the resolution that it works at. Where matching is unsure the
    network chooses for each pixel alone, so the median of its neighbours' answers is taken, which keeps edges. A place
    that the other panorama looks through loses its confidence.

    In a larger picture matching and the network see less of the scene around a pixel, but matching measures more
    exactly. So with ``fine`` the smaller size says what is there, and the larger one where exactly, where it is sure.

    Panoramas from one position have no parallax: everything is then 0 with confidence 0.

    Attributes:
        matching: finds the evidence.
        refinement: the network.
        fine: matching at a larger size; None leaves it at the smaller one.
    """

    matching: MatchingDepthEstimator
    refinement: Refinement
    fine: MatchingDepthEstimator | None = None

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        if np.array_equal(first.pose.position, second.pose.position):
            return self.matching(first, second)
        there, back = self.matching.evidence(first, second)
        answers = [self._refined(a, b) for a, b in ((there, back), (back, there))]
        if self.fine is not None:
            there, back = self.fine.evidence(first, second)
            answers = [_sharpened(answer, fine) for answer, fine in zip(answers, (there, back), strict=True)]
        baseline = np.linalg.norm(second.pose.position - first.pose.position)
        return (
            _estimate(there, answers[0], answers[1][0], baseline),
            _estimate(back, answers[1], answers[0][0], baseline),
        )

    def _refined(self, evidence: Evidence, other: Evidence) -> Answer:
        inverse_depth, confidence = self.refinement(evidence_planes(evidence, other))
        return np.where(evidence.agreed | evidence.sky, inverse_depth, _median(inverse_depth)), confidence


def _median(values: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Of the square around each pixel, over the seam; at the poles of what there is, the last rows repeated."""
    wrapped = np.pad(values, ((0, 0), (WINDOW // 2, WINDOW // 2)), mode="wrap")
    return cv2.medianBlur(wrapped, WINDOW)[:, WINDOW // 2 : -(WINDOW // 2)]


def _sharpened(answer: Answer, fine: Evidence) -> Answer:
    """The answer at the larger size: what matching is sure of there, where it means the same surface.

    Elsewhere it is not better informed: next to the epipoles and on plain ground it is sure of noise.
    """
    size = fine.filled.shape
    inverse_depth, confidence = (_enlarged(values, size) for values in answer)
    exact = np.where(fine.sky, 0.0, fine.filled).astype(np.float32)
    is_same = np.abs(exact - inverse_depth) <= SAME * np.maximum(exact, inverse_depth)
    taken = (fine.agreed | fine.sky) & is_same
    return (
        np.where(taken, exact, inverse_depth),
        np.where(taken, np.maximum(confidence, np.float32(FINE_CONFIDENCE)), confidence),
    )


def _enlarged(values: Shaped[np.ndarray, "rows cols"], size: tuple[int, int]) -> Shaped[np.ndarray, "height width"]:
    """The nearest value for every pixel of a size: between two surfaces there is nothing to interpolate."""
    row, col = (np.arange(count) * had // count for count, had in zip(size, values.shape, strict=True))
    return np.asarray(values[row[:, None], col])


def _estimate(evidence: Evidence, answer: Answer, other: np.ndarray, baseline: np.floating) -> DepthEstimate:
    inverse_depth, confidence = answer
    trust = confidence * free_space_agreement(inverse_depth, other, evidence.second_from_first) * evidence.usable
    return DepthEstimate((inverse_depth / baseline).astype(np.float32), trust.astype(np.float32))
