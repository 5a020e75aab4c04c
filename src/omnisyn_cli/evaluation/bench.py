"""Settings measured one after the other, each in a process of its own, each written down when it is finished.

Interrupted and started again with the same folder, a run goes on where it was.
"""

import json
import multiprocessing
import platform
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from multiprocessing.connection import Connection
from pathlib import Path

from omnisyn_cli.batch.local_executor import end_with_parent
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.bench_run import BenchRun, measure_setting
from omnisyn_cli.evaluation.datasets import Pair, choose_pairs, find_scenes
from omnisyn_cli.evaluation.fingerprint import Fingerprints
from omnisyn_cli.evaluation.methods import ingredients_of
from omnisyn_cli.evaluation.pareto import FIGURES, Figures, Setting
from omnisyn_cli.evaluation.scene_files import suite_scenes, write_suite_scene
from omnisyn_cli.io.outputs import make_folder, staged_folder, write_parts
from omnisyn_cli.runtime.jit import announce_compiling, when_compiling
from omnisyn_cli.runtime.threads import available_threads
from omnisyn_cli.scenes.suite import SEEDS
from omnisyn_cli.synthesis.presets import PRESETS, SCALE

__all__ = ["BenchJob", "machine_in_words", "make_scenes", "plan_bench", "run_bench"]

RESULTS_NAME = "bench.jsonl"

GENERATED = {"street": 2.0, "room": 1.0}
"""Scenes of the standard set that are measured where no others are given: the kind and its baseline in metres."""


@dataclass(frozen=True)
class BenchJob:
    """What a user asks for.

    Attributes:
        dataset: folder of scenes; figures without true frames have no accuracy.
        report: folder for results; made if it is not there.
        presets: names of :data:`omnisyn_cli.synthesis.presets.PRESETS`.
        depth_rows: that depth is looked for at; empty means those of each preset.
        sizes: (height, width) of the frames.
        threads: empty means one per core.
        frames: that are rendered of every clip.
        layout: of the data set.
        pairs: which frames are inputs.
        device: where networks run.
    """

    dataset: Path
    report: Path
    presets: tuple[str, ...] = tuple(SCALE)
    depth_rows: tuple[int, ...] = ()
    sizes: tuple[tuple[int, int], ...] = ((512, 1024), (1024, 2048))
    threads: tuple[int, ...] = ()
    frames: int = 24
    layout: str = "auto"
    pairs: str | None = None
    device: str = "auto"


@dataclass(frozen=True)
class BenchPlan:
    """A job with its settings and pairs."""

    job: BenchJob
    settings: tuple[Setting, ...]
    pairs: tuple[Pair, ...]


def make_scenes(folder: Path, size: tuple[int, int]) -> None:
    """Write the scenes of :data:`GENERATED` into a folder; those that are there already stay.

    Raises:
        OutputPathError, WriteError: the folder cannot be written.
    """
    make_folder(folder, "results")
    for kind, baseline in GENERATED.items():
        for walk in suite_scenes((kind,), SEEDS[:1]):
            if walk.baseline == baseline and walk.path and not (folder / walk.name).exists():
                with staged_folder(folder / walk.name) as staged:
                    write_suite_scene(staged, walk, size)


def plan_bench(job: BenchJob) -> BenchPlan:
    """All settings, the fastest preset first; nothing is measured yet.

    Raises:
        InputError: no such preset, no scenes, or poses that cannot be read.
    """
    unknown = [name for name in job.presets if name not in PRESETS]
    if unknown:
        raise InputError(f"expected presets of {', '.join(PRESETS)}, got {', '.join(unknown)}; choose some of these")
    choose = choose_pairs(job.pairs)
    pairs = tuple(pair for source in find_scenes(job.dataset, job.layout) for pair in choose(source.read()))
    if not pairs:
        raise InputError(f"{job.dataset}: expected two panoramas in a scene, got fewer; choose another data set")
    return BenchPlan(job, tuple(_settings(job)), pairs)


def _settings(job: BenchJob) -> Sequence[Setting]:
    axes = product(job.sizes, job.threads or (available_threads(),), job.presets)
    return [
        Setting(preset, rows, size, threads)
        for size, threads, preset in axes
        for rows in job.depth_rows or (PRESETS[preset].recipe.depth.rows,)
    ]


def run_bench(plan: BenchPlan, on_setting: Callable[[int, Figures], None] | None = None) -> list[Figures]:
    """Measure what is not measured yet; the figures of all settings in their order.

    Args:
        plan: from :func:`plan_bench`.
        on_setting: called with the number of finished settings and the figures of the last one.

    Raises:
        InputError: the results of an earlier run cannot be read, or a file of the data set is missing.
        OutputPathError, WriteError: the folder of the report cannot be written.
    """
    make_folder(plan.job.report, "results")
    path = plan.job.report / RESULTS_NAME
    known = {figures.key: figures for figures in _read(path) if figures.status == "done"}
    files = Fingerprints()
    measured: list[Figures] = []
    for setting in plan.settings:
        key = _key(plan, setting, files)
        figures = known.get(key)
        if figures is None:
            figures = _in_child(BenchRun(setting, plan.pairs, plan.job.frames, plan.job.device, key))
            _append(path, figures)
        measured.append(figures)
        if on_setting:
            on_setting(len(measured), figures)
    return measured


def machine_in_words() -> str:
    """System, processor and number of cores."""
    return f"{platform.system()} {platform.machine()}, {available_threads()} cores"


def _key(plan: BenchPlan, setting: Setting, files: Fingerprints) -> str:
    ingredients = [setting.name, *ingredients_of(PRESETS[setting.preset].recipe)]
    options = {"frames": plan.job.frames, "device": plan.job.device}
    return "-".join(files.of(pair, ingredients, options)[:16] for pair in plan.pairs)


def _read(path: Path) -> list[Figures]:
    """All complete lines of an earlier run."""
    if not path.exists():
        return []
    try:
        lines = path.read_text(encoding="utf-8").split("\n")[:-1]
        return [FIGURES.validate_python(json.loads(line)) for line in lines]
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: expected results of an earlier run, got '{error}'; name another folder") from error


def _append(path: Path, figures: Figures) -> None:
    """Add a line; what an interrupted run left of one is replaced."""
    complete, newline, _ = path.read_bytes().rpartition(b"\n") if path.exists() else (b"", b"", b"")
    line = json.dumps(figures.to_json(), ensure_ascii=False, allow_nan=False) + "\n"
    write_parts(path, [complete, newline, line.encode("utf-8", "backslashreplace")])


COMPILING = "compiling"
"""What a process says, before its figures, when it compiles kernels."""


def _in_child(run: BenchRun) -> Figures:
    """A run in a process of its own; once more where kernels were compiled, which would count as its time."""
    figures, has_compiled = _measured_once(run)
    return _measured_once(run)[0] if has_compiled and figures.status == "done" else figures


def _measured_once(run: BenchRun) -> tuple[Figures, bool]:
    """Figures of a process, and whether it compiled; whatever ends it is written down, and the others go on."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(prefix="omnisyn-bench-", ignore_cleanup_errors=True) as folder:
        process = context.Process(target=_serve, args=(theirs, run, Path(folder), time.time()), daemon=True)
        process.start()
        theirs.close()
        has_compiled = False
        try:
            figures = ours.recv()
            if figures == COMPILING:
                has_compiled = True
                announce_compiling()
                figures = ours.recv()
        except EOFError:
            process.join()
            figures = f"the process ended with exit code {process.exitcode}"
        finally:
            process.kill()
            process.join()
            ours.close()
    if not isinstance(figures, Figures):
        figures = Figures(run.setting, "failed", str(figures), run.key)
    return figures, has_compiled


def _serve(connection: Connection, run: BenchRun, folder: Path, launched: float) -> None:
    """Send figures, or the message of what went wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal: the first one decides
    end_with_parent()
    try:
        with when_compiling(lambda: connection.send(COMPILING)):
            figures = measure_setting(run, folder, launched)
        connection.send(figures)
    except Exception as error:  # noqa: BLE001 - one broken setting must not end a comparison of many
        connection.send(" ".join(f"{type(error).__name__}: {error}".split()))
