"""Pairs with a true frame half way, and what was made of them; some with poses that are deliberately wrong."""

from dataclasses import dataclass, replace

import numpy as np

from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View


@dataclass(frozen=True)
class Judged:
    """A pair's confidence, and the true WS-PSNR in dB of its frame half way."""

    name: str
    score: float
    expected: float
    true: float


def generated_views(kind: str, seed: int, baseline: float, size: tuple[int, int]) -> list[View]:
    """First, middle and last panorama of a way, with true depth."""
    scene = generate_scene(kind, seed)
    views = []
    for pose in sample_path(scene, seed, 3, baseline=baseline):
        image, depth = render_panorama(scene, pose, size)
        views.append(View(image, pose, None, DepthEstimate(1 / depth, np.ones_like(depth))))
    return views


def disturbed(view: View, degrees: float, metres: float) -> View:
    """The view with a pose that is turned and moved."""
    turn = rotation_from_heading(degrees, 0.5 * degrees, 0.0)
    return replace(view, pose=Pose(view.pose.rotation @ turn, view.pose.position + metres * np.array([1.0, 0.0, 0.5])))


def judged(
    name: str, views: list[View], estimator: DepthEstimator, degrees: float = 0.0, metres: float = 0.0
) -> Judged:
    """What a pair says about itself, and what the truth says."""
    first, middle, last = views[0], views[len(views) // 2], views[-1]
    last = disturbed(last, degrees, metres) if degrees or metres else last
    options = SynthesisOptions(first.image.shape[:2], threads=2)
    pair = SurfaceMethod(estimator, options).prepare(0, [first, last])
    confidence, frame = pair.prepared.cross_check.confidence, pair.frame(Waypoint(0, 0.5, middle.pose))
    true = ws_psnr(np.clip(frame.image, 0, 1), middle.image)
    return Judged(name, confidence.score, confidence.expected, true)


def rank_correlation(one: list[float], other: list[float]) -> float:
    """Spearman's, without ties: 1 − 6·Σd² / (n·(n² − 1))."""
    ranks = [np.argsort(np.argsort(values)) for values in (one, other)]
    count = len(one)
    return float(1 - 6 * ((ranks[0] - ranks[1]) ** 2).sum() / (count * (count**2 - 1)))
