"""From a job to a walk: what is asked for is checked, depth is found, the page is written."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.fusion.confidence import PairConfidence
from omnisyn_cli.interpolation.checks import check_page
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import TourPlan, memory_of_surfaces, pairs_at_one_place, plan_tour
from omnisyn_cli.interpolation.planning.memory import Keeping
from omnisyn_cli.interpolation.summary import refuse_doubtful, warnings_about
from omnisyn_cli.interpolation.surfaces import tour_surfaces
from omnisyn_cli.interpolation.walk.contents import WalkOptions, WalkPacker
from omnisyn_cli.interpolation.walk.page import MOST_BYTES, write_folder, write_page
from omnisyn_cli.io.outputs import check_empty_folder, check_kept
from omnisyn_cli.types import DepthEstimator

JPEG_BYTES, PNG_BYTES = 0.3, 2.0
"""Of each pixel of a photograph in a page; everything is there twice, packed and as the text of the page."""

MAP_BYTES = 4.0
"""Of each vertex of a surface, likewise: of both neighbours' pairs."""


@dataclass(frozen=True)
class WalkJob:
    """What a user asks for.

    Attributes:
        tour: panoramas, poses, where depth comes from; its output is what is written. Its video's fields say nothing.
        options: how the walk is packed.
        is_folder: whether it becomes a folder for a server instead of one file.
    """

    tour: InterpolationJob
    options: WalkOptions = field(default_factory=WalkOptions)
    is_folder: bool = False


@dataclass(frozen=True)
class WalkPlan:
    """A job that has been checked.

    Attributes:
        job: what was asked for.
        tour: its panoramas, poses and depth.
    """

    job: WalkJob
    tour: TourPlan

    @property
    def memory(self) -> int:
        """Bytes that it will take, estimated."""
        per_pixel = PNG_BYTES if self.job.options.is_lossless else JPEG_BYTES
        return memory_of_surfaces(self.tour, Keeping(2 * per_pixel, 2 * MAP_BYTES, columns=self.job.options.texture))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know."""
        still = pairs_at_one_place(self.tour.job, self.tour.entries)
        return (*self.tour.notes, *(f"{where}: there is no way to walk, the page cross-fades" for where, _ in still))

    def describe(self) -> dict[str, Any]:
        """The plan as plain values, for people and for JSON."""
        job, recipe = self.tour.job, self.tour.recipe
        return {
            "inputs": [str(image) for image in job.images], "output": str(job.output), "folder": self.job.is_folder,
            "texture": self.job.options.texture, "lossless": self.job.options.is_lossless, "preset": job.preset,
            "depth": recipe.depth.kind, "model": recipe.depth.model or "", "joined_depths": self.tour.joined_depths,
            "memory_mib": round(self.memory / 2**20), "notes": list(self.notes),
        }  # fmt: skip


@dataclass(frozen=True)
class WalkSummary:
    """What was done.

    Attributes:
        plan: what was planned.
        size: bytes that were written.
        seconds: wall time by stage; ``total`` is all of it.
        pairs: how far depth can be relied on, by the index of the first panorama.
    """

    plan: WalkPlan
    size: int
    seconds: dict[str, float]
    pairs: dict[int, PairConfidence] = field(default_factory=dict)

    def describe(self) -> dict[str, Any]:
        """The summary as plain values."""
        stages = {stage: round(value, 3) for stage, value in self.seconds.items()}
        pairs = [{"first": index, **pair.describe()} for index, pair in self.pairs.items()]
        return {**self.plan.describe(), "bytes": self.size, "stages": stages, "confidence": pairs}

    def warnings(self) -> list[str]:
        """A line for every pair that scores too low to be relied on."""
        return warnings_about(self.plan.tour, self.pairs)


def plan_walk(job: WalkJob) -> WalkPlan:
    """Check a job without writing anything.

    Raises:
        InputError: a file is missing, poses do not fit, an option makes no sense.
        OutputPathError: the output exists, cannot be written, or is no name of a page.
    """
    check_walk(job)
    return WalkPlan(job, plan_tour(job.tour))


def check_walk(job: WalkJob) -> None:
    """Refuse a place that a walk could not be written to, or that would overwrite what it is made of."""
    output, tour = job.tour.output, job.tour
    if job.is_folder:
        check_empty_folder(output, tour.overwrite)
    else:
        check_page(output, tour.overwrite)
    check_kept([output], (*tour.images, *tour.masks, tour.poses), whole_folders=True)


def run_walk(
    plan: WalkPlan, on_pair: Callable[[int], None] | None = None, *, estimator: DepthEstimator | None = None
) -> WalkSummary:
    """Write the walk; all of it appears when everything has gone well.

    Args:
        plan: from :func:`plan_walk`.
        on_pair: called with the number of finished pairs, after each.
        estimator: finds depth in place of what the plan asks for.

    Raises:
        InputError: a picture, mask or depth file turns out to be damaged, a network cannot be used, or a pair is
            doubtful and the fallback is to give up.
        OutputPathError: the walk is too large for one file.
        WriteError: the disk is full.
    """
    begin, clock = time.perf_counter(), Stopwatch()
    packer, scores = WalkPacker(plan.tour, plan.job.options), {}
    for done, pair in enumerate(tour_surfaces(plan.tour, estimator=estimator, clock=clock), start=1):
        scores[pair.index] = confidence = pair.check.confidence
        refuse_doubtful(plan.tour, pair.index, confidence)
        with clock("pack"):
            packer.add(pair)
        if not plan.job.is_folder:
            _check_size(plan, packer)
        if on_pair:
            on_pair(done)
    with clock("write"):
        write = write_folder if plan.job.is_folder else write_page
        size = write(plan.tour.job.output, packer.packed())
    return WalkSummary(plan, size, {**clock.seconds, "total": time.perf_counter() - begin}, scores)


def _check_size(plan: WalkPlan, packer: WalkPacker) -> None:
    """As early as it shows."""
    if packer.blocks.size * 4 / 3 > MOST_BYTES:
        raise OutputPathError(
            f"{plan.tour.job.output}: expected a walk of at most {MOST_BYTES >> 20} MiB in one file, got more with "
            f"{len(plan.tour.entries)} panoramas of {plan.job.options.texture} columns; ask for fewer columns "
            "(--texture), or for a folder (--folder --serve)"
        )
