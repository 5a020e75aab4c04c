"""Depth of a pair by matching, made better by a network that has seen many rooms and streets."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sweep import free_space_agreement
from omnisyn_cli.runtime.thread_limit import both, limited_threads
from omnisyn_cli.stereo.evidence import Evidence, evidence_planes
from omnisyn_cli.stereo.filling import median_around
from omnisyn_cli.stereo.matching import MatchingDepthEstimator
from omnisyn_cli.stereo.rectify import usable_pixels
from omnisyn_cli.stereo.sharpening import Answer, sharpened
from omnisyn_cli.stereo.sizes import doubled_sizes
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["RefinedDepthEstimator"]


class Refinement(Protocol):
    """A trained refinement network, however it is run."""

    def __call__(self, planes: Float32[np.ndarray, "planes height width"]) -> Answer:
        """Inverse depth × baseline, and the probability that it is within 10 %; ``planes`` as in ``evidence``."""
        ...


@dataclass(frozen=True)
class RefinedDepthEstimator:
    """Inverse depth of both panoramas; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Where matching is unsure the network chooses for each pixel alone, so the median of the answers around it is taken,
    which keeps edges. A place that the other panorama looks through loses its confidence.

    In a larger picture matching and the network see less of the scene around a pixel, but matching measures more
    exactly. So they say what is there, and its place is measured again at twice the size, until there are enough rows
    (:mod:`omnisyn_cli.stereo.sharpening`).

    Panoramas from one position have no parallax: everything is then 0 with confidence 0.

    Attributes:
        matching: finds the evidence.
        refinement: the network; None leaves it out, to see what it is worth: what matching filled is taken as it is.
        rows: that depth is looked for at, see :func:`omnisyn_cli.stereo.sizes.estimate_sizes`.
    """

    matching: MatchingDepthEstimator
    refinement: Refinement | None
    rows: int

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        if np.array_equal(first.pose.position, second.pose.position):
            return self.matching(first, second)
        with limited_threads(self.matching.threads):
            return self._estimates(first, second)

    def _estimates(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        there, back = self.matching.evidence(first, second)
        answers = self._answers(there, back)
        picture_rows = max(view.image.shape[0] for view in (first, second))
        for size in doubled_sizes(there.filled.shape[0], self.rows // 2, picture_rows)[1:]:
            answers = sharpened(first, second, answers, size, self.matching.options_for(first, second))
        baseline = float(np.linalg.norm(second.pose.position - first.pose.position))
        (one, trust), (other, back_trust) = answers
        return both(
            lambda: _estimate(first, second, (one, trust), other, baseline),
            lambda: _estimate(second, first, (other, back_trust), one, baseline),
        )

    def _answers(self, there: Evidence, back: Evidence) -> tuple[Answer, Answer]:
        if self.refinement is None:
            return _filled(there), _filled(back)
        planes = both(lambda: evidence_planes(there, back), lambda: evidence_planes(back, there))
        return _refined(there, *self.refinement(planes[0])), _refined(back, *self.refinement(planes[1]))


def _filled(evidence: Evidence) -> Answer:
    """What matching alone says, believed where it is sure."""
    return evidence.filled.astype(np.float32), (evidence.agreed | evidence.sky).astype(np.float32)


def _refined(evidence: Evidence, inverse_depth: np.ndarray, confidence: np.ndarray) -> Answer:
    return np.where(evidence.agreed | evidence.sky, inverse_depth, median_around(inverse_depth)), confidence


def _estimate(view: View, other: View, answer: Answer, back: np.ndarray, baseline: float) -> DepthEstimate:
    """In 1/metre; not trusted where masked, or where the other panorama, whose answer is ``back``, looks through."""
    inverse_depth, confidence = answer
    motion = other.pose.inverse() @ view.pose
    second_from_first = Pose(motion.rotation, motion.position / baseline)
    trust = confidence * free_space_agreement(inverse_depth, back, second_from_first)
    trust = trust * usable_pixels(view, inverse_depth.shape)
    return DepthEstimate((inverse_depth / baseline).astype(np.float32), trust.astype(np.float32))
