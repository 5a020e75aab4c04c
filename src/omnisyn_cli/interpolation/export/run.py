"""From a job to files for other programs: what is asked for is checked, then made panorama by panorama."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from annotated_types import Ge, Gt

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError, OutputPathError
from omnisyn_cli.fusion.confidence import PairConfidence
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.export import datasets
from omnisyn_cli.interpolation.export.datasets import DatasetView
from omnisyn_cli.interpolation.export.glb import GltfModel
from omnisyn_cli.interpolation.export.points import Points, joined, ply_points, ply_splats, points_of
from omnisyn_cli.interpolation.export.site_writer import MAX_CLIP_ROWS, SiteOptions, write_site
from omnisyn_cli.interpolation.export.triangulation import textured_mesh
from omnisyn_cli.interpolation.export.viewers import VIEWERS
from omnisyn_cli.interpolation.job import TourJob
from omnisyn_cli.interpolation.plan import TourPlan, memory_of_surfaces, pairs_at_one_place, plan_tour
from omnisyn_cli.interpolation.planning.memory import Footprint
from omnisyn_cli.interpolation.summary import TourSummary
from omnisyn_cli.interpolation.surfaces import PanoramaSurface, panorama_surfaces, tour_surfaces
from omnisyn_cli.io import check_output
from omnisyn_cli.io.documents import listed
from omnisyn_cli.io.outputs import check_empty_folder, check_kept, replaced_folder
from omnisyn_cli.io.ply import write_ply
from omnisyn_cli.poses.formats import foreign_from_pose
from omnisyn_cli.render.mesh import Cut, Mesh, build_mesh, mask_of_vertices
from omnisyn_cli.types import DepthEstimator

JPEG_PIXEL_BYTES, MODEL_VERTEX_BYTES = 0.4, 40
"""Of each pixel of a texture and each vertex of a surface in a GLB."""

POINT_BYTES, POINTS_PER_VERTEX = 107, 0.64
"""Of a point that is kept, and points for each vertex: they lie as dense everywhere, vertices denser at the poles."""

PLY_POINT_BYTES, PLY_SPLAT_BYTES = 31, 68
"""Bytes of a point and of a disc in a file."""

SITE_BYTES, SITE_PIXEL_BYTES, CLIP_PIXEL_BYTES = 290e6, 54, 190
"""Of a site without depth: the program, each pixel of a panorama that is read and made level, and each pixel of a clip
besides what finding depth takes: all of its frames are held to be played backwards. Measured."""


class Format(NamedTuple):
    """What there is to say about a format.

    Attributes:
        suffix: of its file; empty for those that fill a folder.
        up: of its world, see :data:`omnisyn_cli.poses.formats.WORLD_UP`.
        stride: pixels of the depth between its points, if nobody says so.
        sky: whether what is infinitely far is shown, likewise.
        point: bytes of a point as it is written; 0 where there are none.
        writing: bytes of each pixel of a panorama while its files are made.
    """

    suffix: str
    up: str
    stride: int
    sky: bool
    point: int = 0
    writing: float = 0.0


FORMATS: Mapping[str, Format] = {
    "glb": Format(".glb", "y", 1, sky=True),
    "ply": Format(".ply", "y", 1, sky=False, point=PLY_POINT_BYTES),
    "splats": Format(".ply", "-y", 1, sky=True, point=PLY_SPLAT_BYTES),
    "colmap": Format("", "-y", 4, sky=False, point=PLY_POINT_BYTES, writing=37),
    "nerfstudio": Format("", "z", 4, sky=False, point=PLY_POINT_BYTES, writing=20),
    **{name: Format("", "y", 1, sky=True) for name in VIEWERS},
}
"""By name. A ``.ply`` without a name is points."""

DOME_STEP_SHARE = 0.01
"""Share of its radius by which the dome of each panorama is larger than the last one's, so that none flickers."""

DOME_SHARE = 1.0 - 1e-4
"""What is as far as this share of the dome's radius lies on it."""


@dataclass(frozen=True)
class ExportJob(TourJob):
    """What a user asks for of an export.

    Attributes:
        format: one of :data:`FORMATS`; None goes by the ending of the output.
        texture: columns of the largest texture of a GLB and of panoramas of a site; larger panoramas are reduced.
        stride: pixels of the depth between points; None is the format's.
        sky: whether what is infinitely far is shown, on the dome; None is the format's.
        dome: metres around each panorama beyond which everything lies on one sphere.
        clips: make videos of the ways between the panoramas of a site.
    """

    format: str | None = None
    texture: Annotated[int, Ge(16)] = 4096
    stride: Annotated[int, Ge(1)] | None = None
    sky: bool | None = None
    dome: Annotated[float, Gt(0)] = 200.0
    clips: bool = False

    @property
    def follows_links(self) -> bool:
        """For sites, whose links need not be those of a chain."""
        return self.format in VIEWERS


@dataclass(frozen=True)
class ExportPlan(TourPlan):
    """A job that has been checked.

    Attributes:
        format: one of :data:`FORMATS`.
        stride, sky: as in the job, settled.
    """

    job: ExportJob
    format: str
    stride: int
    sky: bool

    @property
    def has_depth(self) -> bool:
        """Whether depth has to be found."""
        return self.format not in VIEWERS or VIEWERS[self.format].has_depth

    @property
    def memory(self) -> int:
        """Bytes that it will take, estimated."""
        chosen = FORMATS[self.format]
        if self.job.clips:
            rows = min(MAX_CLIP_ROWS, max(height for height, _ in self.source_sizes))
            return memory_of_surfaces(self, Footprint(0.0, 0.0)) + CLIP_PIXEL_BYTES * 2 * rows**2
        if not self.has_depth:
            return int(SITE_BYTES + SITE_PIXEL_BYTES * max(height * width for height, width in self.source_sizes))
        if chosen.point == 0:
            footprint = Footprint(JPEG_PIXEL_BYTES, MODEL_VERTEX_BYTES, columns=self.job.texture)
        else:
            spread = POINTS_PER_VERTEX / self.stride**2
            footprint = Footprint(0.0, spread * POINT_BYTES, spread * (POINT_BYTES + chosen.point), chosen.writing)
        return memory_of_surfaces(self, footprint)

    def describe(self) -> dict[str, Any]:
        """See :meth:`TourPlan.described`."""
        settled = {
            "texture": self.job.texture, "stride": self.stride, "sky": self.sky, "dome_metres": self.job.dome,
        }  # fmt: skip
        return self.described({"format": self.format}, self.memory, settled)


@dataclass(frozen=True)
class ExportSummary(TourSummary):
    """What was done.

    Attributes:
        points: that were written: of a cloud or a data set.
        triangles: of a mesh.
        links: between the panoramas of a site.
    """

    plan: ExportPlan
    points: int = 0
    triangles: int = 0
    links: int = 0

    advice: ClassVar[str] = "name depth files in the poses"
    last_remedy: ClassVar[str] = "depth files in the poses"

    @property
    def results(self) -> dict[str, Any]:
        """How much was written."""
        return {"points": self.points, "triangles": self.triangles, "links": self.links}


def plan_export(job: ExportJob) -> ExportPlan:
    """Check a job without writing anything.

    Raises:
        InputError: a file is missing, poses do not fit, an option makes no sense.
        OutputPathError: the output exists, cannot be written, or its ending says nothing of the format.
    """
    name, output = _format_of(job), job.output
    chosen = FORMATS[name]
    if chosen.suffix:
        check_output(output, job.overwrite)
    else:
        check_empty_folder(output, job.overwrite)
    tour = plan_tour(job)
    job = replace(job, images=tour.job.images, masks=tour.job.masks)  # in the order that was found
    companions = (file for entry in tour.entries for file in entry.companions)
    check_kept([output], (*job.images, *job.masks, job.poses, *companions), whole_folders=True)
    viewer = VIEWERS.get(name)
    if job.clips and (viewer is None or not viewer.plays_clips):
        players = [each for each, other in VIEWERS.items() if other.plays_clips]
        raise InputError(f"expected clips with {listed(players)}, got {name}; leave them out (--clips)")
    notes, has_depth = list(tour.notes), viewer is None or viewer.has_depth
    if viewer is not None:
        notes.append(f"the viewer is not part of the site, get it: {viewer.advice(output)}")
        lonely = [panorama.name for panorama in tour.tour.panoramas if not tour.tour.neighbours[panorama.name]]
        if has_depth and lonely:
            raise InputError(f"expected links to every panorama, got none to {listed(lonely)}; add some (tour.json)")
    if tour.config.estimates_depth and has_depth:
        notes += [f"{where}: without depth files there is none" for where, _ in pairs_at_one_place(tour)]
    return ExportPlan(
        job, tour.entries, tour.source_sizes, tour.config, tuple(notes), tour.tour, name, job.stride or chosen.stride,
        chosen.sky if job.sky is None else job.sky,
    )  # fmt: skip


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


def run_export(
    plan: ExportPlan, on_panorama: Callable[[int], None] | None = None, *, estimator: DepthEstimator | None = None
) -> ExportSummary:
    """Write the files; all of them appear when everything has gone well.

    Args:
        plan: from :func:`plan_export`.
        on_panorama: called with the number of finished panoramas, after each.
        estimator: finds depth in place of what the plan asks for.

    Raises InputError: a picture, mask or depth file turns out to be damaged, or nothing is left to be shown;
    WriteError: the disk is full, or the folder went away.
    """
    clock = Stopwatch()
    pairs: dict[int, PairConfidence] = {}
    left_out: dict[int, float] = {}

    def surfaces() -> Iterator[PanoramaSurface]:
        found = tour_surfaces(plan, pairs, left_out, estimator=estimator, clock=clock)
        for done, surface in enumerate(panorama_surfaces(found), start=1):
            yield surface
            if on_panorama:
                on_panorama(done)

    if plan.format in VIEWERS:
        found = tour_surfaces(plan, pairs, left_out, estimator=estimator, clock=clock) if plan.has_depth else None
        options = SiteOptions(plan.format, plan.job.texture, plan.job.dome, plan.job.clips)
        links = write_site(plan, options, found, clock, on_panorama)
        return ExportSummary(plan, clock.with_total(), pairs, left_out, links=links)
    write = {"glb": _write_model, "ply": _write_cloud, "splats": _write_cloud}.get(plan.format, _write_dataset)
    points, triangles = write(plan, surfaces(), clock)
    return ExportSummary(plan, clock.with_total(), pairs, left_out, points=points, triangles=triangles)


def _write_model(plan: ExportPlan, surfaces: Iterator[PanoramaSurface], clock: Stopwatch) -> tuple[int, int]:
    from omnisyn_cli import __version__

    model, triangles = GltfModel(f"omnisyn {__version__}"), 0
    for surface in surfaces:
        with clock("export"):
            picture = surface.samples(plan.job.texture)
            radius = plan.job.dome * (1.0 + DOME_STEP_SHARE * surface.index)
            whole = textured_mesh(_domed(plan, surface, radius), len(picture), plan.job.threads)
            near, sky = whole.split(radius * DOME_SHARE)
            shown = {"": near, "sky": sky} if plan.sky else {"": near}
            model.add(plan.job.images[surface.index].name, surface.view.pose, shown, picture)
            triangles += sum(len(mesh.triangles) for mesh in shown.values())
    if not triangles:
        raise InputError(_nothing(plan))
    with clock("write"):
        model.write(plan.job.output)
    return 0, triangles


def _write_cloud(plan: ExportPlan, surfaces: Iterator[PanoramaSurface], clock: Stopwatch) -> tuple[int, int]:
    parts = []
    for surface in surfaces:
        with clock("export"):
            parts.append(_points(plan, surface))
    points = joined(parts)
    if not len(points):
        raise InputError(_nothing(plan))
    with clock("write"):
        is_of_discs = plan.format == "splats"
        records = ply_splats(points) if is_of_discs else ply_points(points)
        world = "y down, z forward" if is_of_discs else "y up, -z forward"
        write_ply(plan.job.output, records, [f"metres, right-handed, x right, {world}"])
    return len(points), 0


def _write_dataset(plan: ExportPlan, surfaces: Iterator[PanoramaSurface], clock: Stopwatch) -> tuple[int, int]:
    job, is_colmap = plan.job, plan.format == "colmap"
    poses: dict[str, Pose] = {}
    sizes: dict[str, tuple[int, int]] = {}
    side, parts = datasets.face_side(max(plan.source_sizes)), []
    former = datasets.former_files(job.output, is_colmap=is_colmap)
    with replaced_folder(job.output, former, overwrite=job.overwrite) as staged:
        for surface in surfaces:
            with clock("export"):
                name, pose = datasets.safe_name(surface.index, job.images[surface.index]), surface.view.pose
                view = DatasetView(name, pose, surface.samples(), surface.mesh.inverse_depth, surface.view.mask)
                poses[name], sizes[name] = pose, view.size
                parts.append(_points(plan, surface))
                if is_colmap:
                    datasets.write_colmap_view(staged, view, side)
                else:
                    datasets.write_nerfstudio_view(staged, view)
        with clock("write"):
            points = joined(parts)
            if is_colmap:
                datasets.write_colmap(staged, poses, sizes, side, points)
            else:
                datasets.write_nerfstudio(staged, poses, sizes, points)
    return len(points), 0


def _points(plan: ExportPlan, surface: PanoramaSurface) -> Points:
    """Of one panorama, in the format's world."""
    dome = plan.job.dome
    pose = foreign_from_pose(surface.view.pose, camera="opengl", up=FORMATS[plan.format].up)
    farthest = np.inf if plan.sky else DOME_SHARE * dome
    mesh = _domed(plan, surface, dome)
    return points_of(mesh, surface.depth.confidence, surface.samples(), pose, plan.stride, farthest)


def _domed(plan: ExportPlan, surface: PanoramaSurface, radius: float) -> Mesh:
    """The surface with everything beyond a distance at that distance."""
    config, depth = plan.config, surface.depth
    rho = np.maximum(depth.inverse_depth, np.float32(1.0 / radius))
    cut, mask = Cut(config.cut, config.cut_metres), mask_of_vertices(surface.view.mask, rho.shape)
    return build_mesh(rho, cut, mask, depth.confidence)


def _nothing(plan: ExportPlan) -> str:
    return (
        f"{plan.job.output}: expected something nearer than {plan.job.dome:g} m, got sky or masks everywhere; "
        "name depth files, take panoramas that lie apart, or ask for the sky (--sky)"
    )
