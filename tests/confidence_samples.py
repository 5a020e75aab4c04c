"""Pairs with a true frame half way, and what was made of them; some with poses that are deliberately wrong."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from omnisyn_cli.evaluation.measure import depth_record
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.pipeline.config import DepthSource, RunConfig, make_method
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View

TRUE_DEPTH = RunConfig(DepthSource("file"))


@dataclass(frozen=True)
class Judged:
    name: str
    score: float  # of its frames
    expected: float  # WS-PSNR in dB that it expects of them
    true: float  # WS-PSNR of its frame half way
    calibration_error: float | None  # of its depth's confidence, mean of both views; None where that is constant


@lru_cache(maxsize=4)
def generated_views(kind: str, seed: int, baseline: float, size: tuple[int, int]) -> tuple[View, ...]:
    """First, middle and last panorama of a way, with true depth."""
    scene = generate_scene(kind, seed)
    views = []
    for pose in sample_path(scene, seed, 3, baseline=baseline):
        image, depth = render_panorama(scene, pose, size)
        views.append(View(image, pose, None, DepthEstimate(1 / depth, np.ones_like(depth))))
    return tuple(views)


def disturbed(view: View, degrees: float, metres: float) -> View:
    """The view with a pose that is turned and moved."""
    turn = rotation_from_heading(degrees, 0.5 * degrees, 0.0)
    return replace(view, pose=Pose(view.pose.rotation @ turn, view.pose.position + metres * np.array([1.0, 0.0, 0.5])))


def judged(
    name: str, views: Sequence[View], degrees: float = 0.0, metres: float = 0.0,
    config: RunConfig = TRUE_DEPTH,
) -> Judged:  # fmt: skip
    """What a pair says about itself, and what the truth says; of true depth by default."""
    first, middle, last = views[0], views[len(views) // 2], views[-1]
    last = disturbed(last, degrees, metres) if degrees or metres else last
    pair = make_method(config, first.image.shape[:2], threads=2).prepare(0, [first, last])
    confidence, frame = pair.prepared.cross_check.confidence, pair.frame(Waypoint(0, 0.5, middle.pose))
    records = list(map(depth_record, pair.depths, (first, last), ("first", "last")))
    errors = [record.doubt["calibration_error"] for record in records if "calibration_error" in record.doubt]
    true = ws_psnr(np.clip(frame.image, 0, 1), middle.image)
    return Judged(name, confidence.score, confidence.expected, true, float(np.mean(errors)) if errors else None)
