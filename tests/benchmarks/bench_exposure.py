"""What a change of exposure costs: ``python tests/benchmarks/bench_exposure.py FOLDER ... [--preset NAME]``.

In every folder (``poses.json``, panoramas in walking order, all of one exposure) the last panorama is exposed one stop
more and one stop less, cut off at white and rounded to 8 bits as a camera does it, and the frames between the first
and the last are compared with the true panoramas, exposed by the share of the way. A brighter picture has larger
errors, and white has none, so a third figure says what the frames of the equal pair have after the same exposure: the
best that can be hoped for.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.fusion.photometry.exposure_curve import linear_to_srgb, srgb_to_linear
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimator, View


def exposed(image: np.ndarray, stops: float) -> np.ndarray:
    """A picture with more light, white cut off."""
    return np.minimum(linear_to_srgb(srgb_to_linear(image) * 2.0**stops), 1.0).astype(np.float32)


def read_views(folder: Path) -> list[View]:
    """All panoramas of a folder."""
    entries = read_poses(folder / "poses.json").panoramas
    return [View(read_panorama(folder / name).image, entry.pose) for name, entry in entries.items()]


def inner_frames(first: View, last: View, waypoints: Sequence[Waypoint], estimator: DepthEstimator) -> list[np.ndarray]:
    """The frames between two panoramas."""
    options = SynthesisOptions(first.image.shape[:2], "mesh", Cut())
    made = synthesize([first, last], waypoints, SurfaceMethod(estimator, options))
    return [frame.image.copy() for frame in made if frame.panorama is None]


def quality(frames: Sequence[np.ndarray], truth: Sequence[np.ndarray], stops: Sequence[float]) -> float:
    """Mean WS-PSNR against the truth, exposed frame by frame."""
    return float(np.mean([ws_psnr(f, exposed(t, s)) for f, t, s in zip(frames, truth, stops, strict=True)]))


def main() -> None:
    """Print a row for every folder and change."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--preset", choices=list(PRESETS), default=DEFAULT_PRESET)
    given = parser.parse_args()
    estimator = make_estimator(PRESETS[given.preset].config.depth, device="cpu")
    print(f"{'':24}{'equal':>8}{'changed':>9}{'best':>8}{'lost':>7}")
    for folder in given.folders:
        views = read_views(folder)
        steps = np.linspace(0.0, 1.0, len(views))
        path = [Waypoint(0, float(t), view.pose) for view, t in zip(views, steps, strict=True)]
        truth, times = [view.image for view in views[1:-1]], steps[1:-1]
        plain = inner_frames(views[0], views[-1], path, estimator)
        equal = quality(plain, truth, np.zeros(len(times)))
        for stop in (1.0, -1.0):
            last = replace(views[-1], image=np.rint(exposed(views[-1].image, stop) * 255).astype(np.float32) / 255)
            changed = quality(inner_frames(views[0], last, path, estimator), truth, stop * times)
            after = [exposed(frame, stop * t) for frame, t in zip(plain, times, strict=True)]
            best = quality(after, truth, stop * times)
            print(
                f"{folder.name:18}{stop:+5.0f} {equal:8.2f}{changed:9.2f}{best:8.2f}{best - changed:7.2f}", flush=True
            )


if __name__ == "__main__":
    main()
