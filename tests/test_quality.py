"""The least that a frame between two generated panoramas must come to: recorded figures less 0.5 dB."""

import numpy as np
import pytest

from confidence_samples import generated_views
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimator, KnownDepth

SIZE = (256, 512)


@pytest.mark.parametrize(
    ("kind", "baseline", "matching", "truth"), [("street", 3.0, 26.5, 30.1), ("room", 1.0, 31.6, 34.6)]
)
def test_the_middle_frame_is_as_good_as_it_was(kind: str, baseline: float, matching: float, truth: float) -> None:
    first, middle, second = generated_views(kind, 102, baseline, SIZE)
    methods: dict[str, DepthEstimator] = {"matching": MatchingDepthEstimator(), "truth": KnownDepth()}
    scores = {}
    for name, estimator in methods.items():
        method = SurfaceMethod(estimator, SynthesisOptions(SIZE))
        (frame,) = synthesize([first, second], [Waypoint(0, 0.5, middle.pose)], method)
        scores[name] = ws_psnr(np.clip(frame.image, 0, 1), middle.image)
    fade = ws_psnr((first.image + second.image) / 2, middle.image)
    assert scores["matching"] > max(matching, fade + 3.0), scores
    assert scores["truth"] > truth, scores
