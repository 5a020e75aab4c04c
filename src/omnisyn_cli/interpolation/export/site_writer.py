"""A tour written as a site for a viewer: level panoramas, the viewer's own description of the tour, and a page."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.interpolation.export.datasets import safe_name
from omnisyn_cli.interpolation.export.site import (
    CLIPS,
    DEPTH,
    NAMED_FILE,
    Site,
    depth_model,
    hotspot_pictures,
    levelled,
    photograph,
    site_of,
)
from omnisyn_cli.interpolation.export.viewers import VIEWERS, krpano_depth, site_files
from omnisyn_cli.interpolation.job import InterpolationJob, TourJob
from omnisyn_cli.interpolation.loading import Loader
from omnisyn_cli.interpolation.plan import TourPlan, plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.interpolation.surfaces import PairSurfaces
from omnisyn_cli.io import open_video, read_header, read_panorama
from omnisyn_cli.io.encode import jpeg_bytes
from omnisyn_cli.io.ffmpeg_process import read_frames
from omnisyn_cli.io.images import read_picture
from omnisyn_cli.io.outputs import former_files, hidden_folder, make_folder, replaced_folder, write_parts
from omnisyn_cli.poses.file import POSES_NAME, distinct_names, write_poses
from omnisyn_cli.types import View

CLIP_FRAMES, CLIP_FPS, CLIP_CRF = 37, 24.0, 20.0
"""A second and a half, because longer ones make people wait; two thirds of the bytes of other videos."""

HOTSPOT_PIXELS = 2048
"""Longest side of the picture of a hotspot. Set by hand."""

MAX_CLIP_ROWS = 1024
"""What telephones decode besides showing a sphere."""


@dataclass(frozen=True)
class SiteOptions:
    """What a site is like.

    Attributes:
        viewer: one of :data:`omnisyn_cli.interpolation.export.viewers.VIEWERS`.
        columns: that panoramas have at most.
        dome: metres beyond which depth is not modelled.
        has_clips: whether videos of the ways are made.
    """

    viewer: str
    columns: int
    dome: float
    has_clips: bool = False


def write_site(
    plan: TourPlan, options: SiteOptions, surfaces: Iterator[PairSurfaces] | None, clock: Stopwatch,
    on_panorama: Callable[[int], None] | None = None,
) -> int:  # fmt: skip
    """Write the folder of a site; it appears when everything has gone well.

    Args:
        plan: of the tour.
        options: what the site is like.
        surfaces: of all pairs for a viewer that wants depth, else None.
        clock: collects seconds by stage.
        on_panorama: called with the number of finished panoramas, after each.

    Returns how many links there are.
    """
    tour, job = plan.tour, plan.job
    identities = {
        panorama.image: safe_name(index, panorama.image).replace(".", "_")
        for index, panorama in enumerate(tour.panoramas)
    }
    images = hotspot_pictures(tour)
    names = {panorama.name: identities[panorama.image] for panorama in tour.panoramas}
    site = site_of(tour, names, images, has_clips=options.has_clips)
    pictures = {panorama.identity: panorama.picture for panorama in site.panoramas}
    former = former_files(job.output, {viewer.document[0] for viewer in VIEWERS.values()}, NAMED_FILE)
    with replaced_folder(job.output, former, overwrite=job.overwrite) as staged:
        with clock("write"):  # before depth is found: a damaged picture ends it
            for source, name in images.items():
                # encoded anew: what else a file holds stays where it is
                _write(staged / name, jpeg_bytes(read_picture(source, HOTSPOT_PIXELS)))
        views = _views(plan, clock) if surfaces is None else _views_with_depth(plan, surfaces, options.dome)
        known = ((identities[image], view, depth) for image, view, depth in views if image in identities)
        for done, (identity, view, depth) in enumerate(known, start=1):
            with clock("export"):
                picture = levelled(photograph(view, options.columns), view.pose.rotation)
                _write(staged / pictures[identity], jpeg_bytes(picture))
                if depth is not None:
                    _write(staged / DEPTH / f"{identity}.depth", depth)
            if on_panorama:
                on_panorama(done)
        if options.has_clips:
            with clock("clips"):
                _write_clips(plan, site, staged)
        with clock("write"):
            for name, content in site_files(options.viewer, site).items():
                _write(staged / name, content)
    return site.links


def _views(plan: TourPlan, clock: Stopwatch) -> Iterator[tuple[Path, View, None]]:
    """File and view of every panorama. What moves with the camera is not looked for, because it is shown."""
    loader = Loader(replace(plan, job=replace(plan.job, nadir=plan.job.nadir or 0.0)), clock, read_panorama)
    for panorama, index in zip(plan.tour.panoramas, _indices(plan), strict=True):
        yield panorama.image, loader[index], None


def _indices(plan: TourPlan) -> list[int]:
    """Of the job's images, for every panorama of the tour."""
    return [plan.job.images.index(panorama.image) for panorama in plan.tour.panoramas]


def _views_with_depth(
    plan: TourPlan, surfaces: Iterator[PairSurfaces], dome: float
) -> Iterator[tuple[Path, View, bytes]]:
    """As :func:`_views`, with the file of the depth.

    A pair at one place knows next to nothing of it, so a panorama comes again with one that knows more.
    """
    vertices: dict[int, int] = {}
    for pair in surfaces:
        for surface in pair.surfaces:
            count = surface.depth.inverse_depth.size
            if count > vertices.get(surface.index, 0):
                vertices[surface.index] = count
                model = depth_model(surface.mesh.inverse_depth, surface.view.pose.rotation, dome)
                yield plan.job.images[surface.index], surface.view, krpano_depth(*model)


def _write_clips(plan: TourPlan, site: Site, staged: Path) -> None:
    """Videos of every way in both directions, level and looking north like the panoramas that they begin and end with.

    They are made as a video between the two panoramas would be, with all that was asked for. The way back is the way
    there, played backwards.
    """
    job, pictures = plan.job, {panorama.identity: staged / panorama.picture for panorama in site.panoramas}
    index_of = {panorama.identity: k for panorama, k in zip(site.panoramas, _indices(plan), strict=True)}
    clips = {
        (panorama.identity, mark.target): staged / mark.clip
        for panorama in site.panoramas
        for mark in panorama.marks
        if mark.target is not None and mark.clip is not None
    }
    make_folder(staged / CLIPS, "clips")
    with hidden_folder(staged / CLIPS) as folder:
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


def _clip_job(plan: TourPlan, ends: tuple[int, int], poses: Path) -> InterpolationJob:
    """The video between two panoramas of a tour, by all that the tour's job says; their poses are known by now."""
    job = plan.job
    asked: dict[str, Any] = {field.name: getattr(job, field.name) for field in fields(TourJob)}
    settled = {
        "images": tuple(job.images[k] for k in ends), "masks": tuple(job.masks[k] for k in ends if job.masks),
        "poses": poses, "allow_outside": True, "depth": plan.config.depth.kind,
        "baseline": None, "camera_height": None, "refine": False, "finds_order": False, "tour": None, "is_chain": True,
        "fallback": InterpolationJob.fallback if job.fallback == TourJob.fallback else job.fallback,
    }  # fmt: skip
    video = {"heading": "fixed", "frames": CLIP_FRAMES, "fps": CLIP_FPS, "crf": CLIP_CRF}
    return InterpolationJob(**{**asked, **settled, **video})


def _write(target: Path, content: bytes) -> None:
    make_folder(target.parent, "the site")
    write_parts(target, [content])
