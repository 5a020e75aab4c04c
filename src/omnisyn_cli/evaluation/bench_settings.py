"""Settings measured one after the other, each in a process of its own, each written down when it is finished.

A setting at work is the product's own pipeline from two files to a video, timed, weighed, compared with the truth.
Times are of computing: of all threads and the encoder, which ends within the stage that waits for it. Peak memory and
the time to load are facts about processes. Interrupted and started again with the same folder, a run goes on.
"""

import json
import math
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import fmean

import numpy as np

from omnisyn_cli.batch.executor import end_with_parent
from omnisyn_cli.compute.jit import announce_compiling, when_compiling
from omnisyn_cli.compute.processes import spawn_context
from omnisyn_cli.compute.threads import available_threads
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.sources import Pair, choose_pairs
from omnisyn_cli.evaluation.methods import find_method, find_methods
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.evaluation.results import Fingerprints
from omnisyn_cli.evaluation.scene_files import PANORAMA_NAMES, write_scene
from omnisyn_cli.evaluation.views import at_size, load_pair
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.interpolation.planning.duration import probe
from omnisyn_cli.interpolation.planning.figures import FIGURES, FRAME_STAGES, Figures, Setting
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_header
from omnisyn_cli.io.documents import append_line, complete_lines
from omnisyn_cli.io.outputs import make_folder, scratch_folder, staged_folder
from omnisyn_cli.pipeline.config import RunConfig, make_method
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, SCALE
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.runtime.monocular_session import peak_memory
from omnisyn_cli.scenes import generate_scene, sample_path
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

    ``on_warm`` is called in between. InputError: no picture or network; EncodingError, WriteError: a clip not written.
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
        entries = {}
        for name, frame in (("first", pair.first), ("second", pair.second)):
            image = shutil.copyfile(frame.image, place / f"{name}{frame.image.suffix}")
            mask = frame.mask and shutil.copyfile(frame.mask, place / f"{name}_mask{frame.mask.suffix}")
            entries[image.name] = PosedPanorama(frame.pose, mask=mask)
        write_poses(place / "poses.json", entries)
        job = InterpolationJob(
            tuple(place / name for name in entries), place / "poses.json", place / "clip.mp4",
            frames=run.frames + PHOTOGRAPHS_PER_CLIP, size=run.setting.size, device=run.device,
            threads=run.setting.threads, overwrite=True,
        )  # fmt: skip
        yield replace(plan_interpolation(job), config=config)


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


RESULTS_NAME = "bench.jsonl"  # a line per finished run
# Pairs that are made where no others are given: kind, seed, metres. Nothing was trained or tuned with these seeds.
GENERATED_PAIRS = (
    ("street", 5_000_001, 1.0), ("street", 5_000_002, 3.0), ("street", 5_000_003, 6.0),
    ("room", 5_000_001, 1.0), ("room", 5_000_003, 3.0),
    ("home", 5_000_002, 1.0), ("home", 5_000_003, 2.0), ("home", 5_000_004, 4.0),
    ("home", 5_000_001, 1.0), ("home", 5_000_005, 3.0), ("street", 5_000_004, 2.0), ("street", 5_000_005, 6.0),
)  # fmt: skip
SUPERSAMPLE = 2  # rays per pixel along each axis of the rendered scenes. Set by hand.
DEFAULT_METHOD = f"omnisyn-{DEFAULT_PRESET}"  # what others are compared with
ALL_SIZE_METHODS = tuple(f"omnisyn-{name}" for name in SCALE)  # what is measured in further sizes as well
# Of that method, one at a time.
CHANGES = (
    "model=none", "fusion=geometric", "edges=none", "adaptive=none", "rows=512", "rows=2048", "renderer=two-pass",
)  # fmt: skip
# What is measured unless something else is asked for: everything that costs time and that users may choose.
DEFAULT_BENCH_METHODS = (
    "crossfade", "flow", *ALL_SIZE_METHODS, "matching", *(f"{DEFAULT_METHOD}:{change}" for change in CHANGES),
)  # fmt: skip
# Pairs between which frames are made that are larger than the panoramas: they cost time, but show no more.
TIMED_PAIRS = 2


@dataclass(frozen=True)
class BenchJob:
    """What a user asks for."""

    dataset: Path  # folder of scenes; figures without true frames have no accuracy
    # names that :func:`omnisyn_cli.evaluation.methods.find_methods` knows, separated by commas
    methods: str = ",".join(DEFAULT_BENCH_METHODS)
    # (height, width) of the frames; those of the presets alone from the second one on
    sizes: tuple[tuple[int, int], ...] = ((512, 1024), (1024, 2048), (2048, 4096))
    threads: tuple[int, ...] = ()  # empty means one per core
    frames: int = 6  # that are rendered of every clip
    layout: str = "auto"  # of the data set
    pairs: str | None = None  # which frames are inputs
    device: str = "auto"  # where networks run


def make_scenes(folder: Path, size: tuple[int, int]) -> None:
    """Write the missing scenes of :data:`GENERATED_PAIRS`; OutputPathError, WriteError: the folder is not writable."""
    make_folder(folder, "results")
    for kind, seed, baseline in GENERATED_PAIRS:
        place = folder / f"{kind}-{seed}-{baseline:g}m"
        if not place.exists():
            scene = generate_scene(kind, seed)
            path = sample_path(scene, seed, len(PANORAMA_NAMES), baseline=baseline, vertical=0.0)
            with staged_folder(place) as staged:
                write_scene(staged, scene, path, PANORAMA_NAMES, size, SUPERSAMPLE)


def plan_bench(job: BenchJob) -> list[BenchRun]:
    """What is to be measured, in order; InputError: unknown methods, or without video; no scenes; unreadable poses."""
    methods = find_methods(job.methods)
    for method in methods:
        needs_truth = method.config.draws_surfaces and not method.config.estimates_depth
        if method.shows_first_only or method.is_in_tour or method.depth_size is not None or needs_truth:
            raise InputError(f"expected methods that `omnisyn interpolate` has, got {method.name}; leave it out")
    choose = choose_pairs(job.pairs)
    pairs = tuple(pair for source in find_scenes(job.dataset, job.layout) for pair in choose(source.read()))
    if not pairs:
        raise InputError(f"{job.dataset}: expected two panoramas in a scene, got fewer; choose another data set")
    truth = next((frame.image for pair in pairs for frame in pair.between), pairs[0].first.image)
    rows = read_header(truth).height
    return [
        BenchRun(
            Setting(method.name, size, threads), pairs if size[0] <= rows else pairs[:TIMED_PAIRS], job.frames,
            job.device, is_scored=size[0] <= rows,
        )
        for size in job.sizes
        for threads in job.threads or (available_threads(),)
        for method in methods
        if size == job.sizes[0] or method.name in ALL_SIZE_METHODS
    ]  # fmt: skip


def run_bench(
    report: Path, runs: Sequence[BenchRun], on_setting: Callable[[int, Figures], None] | None = None
) -> list[Figures]:
    """Measure what is not measured yet in the folder of a report; the figures of all settings in their order.

    InputError: unreadable earlier results or data set; OutputPathError, WriteError: the folder cannot be written.
    """
    make_folder(report, "results")
    path = report / RESULTS_NAME
    try:
        former = [FIGURES.validate_python(json.loads(line)) for line in complete_lines(path)]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: expected results of an earlier run, got '{error}'; name another folder") from error
    known = {figures.key: figures for figures in former if figures.status == "done"}
    files = Fingerprints()
    measured: list[Figures] = []
    for run in runs:
        ingredients = [run.setting.name, *find_method(run.setting.method).ingredients()]
        options = {"frames": run.frames, "device": run.device}
        key = "-".join(files.of(pair, ingredients, options)[:16] for pair in run.pairs)
        figures = known.get(key)
        if figures is None:
            figures = _measure_in_child(replace(run, key=key))
            append_line(path, asdict(figures))
        measured.append(figures)
        if on_setting:
            on_setting(len(measured), figures)
    return measured


def machine_in_words() -> str:
    """System, processor and number of cores."""
    return f"{platform.system()} {platform.machine()}, {available_threads()} cores"


COMPILING_MESSAGE = "compiling"  # what a process says, before its figures, when it compiles kernels


def _measure_in_child(run: BenchRun) -> Figures:
    """A run in a process of its own; another one where that had to compile kernels, which would count as its time."""
    return _measured_once(run) or _measured_once(run, is_patient=True) or _failed(run, "it compiled and did no more")


def _failed(run: BenchRun, reason: str) -> Figures:
    return Figures(run.setting, "failed", reason, key=run.key)


def _measured_once(run: BenchRun, *, is_patient: bool = False) -> Figures | None:
    """Figures of a process, None if it did no more than compile; whatever ends it is written down, the others go on."""
    context = spawn_context()
    ours, theirs = context.Pipe(duplex=False)
    with scratch_folder() as folder:
        process = context.Process(target=_serve, args=(theirs, run, folder, is_patient), daemon=True)
        process.start()
        theirs.close()
        try:
            figures = ours.recv()
            if figures == COMPILING_MESSAGE:
                announce_compiling()
                figures = ours.recv()
        except EOFError:
            process.join()
            figures = f"the process ended with exit code {process.exitcode}"
        finally:
            process.kill()
            process.join()
            ours.close()
    return figures if figures is None or isinstance(figures, Figures) else _failed(run, str(figures))


class _OnlyCompiledError(Exception):
    """Everything that is done once has been done, and kernels were compiled: what was measured is of no use."""


def _serve(connection: Connection, run: BenchRun, folder: Path, is_patient: bool) -> None:
    """Send figures, None if kernels were compiled at first, or the message of what went wrong."""
    compiled: list[str] = []

    def say() -> None:
        compiled.append(COMPILING_MESSAGE)
        connection.send(COMPILING_MESSAGE)

    def on_warm() -> None:
        if compiled and not is_patient:
            raise _OnlyCompiledError

    end_with_parent()
    try:
        with when_compiling(say):
            figures = measure_setting(run, folder, on_warm)
        connection.send(figures)
    except _OnlyCompiledError:
        connection.send(None)
    except Exception as error:  # noqa: BLE001 - one broken setting must not end a comparison of many
        connection.send(" ".join(f"{type(error).__name__}: {error}".split()))
