"""From a job to a walk: what is asked for is checked, depth is found, the page is written."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.fusion.confidence import PairConfidence
from omnisyn_cli.interpolation.checks import check_page
from omnisyn_cli.interpolation.job import TourJob
from omnisyn_cli.interpolation.plan import TourPlan, memory_of_surfaces, pairs_at_one_place, plan_tour
from omnisyn_cli.interpolation.planning.memory import Footprint
from omnisyn_cli.interpolation.summary import TourSummary, refuse_doubtful
from omnisyn_cli.interpolation.surfaces import tour_surfaces
from omnisyn_cli.interpolation.viewer.contents import TourPacker, ViewOptions
from omnisyn_cli.interpolation.viewer.page import MAX_PAGE_BYTES, block_name, write_folder, write_page
from omnisyn_cli.io.outputs import check_empty_folder, check_kept, staged_folder, write_parts
from omnisyn_cli.types import DepthEstimator

JPEG_PIXEL_BYTES, PNG_PIXEL_BYTES = 0.3, 2.0
"""Of each pixel of a photograph in a page; everything is there twice, packed and as the text of the page."""

MAP_VERTEX_BYTES = 4.0
"""Of each vertex of a surface, likewise: of both neighbours' pairs."""


@dataclass(frozen=True)
class ViewJob(TourJob):
    """What a user asks for of a viewer.

    Attributes:
        options: how the tour is packed.
        is_folder: whether it becomes a folder for a server instead of one file.
    """

    options: ViewOptions = field(default_factory=ViewOptions)
    is_folder: bool = False

    @property
    def follows_links(self) -> bool:
        """Always."""
        return True


@dataclass(frozen=True)
class ViewPlan(TourPlan):
    """A job that has been checked."""

    job: ViewJob

    @property
    def memory(self) -> int:
        """Bytes that it will take, estimated."""
        per_pixel = PNG_PIXEL_BYTES if self.job.options.is_lossless else JPEG_PIXEL_BYTES
        return memory_of_surfaces(
            self, Footprint(2 * per_pixel, 2 * MAP_VERTEX_BYTES, columns=self.job.options.texture)
        )

    def describe(self) -> dict[str, Any]:
        """See :meth:`TourPlan.described`."""
        options = self.job.options
        packing = {"folder": self.job.is_folder, "texture": options.texture, "lossless": options.is_lossless}
        return self.described(packing, self.memory)


@dataclass(frozen=True)
class ViewSummary(TourSummary):
    """What was done.

    Attributes:
        size: bytes that were written.
    """

    plan: ViewPlan
    size: int = 0

    @property
    def results(self) -> dict[str, Any]:
        """How much was written."""
        return {"bytes": self.size}


def plan_view(job: ViewJob) -> ViewPlan:
    """Check a job without writing anything.

    Raises:
        InputError: a file is missing, poses do not fit, an option makes no sense.
        OutputPathError: the output exists, cannot be written, is no name of a page, or would overwrite an input.
    """
    if job.is_folder:
        check_empty_folder(job.output, job.overwrite)
    else:
        check_page(job.output, job.overwrite)
    check_kept([job.output], (*job.images, *job.masks, job.poses), whole_folders=True)
    tour = plan_tour(job)
    job = replace(job, images=tour.job.images, masks=tour.job.masks)  # in the order that was found
    still = pairs_at_one_place(tour)
    notes = (*tour.notes, *(f"{where}: there is no way to walk, the page cross-fades" for where, _ in still))
    return ViewPlan(job, tour.entries, tour.source_sizes, tour.config, notes, tour.tour)


def run_view(
    plan: ViewPlan, on_pair: Callable[[int], None] | None = None, *, estimator: DepthEstimator | None = None
) -> ViewSummary:
    """Write the walk; all of it appears when everything has gone well.

    Args:
        plan: from :func:`plan_view`.
        on_pair: called with the number of finished pairs, after each.
        estimator: finds depth in place of what the plan asks for.

    Raises InputError: a picture, mask or depth file turns out to be damaged, a network cannot be used, or a pair is
    doubtful and the fallback is to give up; OutputPathError: the walk is too large for one file; WriteError: the
    disk is full.
    """
    clock = Stopwatch()
    pairs: dict[int, PairConfidence] = {}
    left_out: dict[int, float] = {}
    with staged_folder(plan.job.output) if plan.job.is_folder else nullcontext() as staged:
        keep = None if staged is None else partial(_write_block, staged)
        packer = TourPacker(plan, plan.job.options, keep)
        for done, pair in enumerate(tour_surfaces(plan, pairs, left_out, estimator=estimator, clock=clock), start=1):
            refuse_doubtful(plan, pair.index, pair.check.confidence)
            with clock("pack"):
                packer.add(pair)
            if staged is None:
                _check_size(plan, packer)
            if on_pair:
                on_pair(done)
        with clock("write"):
            walk = packer.packed()
            if staged is None:
                size = write_page(plan.job.output, walk)
            else:
                size = packer.blocks.size + write_folder(staged, walk, len(packer.blocks))
    return ViewSummary(plan, clock.with_total(), pairs, left_out, size)


def _write_block(folder: Path, number: int, content: bytes) -> None:
    """At once, so that a long tour does not have to be held."""
    write_parts(folder / block_name(number), [content])


def _check_size(plan: ViewPlan, packer: TourPacker) -> None:
    """As early as it shows."""
    if packer.blocks.size * 4 / 3 > MAX_PAGE_BYTES:
        raise OutputPathError(
            f"{plan.job.output}: expected a walk of at most {MAX_PAGE_BYTES >> 20} MiB in one file, got more with "
            f"{len(plan.entries)} panoramas of {plan.job.options.texture} columns; ask for fewer columns "
            "(--texture), or for a folder (--folder --serve)"
        )
