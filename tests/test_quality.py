"""The least that a frame between two generated panoramas must come to: recorded figures less 0.5 dB."""

import numpy as np
import pytest

from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, DepthEstimator, KnownDepth, View

SIZE = (256, 512)


def views_of(kind: str, baseline: float) -> tuple[list[View], list[Pose]]:
    """Three panoramas in a row with their true depth."""
    scene = generate_scene(kind, 102)
    poses = sample_path(scene, 102, 3, baseline=baseline)
    views = []
    for pose in poses:
        image, depth = render_panorama(scene, pose, SIZE)
        views.append(View(image, pose, None, DepthEstimate(1 / depth, np.ones_like(depth))))
    return views, poses


@pytest.mark.parametrize(
    ("kind", "baseline", "matching", "truth"), [("street", 3.0, 26.5, 30.1), ("room", 1.0, 33.3, 34.0)]
)
def test_the_middle_frame_is_as_good_as_it_was(kind: str, baseline: float, matching: float, truth: float) -> None:
    (first, middle, second), poses = views_of(kind, baseline)
    methods: dict[str, DepthEstimator] = {"matching": MatchingDepthEstimator(), "truth": KnownDepth()}
    scores = {}
    for name, estimator in methods.items():
        method = SurfaceMethod(estimator, SynthesisOptions(SIZE))
        (frame,) = synthesize([first, second], [Waypoint(0, 0.5, poses[1])], method)
        scores[name] = ws_psnr(np.clip(frame.image, 0, 1), middle.image)
    fade = ws_psnr((first.image + second.image) / 2, middle.image)
    assert scores["matching"] > max(matching, fade + 3.0), scores
    assert scores["truth"] > truth, scores
