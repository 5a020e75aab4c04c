"""The least that frames must come to: of generated panoramas, and of measured scenes beside the checkout."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from confidence_samples import generated_views
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.poses.file import read_poses
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


DATA = Path(__file__).parents[2] / "shared" / "data"
WAREHOUSES = [DATA / f"warehouse_{k}" for k in range(3)]
PAIRS = [DATA / name for name in ("carla-pair", "campus-pair", "vertical-hall", "vertical-room", "vertical-stairs")]
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the measured scenes in {DATA}")


def frames(scene: Path, folder: Path, **options: object) -> list[np.ndarray]:
    names = list(read_poses(scene / "poses.json").panoramas)
    ends = (scene / names[0], scene / names[-1])
    run_interpolation(plan_interpolation(InterpolationJob(ends, scene / "poses.json", folder, **options)))
    return [read_panorama(path).image for path in sorted(folder.iterdir())]


def truths(scene: Path) -> list[np.ndarray]:
    return [read_panorama(scene / name).image for name in read_poses(scene / "poses.json").panoramas]


def mean_between(found: list[np.ndarray], truth: list[np.ndarray]) -> float:
    return float(np.mean([ws_psnr(a, b) for a, b in zip(found[1:-1], truth[1:-1], strict=True)]))


@measured
@pytest.mark.parametrize(("depth", "least"), [("file", 30.5), ("matching", 23.5)])
@pytest.mark.parametrize("scene", WAREHOUSES, ids=lambda scene: scene.name)
def test_frames_between_come_close_to_the_truth(scene: Path, depth: str, least: float, tmp_path: Path) -> None:
    truth = truths(scene)
    found = frames(scene, tmp_path / "frames", frames=len(truth), depth=depth)
    fades = [(1 - t) * truth[0] + t * truth[-1] for t in np.linspace(0, 1, len(truth))]
    score = mean_between(found, truth)
    assert score > least
    assert score > mean_between(fades, truth) + 3.0
    np.testing.assert_array_equal(found[0], truth[0])
    np.testing.assert_array_equal(found[-1], truth[-1])


@measured
@pytest.mark.parametrize("scene", PAIRS, ids=lambda scene: scene.name)
def test_next_to_an_end_nothing_pops(scene: Path, tmp_path: Path) -> None:
    found = frames(scene, tmp_path / "frames", frames=61, size=(128, 256))
    steps = [float(np.abs(a - b).mean()) for a, b in itertools.pairwise(found)]
    assert max(steps[0], steps[-1]) < 2.5 * np.median(steps)
