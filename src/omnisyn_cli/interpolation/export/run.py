"""A tour written for other programs: a model, points, discs, a data set, or a site for a viewer."""

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation import loading
from omnisyn_cli.interpolation.export import datasets
from omnisyn_cli.interpolation.export import site as sites
from omnisyn_cli.interpolation.export.datasets import Points, joined, ply_points, ply_splats, points_of
from omnisyn_cli.interpolation.export.formats import FORMATS, MAX_CLIP_ROWS, ExportPlan, ExportSummary
from omnisyn_cli.interpolation.export.glb import GltfModel, textured_mesh
from omnisyn_cli.interpolation.export.viewers import VIEWERS, krpano_depth, site_files
from omnisyn_cli.interpolation.job import InterpolationJob, TourJob, of_panoramas
from omnisyn_cli.interpolation.loading import PairSurfaces, PanoramaSurface
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import open_video, read_header, read_panorama
from omnisyn_cli.io.encode import jpeg_bytes
from omnisyn_cli.io.ffmpeg_process import read_frames
from omnisyn_cli.io.images import read_picture
from omnisyn_cli.io.meshes import write_ply
from omnisyn_cli.io.outputs import former_files, hidden_folder, make_folder, replaced_folder
from omnisyn_cli.poses.file import POSES_NAME, distinct_names, write_poses
from omnisyn_cli.poses.formats.files import foreign_from_pose
from omnisyn_cli.render.mesh import Cut, Mesh
from omnisyn_cli.types import View

# Share of its radius by which the dome of each panorama is larger than the last one's, so that none flickers.
DOME_STEP_SHARE = 0.01
DOME_SHARE = 1.0 - 1e-4  # what is as far as this share of the dome's radius lies on it
# A second and a half, because longer ones make people wait; two thirds of the bytes of other videos.
CLIP_FRAMES, CLIP_FPS, CLIP_CRF = 37, 24.0, 20.0

Pairs = Iterator[PairSurfaces]
Count = Callable[[int], None]
"""What is found of a tour; called with the number of finished panoramas."""

HOTSPOT_PIXELS = 2048  # longest side of the picture of a hotspot. Set by hand.


def run_export(plan: ExportPlan, on_panorama: Callable[[int], None] | None = None) -> ExportSummary:
    """Write the files; all of them appear when everything has gone well.

    ``on_panorama`` is called with the number of finished panoramas after each. InputError: as for
    :func:`.loading.tour_surfaces`, or nothing is left to be shown. WriteError: the disk is full, or no folder is left.
    """
    clock, summary = Stopwatch(), ExportSummary(plan)
    writers = {"glb": _write_model, "ply": _write_cloud, "splats": _write_cloud, **dict.fromkeys(VIEWERS, _write_site)}
    pairs = loading.tour_surfaces(plan, summary, clock)
    made = writers.get(plan.format, _write_dataset)(plan, pairs, clock, on_panorama or (lambda done: None))
    results = {"points": 0, "triangles": 0, "links": 0, **made}
    return replace(summary, seconds=clock.with_total(), results=results)


def _counted(pairs: Pairs, count: Count) -> Iterator[PanoramaSurface]:
    """The surface of each panorama; it is counted when the next one is asked for."""
    for done, surface in enumerate(loading.panorama_surfaces(pairs), start=1):
        yield surface
        count(done)


def _write_model(plan: ExportPlan, pairs: Pairs, clock: Stopwatch, count: Count) -> dict[str, int]:
    from omnisyn_cli import __version__

    model, triangles = GltfModel(f"omnisyn {__version__}"), 0
    for surface in _counted(pairs, count):
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
    return {"triangles": triangles}


def _write_cloud(plan: ExportPlan, pairs: Pairs, clock: Stopwatch, count: Count) -> dict[str, int]:
    parts = []
    for surface in _counted(pairs, count):
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
    return {"points": len(points)}


def _write_dataset(plan: ExportPlan, pairs: Pairs, clock: Stopwatch, count: Count) -> dict[str, int]:
    job, is_colmap = plan.job, plan.format == "colmap"
    poses: dict[str, Pose] = {}
    sizes: dict[str, tuple[int, int]] = {}
    side, parts = datasets.face_side(max(plan.source_sizes)), []
    former = datasets.former_files(job.output, is_colmap=is_colmap)
    with replaced_folder(job.output, former, overwrite=job.overwrite) as staged:
        for surface in _counted(pairs, count):
            with clock("export"):
                name, view = datasets.safe_name(surface.index, job.images[surface.index]), surface.view
                poses[name], sizes[name] = view.pose, (view.image.shape[0], view.image.shape[1])
                parts.append(_points(plan, surface))
                if is_colmap:
                    datasets.write_colmap_view(staged, name, surface, side)
                else:
                    datasets.write_nerfstudio_view(staged, name, surface)
        with clock("write"):
            points = joined(parts)
            if is_colmap:
                datasets.write_colmap(staged, poses, sizes, side, points)
            else:
                datasets.write_nerfstudio(staged, poses, sizes, points)
    return {"points": len(points)}


def _points(plan: ExportPlan, surface: PanoramaSurface) -> Points:
    """Of one panorama, in the format's world."""
    pose = foreign_from_pose(surface.view.pose, camera="opengl", up=FORMATS[plan.format].up)
    farthest = np.inf if plan.sky else DOME_SHARE * plan.job.dome
    mesh = _domed(plan, surface, plan.job.dome)
    return points_of(mesh, surface.depth.confidence, surface.samples(), pose, plan.stride, farthest)


def _domed(plan: ExportPlan, surface: PanoramaSurface, radius: float) -> Mesh:
    """The surface with everything beyond a distance at that distance."""
    rho = np.maximum(surface.depth.inverse_depth, np.float32(1.0 / radius))
    return loading.mesh_of(surface.view, surface.depth, rho, Cut(plan.config.cut, plan.config.cut_metres))


def _nothing(plan: ExportPlan) -> str:
    return (
        f"{plan.job.output}: expected something nearer than {plan.job.dome:g} m, got sky or masks everywhere; "
        "name depth files, take panoramas that lie apart, or ask for the sky (--sky)"
    )


def _write_site(plan: ExportPlan, pairs: Pairs, clock: Stopwatch, count: Count) -> dict[str, int]:
    tour, job, images = plan.tour, plan.job, sites.hotspot_pictures(plan.tour)
    site = sites.site_of(tour, has_clips=job.clips)
    panoramas = {said.image: panorama for said, panorama in zip(tour.panoramas, site.panoramas, strict=True)}
    former = former_files(job.output, {viewer.document[0] for viewer in VIEWERS.values()}, sites.NAMED_FILE)
    with replaced_folder(job.output, former, overwrite=job.overwrite) as staged:
        with clock("write"):  # before depth is found: a damaged picture ends it
            for source, name in images.items():
                # encoded anew: what else a file holds stays where it is
                datasets.write_file(staged / name, "the site", jpeg_bytes(read_picture(source, HOTSPOT_PIXELS)))
        views = _views_with_depth(plan, pairs) if plan.has_depth else _views(plan, clock)
        known = ((panoramas[image], view, depth) for image, view, depth in views if image in panoramas)
        for done, (panorama, view, depth) in enumerate(known, start=1):
            with clock("export"):
                picture = sites.levelled(sites.photograph(view, job.texture), view.pose.rotation)
                datasets.write_file(staged / panorama.picture, "the site", jpeg_bytes(picture))
                if depth is not None:
                    datasets.write_file(staged / sites.DEPTH / f"{panorama.identity}.depth", "the site", depth)
            count(done)
        if job.clips:
            with clock("clips"):
                _write_clips(plan, site, staged)
        with clock("write"):
            for name, content in site_files(plan.format, site).items():
                datasets.write_file(staged / name, "the site", content)
    return {"links": site.links}


def _views(plan: ExportPlan, clock: Stopwatch) -> Iterator[tuple[Path, View, None]]:
    """File and view of every panorama. What moves with the camera is not looked for, because it is shown."""
    loader = loading.Loader(replace(plan, job=replace(plan.job, nadir=plan.job.nadir or 0.0)), clock, read_panorama)
    for panorama, index in zip(plan.tour.panoramas, _indices(plan), strict=True):
        yield panorama.image, loader[index], None


def _indices(plan: ExportPlan) -> list[int]:
    """Of the job's images, for every panorama of the tour."""
    return [plan.job.images.index(panorama.image) for panorama in plan.tour.panoramas]


def _views_with_depth(plan: ExportPlan, pairs: Pairs) -> Iterator[tuple[Path, View, bytes]]:
    """As :func:`_views`, with the file of the depth. A panorama comes again where a later pair knows more of it."""
    vertices: dict[int, int] = {}
    for pair in pairs:
        for surface in pair.surfaces:
            count = surface.depth.inverse_depth.size
            if count > vertices.get(surface.index, 0):
                vertices[surface.index] = count
                model = sites.depth_model(surface.mesh.inverse_depth, surface.view.pose.rotation, plan.job.dome)
                yield plan.job.images[surface.index], surface.view, krpano_depth(*model)


def _write_clips(plan: ExportPlan, site: sites.Site, staged: Path) -> None:
    """Videos of every way, level and looking north like the panoramas; the way back is the way there, backwards."""
    job, pictures = plan.job, {panorama.identity: staged / panorama.picture for panorama in site.panoramas}
    index_of = {panorama.identity: k for panorama, k in zip(site.panoramas, _indices(plan), strict=True)}
    clips = {
        (panorama.identity, str(link.target)): staged / str(link.clip)
        for panorama in site.panoramas
        for link in panorama.links
    }
    make_folder(staged / sites.CLIPS, "clips")
    with hidden_folder(staged / sites.CLIPS) as folder:
        poses = folder / POSES_NAME
        write_poses(poses, dict(zip(distinct_names(job.images), plan.entries, strict=True)), allow_outside=True)
        for (first, second), clip in clips.items():
            if first > second:
                continue
            rows = min(*(read_header(pictures[end]).height for end in (first, second)), MAX_CLIP_ROWS)
            size = (rows - rows % 2, 2 * (rows - rows % 2))
            there = _clip_job(plan, (index_of[first], index_of[second]), poses)
            run_interpolation(plan_interpolation(replace(there, output=clip, size=size)))
            frames = list(read_frames(clip, size, CLIP_FRAMES))
            with open_video(clips[second, first], size=size, fps=CLIP_FPS, crf=CLIP_CRF) as sink:
                for frame in reversed(frames):
                    sink.write(frame)


def _clip_job(plan: ExportPlan, ends: tuple[int, int], poses: Path) -> InterpolationJob:
    """The video between two panoramas of a tour, by all that the tour's job says; their poses are known by now."""
    job = plan.job
    asked: dict[str, Any] = {field.name: getattr(job, field.name) for field in fields(TourJob)}
    settled = {
        **of_panoramas(job, ends), "poses": poses, "allow_outside": True, "depth": plan.config.depth.kind,
        "baseline": None, "camera_height": None, "refine": False, "finds_order": False, "tour": None, "is_chain": True,
        "fallback": InterpolationJob.fallback if job.fallback == TourJob.fallback else job.fallback,
    }  # fmt: skip
    video = {"heading": "fixed", "frames": CLIP_FRAMES, "fps": CLIP_FPS, "crf": CLIP_CRF}
    return InterpolationJob(**{**asked, **settled, **video})
