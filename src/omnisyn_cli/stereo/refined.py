"""Depth of a pair by matching, made better by a network that has seen many rooms and streets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.geometry.sweep import free_space_agreement
from omnisyn_cli.stereo.evidence import Evidence, evidence_planes
from omnisyn_cli.stereo.matching import MatchingDepthEstimator
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["RefinedDepthEstimator", "Refinement"]

WINDOW = 5
"""Side in pixels of the squares whose median answers where matching is unsure."""


class Refinement(Protocol):
    """A trained refinement network, however it is run."""

    def __call__(
        self, planes: Float32[np.ndarray, "planes height width"]
    ) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
        """Inverse depth × baseline, and the probability that it is within 10 %; ``planes`` as in ``evidence``."""
        ...


@dataclass(frozen=True)
class RefinedDepthEstimator:
    """Inverse depth of both panoramas; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Estimates have half of the matching's size: the resolution that it works at. Where matching is unsure the network
    chooses for each pixel alone, so the median of its neighbours' answers is taken, which keeps edges. A place that the
    other panorama looks through loses its confidence. Panoramas from one position have no parallax: everything is then
    0 with confidence 0.

    Attributes:
        matching: finds the evidence.
        refinement: the network.
    """

    matching: MatchingDepthEstimator
    refinement: Refinement

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        if np.array_equal(first.pose.position, second.pose.position):
            return self.matching(first, second)
        there, back = self.matching.evidence(first, second)
        baseline = np.linalg.norm(second.pose.position - first.pose.position)
        answers = [self._refined(a, b) for a, b in ((there, back), (back, there))]
        return (
            _estimate(there, answers[0], answers[1][0], baseline),
            _estimate(back, answers[1], answers[0][0], baseline),
        )

    def _refined(self, evidence: Evidence, other: Evidence) -> tuple[np.ndarray, np.ndarray]:
        """Inverse depth × baseline, and the probability that it is within 10 %."""
        inverse_depth, confidence = self.refinement(evidence_planes(evidence, other))
        return np.where(evidence.agreed | evidence.sky, inverse_depth, _median(inverse_depth)), confidence


def _median(values: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Of the square around each pixel, over the seam; at the poles of what there is, the last rows repeated."""
    wrapped = np.pad(values, ((0, 0), (WINDOW // 2, WINDOW // 2)), mode="wrap")
    return cv2.medianBlur(wrapped, WINDOW)[:, WINDOW // 2 : -(WINDOW // 2)]


def _estimate(
    evidence: Evidence, answer: tuple[np.ndarray, np.ndarray], other: np.ndarray, baseline: np.floating
) -> DepthEstimate:
    inverse_depth, confidence = answer
    trust = confidence * free_space_agreement(inverse_depth, other, evidence.second_from_first) * evidence.usable
    return DepthEstimate((inverse_depth / baseline).astype(np.float32), trust.astype(np.float32))
