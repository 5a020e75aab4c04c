"""The first run after an installation, shortened: a second process compiles what is drawn with while the first matches.

It makes a frame of two small plain pictures, of the types that the job will have, so that the same kernels are
compiled and kept on disk. Whichever process comes to a kernel first compiles it; the other one waits for it, or finds
it. The second process is this interpreter with this module, not a copy of the first one, so that it does not matter how
that was started; it ends with it, and where it cannot work nothing is lost but its help.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import omnisyn_cli
from omnisyn_cli.fusion.kernels import blend_band
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.job import is_rounded
from omnisyn_cli.interpolation.plan import InterpolationPlan, TourPlan
from omnisyn_cli.io import read_header
from omnisyn_cli.render.raster_kernels import rasterize_blocks
from omnisyn_cli.runtime.jit import OtherCompiler, are_kernels_kept, is_on_disk, reporting_to
from omnisyn_cli.runtime.threads import available_threads
from omnisyn_cli.synthesis.making import make_method
from omnisyn_cli.synthesis.recipe import OMNISYN, DepthSource, Recipe
from omnisyn_cli.synthesis.segments import Stopwatch, SynthesisOptions, measure_pair
from omnisyn_cli.synthesis.tours import TourDepths
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["Rehearsal", "rehearsed"]

MOST_ROWS = 1024
"""Of the frame that is made for practice; frames of more rows are made by the same kernels."""

SMALL = (64, 128)
"""Height and width of the two pictures."""

THREADS = 2
"""A single one does without some kernels, and there are two at least."""

MATCHED = ("matching", "refined")
"""Sources of depth that keep the first process busy with kernels of their own."""


@dataclass(frozen=True)
class Rehearsal:
    """What decides which kernels a job will need, besides those that find depth.

    Attributes:
        recipe: what frames are made with.
        size: height and width of the frames; None where only surfaces are wanted.
        has_samples: whether the panoramas come as samples of 8 bits.
        is_rounded: whether the frames are wanted as such.
    """

    recipe: Recipe
    size: tuple[int, int] | None
    has_samples: bool
    is_rounded: bool

    @classmethod
    def of(cls, plan: TourPlan) -> "Rehearsal":
        """That of a video, or of something else that is made of surfaces."""
        size = plan.size if isinstance(plan, InterpolationPlan) else None
        has_samples = all(read_header(image).dtype == "uint8" for image in plan.job.images)
        return cls(replace(plan.recipe, device="cpu"), size, has_samples, size is not None and is_rounded(plan.job))

    @classmethod
    def from_json(cls, text: str) -> "Rehearsal":
        """The inverse of :meth:`to_json`."""
        values: dict[str, Any] = json.loads(text)
        recipe = values.pop("recipe")
        size = values.pop("size")
        depth = DepthSource(**recipe.pop("depth"))
        return cls(Recipe(depth, **recipe), None if size is None else tuple(size), **values)

    def to_json(self) -> str:
        """As a line of text."""
        return json.dumps(asdict(self))

    def perform(self) -> None:
        """Make a frame, or what frames are judged by, of two plain pictures a metre apart."""
        views = [_plain_view(self.has_samples, z) for z in (0.0, -1.0)]
        depth = _two_walls()
        if self.size is None:
            clock = Stopwatch()
            tour = TourDepths(views, lambda *_: (depth, depth), clock, THREADS)
            measure_pair(0, tour, SynthesisOptions(SMALL, threads=THREADS), clock)
            return
        rows = min(self.size[0], MOST_ROWS)
        method = make_method(self.recipe, (rows, 2 * rows), threads=THREADS, estimator=lambda *_: (depth, depth))
        pair = method.prepare(0, views)
        memory = np.empty((rows, 2 * rows, 3), np.uint8)
        pair.frame(
            Waypoint(0, 0.5, Pose(np.eye(3), np.array([0.0, 0.0, -0.5]))), (lambda: memory) if self.is_rounded else None
        )


def _plain_view(has_samples: bool, z: float) -> View:
    is_light = np.indices(SMALL).sum(axis=0) % 2 == 0  # edges stand out, but nothing could have moved between the two
    samples = np.where(is_light[..., None], np.uint8(187), np.uint8(67)).repeat(3, axis=-1)
    image = np.divide(samples, np.float32(255.0), dtype=np.float32)
    return View(image, Pose(np.eye(3), np.array([0.0, 0.0, z])), samples=samples if has_samples else None)


def _two_walls() -> DepthEstimate:
    """A near one before a far one: there is something to cut, to hide and to fill."""
    inverse_depth = np.full(SMALL, 0.2, np.float32)
    inverse_depth[16:48, 8:] = np.where(np.arange(SMALL[1] - 8) % 32 < 12, 1.5, 0.2)
    return DepthEstimate(inverse_depth, np.ones(SMALL, np.float32))


@contextmanager
def rehearsed(plan: TourPlan) -> Iterator[None]:
    """Inside, another process compiles the kernels that a job will draw with, if that is worth while."""
    process = _started(Rehearsal.of(plan)) if _is_worth_while(plan) else None
    if process is None or process.stdout is None:
        yield
        return
    other = OtherCompiler()
    threading.Thread(target=_listen, args=(process.stdout, other), daemon=True).start()
    try:
        with other.awaited():
            yield
    finally:
        process.kill()
        process.wait()
        with suppress(OSError):
            if process.stdin is not None:
                process.stdin.close()


def _is_worth_while(plan: TourPlan) -> bool:
    """Whether kernels that are drawn with are missing, matching keeps this process busy, and there is another core."""
    recipe = plan.recipe
    has_time = min(plan.job.threads or available_threads(), available_threads()) > 1
    is_drawn = recipe.method == OMNISYN and recipe.renderer == "mesh" and not recipe.is_on_gpu
    if not (has_time and is_drawn and recipe.depth.kind in MATCHED and are_kernels_kept()):
        return False
    last = blend_band if isinstance(plan, InterpolationPlan) else rasterize_blocks
    return not is_on_disk(last)


def _started(rehearsal: Rehearsal) -> "subprocess.Popen[str] | None":
    """The other process; None where there is no interpreter to start."""
    if not sys.executable or getattr(sys, "frozen", False):
        return None
    here = str(Path(omnisyn_cli.__file__).parents[1])
    paths = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    try:
        process = subprocess.Popen(  # noqa: S603 - this interpreter, a module of this package, no shell
            [sys.executable, "-P", "-m", __name__], env={**os.environ, "PYTHONPATH": paths}, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError:
        return None
    with suppress(OSError):  # it has ended already, which is noticed where it is listened to
        if process.stdin is not None:
            process.stdin.write(rehearsal.to_json() + "\n")  # and left open: its end is that of this process
            process.stdin.flush()
    return process


def _listen(reports: Any, other: OtherCompiler) -> None:
    """Hand on what the other process says until it ends."""
    with reports:
        for report in reports:
            other.hear(report.rstrip("\n"))
    other.end()


def _perform_while_wanted() -> None:
    """The work of the other process: what standard input asks for, until it is done or nobody is there any more."""

    def say(report: str) -> None:
        sys.stdout.write(report + "\n")
        sys.stdout.flush()

    rehearsal = Rehearsal.from_json(sys.stdin.readline())
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True).start()
    with reporting_to(say):
        rehearsal.perform()


if __name__ == "__main__":
    _perform_while_wanted()
