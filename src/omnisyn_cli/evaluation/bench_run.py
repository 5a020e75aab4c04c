"""One setting at work: the product's own pipeline from two files to a video, timed, weighed, compared with the truth.

A run wants a process of its own, started for it alone: peak memory and the time to load are facts about processes.
"""

import math
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from statistics import fmean

import numpy as np

from omnisyn_cli.evaluation.budget import calibrate
from omnisyn_cli.evaluation.datasets import Pair, SceneFrame
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.evaluation.pareto import FRAME_STAGES, Figures, Setting
from omnisyn_cli.evaluation.views import load_pair
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import open_video
from omnisyn_cli.io.ffmpeg_process import read_frames
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.synthesis.frames import synthesize, turned_panorama
from omnisyn_cli.synthesis.making import make_estimator, make_method
from omnisyn_cli.synthesis.presets import PRESETS
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

PHOTOGRAPHS = 2
"""The first and the last frame of a clip, which are not rendered."""

MOST_BYTES = 2**29
"""Of frames that are held to be encoded alone."""

MEASURED_PEAK = "VmHWM:"

PROCESS_STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class BenchRun:
    """What to do.

    Attributes:
        setting: with these settings.
        pairs: between these panoramas, one clip each.
        frames: that are rendered of every clip.
        device: where networks run.
        key: goes into the figures.
    """

    setting: Setting
    pairs: tuple[Pair, ...]
    frames: int
    device: str = "auto"
    key: str = ""


def measure_setting(run: BenchRun, folder: Path, launched: float) -> Figures:
    """Measure a setting.

    The first clip is made twice: what it takes longer the first time is ``start``.

    Args:
        run: what to do.
        folder: an empty one for copies and clips.
        launched: when the process was started, in the seconds of ``time.time()``.

    Raises:
        InputError: a picture cannot be read, or a network is missing.
        EncodingError, WriteError: a clip cannot be written.
    """
    setting, source = run.setting, PRESETS[run.setting.preset].recipe.depth
    source = replace(source, rows=setting.depth_rows)
    estimator = _Remembering(make_estimator(source, device=run.device, threads=setting.threads))
    plans = _plans(run, folder)
    first_plan = next(plans)
    _clip(plan_interpolation(replace(first_plan.job, frames=1 + PHOTOGRAPHS)), estimator)
    started = time.time() - launched
    clips, found = [], []
    for plan in chain((first_plan,), plans):
        clips.append(_per_pair_and_frame(_clip(plan, estimator), run.frames))
        found.append(estimator.found)
    memory = _peak_memory()
    encoder = _encoder_alone(first_plan, estimator)
    start = max(0.0, started - sum(clips[0].values()))
    seconds = {"start": start, **{stage: fmean([clip.get(stage, 0.0) for clip in clips]) for stage in clips[0]}}
    scores = list(chain.from_iterable(_scores(*each, first_plan) for each in zip(run.pairs, found, strict=True)))
    return Figures(
        setting, key=run.key, source=first_plan.source_sizes[0], seconds=seconds,
        calibration=calibrate(setting.threads), memory=memory, ws_psnr=fmean(scores) if scores else None,
        pairs=len(clips), encoder=encoder,
    )  # fmt: skip


def _encoder_alone(plan: InterpolationPlan, estimator: DepthEstimator) -> float:
    """Seconds that the encoder takes for a frame of a clip, from memory, before and after the clip is made again."""
    height, width = plan.size
    most = max(2, MOST_BYTES // (3 * height * width))
    frames = list(read_frames(plan.job.output, plan.size, min(most, len(plan.path))))
    seconds = [_encode(frames, plan)]
    _clip(plan, estimator)
    return min(*seconds, _encode(frames, plan)) / len(frames)


def _encode(frames: Sequence[np.ndarray], plan: InterpolationPlan) -> float:
    begin, job = time.perf_counter(), plan.job
    again = job.output.with_name("again.mp4")
    with open_video(again, size=plan.size, fps=job.fps, threads=job.threads or 0, overwrite=True) as sink:
        for frame in frames:
            sink.write(frame)
    return time.perf_counter() - begin


class _Remembering:
    """An estimator that keeps what it found last."""

    def __init__(self, estimator: DepthEstimator) -> None:
        self._estimator = estimator
        self.found: tuple[DepthEstimate, DepthEstimate] | None = None

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        self.found = self._estimator(first, second)
        return self.found


def _plans(run: BenchRun, folder: Path) -> Iterator[InterpolationPlan]:
    """A clip for each pair; pictures are copied, so that those of any data set get names of their own."""
    for index, pair in enumerate(run.pairs):
        place = folder / str(index)
        place.mkdir()
        entries = dict(_copied(frame, place, name) for name, frame in (("first", pair.first), ("second", pair.second)))
        write_poses(place / "poses.json", entries)
        job = InterpolationJob(
            tuple(place / name for name in entries), place / "poses.json", place / "clip.mp4",
            frames=run.frames + PHOTOGRAPHS, size=run.setting.size, preset=run.setting.preset,
            device=run.device, threads=run.setting.threads, overwrite=True,
        )  # fmt: skip
        yield plan_interpolation(job)


def _copied(frame: SceneFrame, place: Path, name: str) -> tuple[str, PosedPanorama]:
    image = place / f"{name}{frame.image.suffix}"
    shutil.copyfile(frame.image, image)
    mask = None if frame.mask is None else place / f"{name}_mask{frame.mask.suffix}"
    if frame.mask is not None and mask is not None:
        shutil.copyfile(frame.mask, mask)
    return image.name, PosedPanorama(frame.pose, mask=mask)


def _clip(plan: InterpolationPlan, estimator: DepthEstimator) -> dict[str, float]:
    """Seconds by stage; whatever is in no other stage is ``convert``."""
    seconds = run_interpolation(plan, estimator=estimator).seconds
    staged = {**dict.fromkeys(FRAME_STAGES, 0.0), **seconds}
    total = staged.pop("total")
    order = [*(stage for stage in staged if stage not in FRAME_STAGES), *FRAME_STAGES]
    return {stage: staged[stage] for stage in order} | {"convert": max(0.0, total - math.fsum(staged.values()))}


def _per_pair_and_frame(seconds: dict[str, float], frames: int) -> dict[str, float]:
    return {stage: value / frames if stage in FRAME_STAGES else value for stage, value in seconds.items()}


def _scores(pair: Pair, depths: tuple[DepthEstimate, DepthEstimate] | None, plan: InterpolationPlan) -> list[float]:
    """WS-PSNR of the true frames between, at their own size: frames of another size are resampled to it.

    Args:
        pair: with or without true frames.
        depths: that were found.
        plan: of any pair with the same setting.
    """
    if depths is None or not pair.between:
        return []
    threads = plan.job.threads
    loaded = load_pair(pair, None, threads)
    recipe = replace(plan.recipe, is_on_gpu=False)
    method = make_method(recipe, plan.size, threads=threads, estimator=lambda first, second: depths)
    made = synthesize(loaded.views, [truth.waypoint for truth in loaded.truths], method)
    images = (_resized(frame.image, loaded.size, threads) for frame in made)
    return [ws_psnr(np.clip(image, 0, 1), truth.image) for image, truth in zip(images, loaded.truths, strict=True)]


def _resized(image: np.ndarray, size: tuple[int, int], threads: int | None) -> np.ndarray:
    return image if image.shape[:2] == size else turned_panorama(image, Pose.identity(), size, threads)


def _peak_memory() -> int | None:
    """Bytes that this process has held at most.

    What ``getrusage`` says is no less than what the parent held when it started this process, so Linux is asked
    directly.
    """
    if PROCESS_STATUS.exists():
        lines = PROCESS_STATUS.read_text(encoding="ascii", errors="replace").splitlines()
        peaks = [line.split() for line in lines if line.startswith(MEASURED_PEAK)]
        if peaks:
            return int(peaks[0][1]) * 1024
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
