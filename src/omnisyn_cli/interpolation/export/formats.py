"""Formats of other programs: what is asked for, and what of it can be checked before anything is made."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

from annotated_types import Ge, Gt

from omnisyn_cli.errors import InputError, OutputPathError
from omnisyn_cli.interpolation.export.viewers import VIEWERS, Viewer
from omnisyn_cli.interpolation.job import TourJob, input_files, of_panoramas
from omnisyn_cli.interpolation.plan import TourPlan, plan_tour
from omnisyn_cli.interpolation.planning.memory import Footprint
from omnisyn_cli.interpolation.summary import TourSummary
from omnisyn_cli.io import check_output
from omnisyn_cli.io.documents import listed
from omnisyn_cli.io.outputs import check_empty_folder, check_kept

JPEG_PIXEL_BYTES, MODEL_VERTEX_BYTES = 0.4, 40  # of each pixel of a texture and each vertex of a surface in a GLB
# Of a point that is kept, and points for each vertex: they lie as dense everywhere, vertices denser at the poles.
POINT_BYTES, POINTS_PER_VERTEX = 107, 0.64
PLY_POINT_BYTES, PLY_SPLAT_BYTES = 31, 68  # of a point and of a disc in a file

# Of a site without depth: the program, each pixel of a panorama that is read and made level, and each pixel of a clip
# besides what finding depth takes: all of its frames are held to be played backwards. Measured.
SITE_BYTES, SITE_PIXEL_BYTES, CLIP_PIXEL_BYTES = 290e6, 54, 190
MAX_CLIP_ROWS = 1024  # what telephones decode besides showing a sphere


class Format(NamedTuple):
    """What there is to say about a format."""

    suffix: str  # of its file; empty for those that fill a folder
    up: str  # one of :data:`omnisyn_cli.poses.formats.files.WORLD_UP`
    stride: int  # default pixels of the depth between points
    sky: bool  # whether what is infinitely far is shown by default
    point: int = 0  # bytes of a point as it is written; 0 where there are none
    writing: float = 0.0  # bytes of each pixel of a panorama while its files are made


# By name. A ``.ply`` without a name is points.
FORMATS: Mapping[str, Format] = {
    "glb": Format(".glb", "y", 1, sky=True),
    "ply": Format(".ply", "y", 1, sky=False, point=PLY_POINT_BYTES),
    "splats": Format(".ply", "-y", 1, sky=True, point=PLY_SPLAT_BYTES),
    "colmap": Format("", "-y", 4, sky=False, point=PLY_POINT_BYTES, writing=37),
    "nerfstudio": Format("", "z", 4, sky=False, point=PLY_POINT_BYTES, writing=20),
    **{name: Format("", "y", 1, sky=True) for name in VIEWERS},
}


@dataclass(frozen=True)
class ExportJob(TourJob):
    """What a user asks for of an export."""

    format: str | None = None  # one of :data:`FORMATS`; None goes by the ending of the output
    # columns of the largest texture of a GLB and of panoramas of a site; larger panoramas are reduced
    texture: Annotated[int, Ge(16)] = 4096
    stride: Annotated[int, Ge(1)] | None = None  # pixels of the depth between points; None is the format's
    sky: bool | None = None  # whether what is infinitely far is shown, on the dome; None is the format's
    dome: Annotated[float, Gt(0)] = 200.0  # metres around each panorama beyond which everything lies on one sphere
    clips: bool = False  # make videos of the ways between the panoramas of a site

    @property
    def follows_links(self) -> bool:
        """For sites, whose links need not be those of a chain."""
        return self.format in VIEWERS


@dataclass(frozen=True)
class ExportPlan(TourPlan):
    """A job that has been checked; format, stride and sky are settled."""

    job: ExportJob
    format: str
    stride: int
    sky: bool

    @property
    def viewer(self) -> Viewer | None:
        """That of a site."""
        return VIEWERS.get(self.format)

    @property
    def has_depth(self) -> bool:
        """Whether depth has to be found."""
        return self.viewer is None or self.viewer.has_depth

    @property
    def memory(self) -> int:
        """Bytes that it will take, estimated."""
        chosen = FORMATS[self.format]
        if self.job.clips:
            rows = min(MAX_CLIP_ROWS, max(height for height, _ in self.source_sizes))
            return self.memory_estimate.of_surfaces(Footprint()) + CLIP_PIXEL_BYTES * 2 * rows**2
        if not self.has_depth:
            return int(SITE_BYTES + SITE_PIXEL_BYTES * max(height * width for height, width in self.source_sizes))
        if chosen.point == 0:
            footprint = Footprint(JPEG_PIXEL_BYTES, MODEL_VERTEX_BYTES, columns=self.job.texture)
        else:
            spread = POINTS_PER_VERTEX / self.stride**2
            footprint = Footprint(0.0, spread * POINT_BYTES, spread * (POINT_BYTES + chosen.point), chosen.writing)
        return self.memory_estimate.of_surfaces(footprint)

    def details(self) -> tuple[dict[str, Any], dict[str, Any], int]:
        """See :meth:`TourPlan.details`."""
        settled = {
            "texture": self.job.texture, "stride": self.stride, "sky": self.sky, "dome_metres": self.job.dome,
        }  # fmt: skip
        return {"format": self.format}, settled, self.memory


@dataclass(frozen=True)
class ExportSummary(TourSummary):
    """What was done; results are ``points`` of a cloud or a data set, ``triangles`` of a mesh, ``links`` of a site."""

    plan: ExportPlan

    advice: ClassVar[str] = "name depth files in the poses"


def plan_export(job: ExportJob) -> ExportPlan:
    """Check a job without writing anything.

    Raises InputError: a file is missing, poses do not fit, an option makes no sense; OutputPathError: the output
    exists, cannot be written, or its ending says nothing of the format.
    """
    name, output = _format_of(job), job.output
    chosen = FORMATS[name]
    if chosen.suffix:
        check_output(output, job.overwrite)
    else:
        check_empty_folder(output, job.overwrite)
    tour = plan_tour(job)
    job = replace(job, **of_panoramas(tour.job, range(len(tour.entries))))  # in the order that was found
    companions = (file for entry in tour.entries for file in entry.companions)
    check_kept([output], (*job.images, *input_files(job), job.poses, *companions), whole_folders=True)
    plan = ExportPlan(
        job, tour.entries, tour.source_sizes, tour.config, tour.notes, tour.tour, name, job.stride or chosen.stride,
        chosen.sky if job.sky is None else job.sky,
    )  # fmt: skip
    if job.clips and (plan.viewer is None or not plan.viewer.plays_clips):
        players = [each for each, other in VIEWERS.items() if other.plays_clips]
        raise InputError(f"expected clips with {listed(players)}, got {name}; leave them out (--clips)")
    lonely = [panorama.name for panorama in tour.tour.panoramas if not tour.tour.neighbours[panorama.name]]
    if plan.viewer is not None and plan.has_depth and lonely:
        raise InputError(f"expected links to every panorama, got none to {listed(lonely)}; add some (tour.json)")
    return replace(plan, notes=(*tour.notes, *_notes(plan)))


def _notes(plan: ExportPlan) -> Iterator[str]:
    if plan.viewer is not None:
        yield f"the viewer is not part of the site, get it: {plan.viewer.advice(plan.job.output)}"
    if plan.config.estimates_depth and plan.has_depth:
        yield from (f"{where}: without depth files there is none" for where, _ in plan.pairs_at_one_place())


def default_ending(name: str | None) -> str:
    """The ending, see :meth:`omnisyn_cli.interpolation.inputs.NamedTour.output`, of a format; None is the first one."""
    name = name or next(iter(FORMATS))
    return FORMATS[name].suffix or f"-{name}"


def _format_of(job: ExportJob) -> str:
    output = job.output
    if job.format is not None and job.format not in FORMATS:
        raise InputError(f"expected one of {', '.join(FORMATS)} as format, got {job.format!r}; choose one of these")
    suffix = output.suffix.lower()
    of_suffix = {known.suffix: name for name, known in [*FORMATS.items()][::-1] if known.suffix}
    name = job.format or of_suffix.get(suffix)
    if name is None:
        raise OutputPathError(
            f"{output}: expected a name ending in .glb or .ply, or a format for a folder, got '{suffix}'; name the "
            f"format (--format {'|'.join(FORMATS)})"
        )
    if FORMATS[name].suffix not in ("", suffix):
        raise OutputPathError(f"{output}: expected a name ending in {FORMATS[name].suffix} for {name}; change it")
    return name
