"""One setting at work: the product's own pipeline from two files to a video, timed, weighed, compared with the truth.

Times are of computing: of all threads and the encoder, which ends within the stage that waits for it. A run wants a
process of its own: peak memory and the time to load are facts about processes.
"""

import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from statistics import fmean

import numpy as np

from omnisyn_cli.evaluation.datasets.sources import Pair, SceneFrame
from omnisyn_cli.evaluation.methods import find_method
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.evaluation.views import at_size, load_pair
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.interpolation.planning.duration import probe
from omnisyn_cli.interpolation.planning.figures import FRAME_STAGES, Figures, Setting
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.factory import make_method
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.runtime.monocular_session import peak_memory
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

PHOTOGRAPHS_PER_CLIP = 2  # the first and the last frame of a clip, which are not rendered


@dataclass(frozen=True)
class BenchRun:
    """What to do."""

    setting: Setting  # with these settings
    pairs: tuple[Pair, ...]  # between these panoramas, one clip each
    frames: int  # that are rendered of every clip
    device: str = "auto"  # where networks run
    key: str = ""  # goes into the figures
    is_scored: bool = True  # whether frames are compared with true ones


def computing() -> float:
    """Seconds that all threads of this process, and the processes that it has waited for, have computed so far."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def measure_setting(run: BenchRun, folder: Path, on_warm: Callable[[], None] = lambda: None) -> Figures:
    """Measure a setting in an empty folder; ``start`` is what the first clip, made twice, takes longer at first.

    ``on_warm`` is called in between. InputError: no picture or network; EncodingError, WriteError: a clip is not
    written.
    """
    setting = run.setting
    config = replace(find_method(setting.method).config, device=run.device)
    estimator = make_estimator(config.depth, device=run.device, threads=setting.threads)
    found: list[tuple[DepthEstimate, DepthEstimate] | None] = [None]

    def estimate(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        depths = found[-1] = estimator(first, second)
        return depths

    plans = _plans(run, config, folder)
    first_plan = next(plans)
    short = plan_interpolation(replace(first_plan.job, frames=1 + PHOTOGRAPHS_PER_CLIP))
    _clip(replace(short, config=config), estimate, 1)
    started = computing()
    on_warm()
    clips = []
    for plan in chain((first_plan,), plans):
        clips.append(_clip(plan, estimate, run.frames))
        found.append(None)
    memory = peak_memory()
    start = max(0.0, started - sum(clips[0].values()))
    seconds = {"start": start, **{stage: fmean([clip.get(stage, 0.0) for clip in clips]) for stage in clips[0]}}
    scores = {}
    for pair, depths in zip(run.pairs if run.is_scored else (), found, strict=False):
        if pair.between:
            name = f"{pair.scene} {pair.first.name} {pair.second.name}"
            scores[name] = fmean(_scores(pair, depths, first_plan))
    return Figures(
        setting, config=config, key=run.key, source=first_plan.source_sizes[0], seconds=seconds, probe=probe(),
        memory=memory, scores=scores, pairs=len(clips),
    )  # fmt: skip


def _plans(run: BenchRun, config: RunConfig, folder: Path) -> Iterator[InterpolationPlan]:
    """A clip for each pair; pictures are copied, so that those of any data set get names of their own."""
    for index, pair in enumerate(run.pairs):
        place = folder / str(index)
        place.mkdir()
        entries = dict(_copied(frame, place, name) for name, frame in (("first", pair.first), ("second", pair.second)))
        write_poses(place / "poses.json", entries)
        job = InterpolationJob(
            tuple(place / name for name in entries), place / "poses.json", place / "clip.mp4",
            frames=run.frames + PHOTOGRAPHS_PER_CLIP, size=run.setting.size, device=run.device,
            threads=run.setting.threads, overwrite=True,
        )  # fmt: skip
        yield replace(plan_interpolation(job), config=config)


def _copied(frame: SceneFrame, place: Path, name: str) -> tuple[str, PosedPanorama]:
    image = shutil.copyfile(frame.image, place / f"{name}{frame.image.suffix}")
    mask = frame.mask and shutil.copyfile(frame.mask, place / f"{name}_mask{frame.mask.suffix}")
    return image.name, PosedPanorama(frame.pose, mask=mask)


def _clip(plan: InterpolationPlan, estimator: DepthEstimator, frames: int) -> dict[str, float]:
    """Seconds of computing by stage, for the pair or for each frame; what is in no other stage is ``encode``."""
    seconds = run_interpolation(plan, estimator=estimator, now=computing).seconds
    staged = {stage: value for stage, value in seconds.items() if stage not in {"total", "encode"}}
    rest = max(0.0, seconds["total"] - math.fsum(staged.values()))
    of_frames = {stage: staged.pop(stage, 0.0) / frames for stage in FRAME_STAGES}
    return staged | of_frames | {"encode": rest / frames}


def _scores(pair: Pair, depths: tuple[DepthEstimate, DepthEstimate] | None, plan: InterpolationPlan) -> list[float]:
    """WS-PSNR of the true frames between, at their own size, to which frames are resampled."""
    threads = plan.job.threads
    loaded = load_pair(pair, None, threads)
    known = None if depths is None else lambda first, second: depths
    method = make_method(plan.config, plan.size, threads=threads, estimator=known)
    made = synthesize(loaded.views, [truth.waypoint for truth in loaded.truths], method)
    images = (at_size(frame.image, loaded.size, threads) for frame in made)
    return [ws_psnr(np.clip(image, 0, 1), truth.image) for image, truth in zip(images, loaded.truths, strict=True)]
