"""From a job to a walk: what is asked for is checked, depth is found, the page is written."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import OutputPathError, PoseError
from omnisyn_cli.interpolation.checks import check_page
from omnisyn_cli.interpolation.configs import page_config
from omnisyn_cli.interpolation.job import TourJob, input_files, of_panoramas
from omnisyn_cli.interpolation.loading import tour_surfaces
from omnisyn_cli.interpolation.plan import TourPlan, plan_tour
from omnisyn_cli.interpolation.planning.memory import Footprint
from omnisyn_cli.interpolation.summary import TourSummary
from omnisyn_cli.interpolation.viewer.contents import TourPacker
from omnisyn_cli.interpolation.viewer.packing import level_widths
from omnisyn_cli.interpolation.viewer.page import MANIFEST_NAME, MAX_PAGE_BYTES, NAMED_BLOCK, write_folder, write_page
from omnisyn_cli.io.documents import listed
from omnisyn_cli.io.outputs import check_empty_folder, check_kept, former_files, replaced_folder

# Of each pixel of a photograph in a page; everything is there twice, packed and as the text of the page.
JPEG_PIXEL_BYTES, PNG_PIXEL_BYTES = 0.3, 2.0
# Of each vertex of a surface, likewise, of both neighbours' pairs; and as it is stored.
MAP_VERTEX_BYTES, STORED_VERTEX_BYTES = 4.0, 1.4
# Of graphics memory: pixels of a texture with its mip levels, bytes of a vertex and of a pixel of the picture.
MIP_SHARE, GRAPHICS_VERTEX_BYTES, PICTURE_PIXEL_BYTES = 4 / 3, 18, 26
GRAPHICS_BUDGET_BYTES = 256 << 20  # of panoramas and surfaces, see ``web/world.js``; a link takes what it needs
SCREEN_PIXELS, BASE64_RATIO = 1920 * 1080, 4 / 3  # of the screen; characters for a byte


@dataclass(frozen=True)
class ViewJob(TourJob):
    """What a user asks for of a viewer."""

    texture: int = 4096  # columns that photographs have at most
    is_lossless: bool = False  # whether photographs are kept as PNG, several times as large, instead of JPEG
    is_folder: bool = False  # whether it becomes a folder for a server instead of one file
    fallback: str = "auto"  # as of every job

    follows_links = True


@dataclass(frozen=True)
class ViewPlan(TourPlan):
    """A job that has been checked."""

    job: ViewJob

    @property
    def _pixel_bytes(self) -> float:
        """Of each pixel of a photograph as it is stored."""
        return PNG_PIXEL_BYTES if self.job.is_lossless else JPEG_PIXEL_BYTES

    @property
    def memory(self) -> int:
        """Bytes that it will take, estimated; a folder is written as it is made."""
        held = 0.0 if self.job.is_folder else 1.0
        each = 2 * held * self._pixel_bytes, 2 * held * MAP_VERTEX_BYTES
        return self.memory_estimate.of_surfaces(Footprint(*each, columns=self.job.texture))

    def sizes(self) -> list[int]:
        """Bytes of every panorama with its surface in the walk, estimated."""
        surface = STORED_VERTEX_BYTES * self.memory_estimate.vertices
        text = 1.0 if self.job.is_folder else BASE64_RATIO
        return [round(text * (photo + surface)) for photo in map(self._photo_bytes, self.job.images, self.source_sizes)]

    def _photo_bytes(self, image: Path, size: tuple[int, int]) -> float:
        """Of all levels of a photograph; a JPEG does not become larger."""
        levels = level_widths(min(size[1], self.job.texture), has_half=self.job.is_folder)
        per_pixel = self._pixel_bytes
        if image.suffix.lower() in (".jpg", ".jpeg") and not self.job.is_lossless:
            per_pixel = min(per_pixel, image.stat().st_size / (size[0] * size[1]))
        return per_pixel * sum(width * width / 2 for width in levels)

    @property
    def graphics_memory(self) -> int:
        """Bytes of a graphics processor that a screen of 1920×1080 takes at the most, estimated."""
        width = min(max(cols for _, cols in self.source_sizes), self.job.texture)
        each = 4 * MIP_SHARE * width * width / 2 + GRAPHICS_VERTEX_BYTES * self.memory_estimate.vertices
        near = min(len(self.entries) * each, GRAPHICS_BUDGET_BYTES)
        return round(max(2 * each, near) + PICTURE_PIXEL_BYTES * SCREEN_PIXELS)

    def details(self) -> tuple[dict[str, Any], dict[str, Any], int]:
        """See :meth:`TourPlan.details`."""
        sizes = self.sizes()
        packing = {
            "folder": self.job.is_folder, "texture": self.job.texture, "lossless": self.job.is_lossless,
            "links": len(self.pairs), "megabytes": round(sum(sizes) / 1e6, 1),
            "megabytes_per_panorama": round(max(sizes) / 1e6, 2),
            "graphics_mib": round(self.graphics_memory / 2**20),
        }  # fmt: skip
        return packing, {}, self.memory


def plan_view(job: ViewJob) -> ViewPlan:
    """Check a job without writing anything.

    Raises InputError: a file is missing, poses do not fit, an option makes no sense; OutputPathError: the output
    exists, cannot be written, is no name of a page, or would overwrite an input.
    """
    if job.is_folder:
        check_empty_folder(job.output, job.overwrite)
    else:
        check_page(job.output, job.overwrite)
    check_kept([job.output], (*job.images, *input_files(job), job.poses), whole_folders=True)
    tour = plan_tour(job, page_config)
    linked = {view for pair in tour.pairs for view in pair}
    if alone := [image.name for k, image in enumerate(tour.job.images) if k not in linked]:
        raise PoseError(
            f'expected links to every panorama, got none to {listed(alone)}; add them to "links", or name the '
            "panoramas of the walk one by one"
        )
    job = replace(job, **of_panoramas(tour.job, range(len(tour.entries))))  # in the order that was found
    still = (f"{where}: there is no way to walk, the page cross-fades" for where, _ in tour.pairs_at_one_place())
    notes = (*tour.notes, *still)
    return ViewPlan(job, tour.entries, tour.source_sizes, tour.config, notes, tour.tour)


def run_view(plan: ViewPlan, on_pair: Callable[[int], None] | None = None) -> TourSummary:
    """Write the walk; all of it appears when everything has gone well.

    ``on_pair`` is called with the number of finished pairs after each. InputError: as for :func:`tour_surfaces`.
    OutputPathError: too large for one file. WriteError: the disk is full.
    """
    clock, job, summary = Stopwatch(), plan.job, TourSummary(plan)
    former = former_files(job.output, [MANIFEST_NAME], NAMED_BLOCK)
    folder = replaced_folder(job.output, former, overwrite=job.overwrite)
    with folder if job.is_folder else nullcontext() as staged:
        with clock("pack"):
            packer = TourPacker(plan, job.texture, is_lossless=job.is_lossless, folder=staged)
        for done, pair in enumerate(tour_surfaces(plan, summary, clock), start=1):
            with clock("pack"):
                packer.add(pair)
            if staged is None and packer.blocks.size * BASE64_RATIO > MAX_PAGE_BYTES:  # said as early as it shows
                raise OutputPathError(
                    f"{job.output}: expected a walk of at most {MAX_PAGE_BYTES >> 20} MiB in one file, got more with "
                    f"{len(plan.entries)} panoramas of {job.texture} columns; ask for fewer columns (--texture), or "
                    "for a folder (--folder --serve)"
                )
            if on_pair:
                on_pair(done)
        with clock("write"):
            if staged is None:
                size = write_page(job.output, packer.manifest(), packer.blocks.contents)
            else:
                size = write_folder(staged, packer.manifest(), packer.blocks)
    return replace(summary, seconds=clock.with_total(), results={"bytes": size})
