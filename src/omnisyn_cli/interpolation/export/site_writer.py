"""A tour written as a site for a viewer: level panoramas, the viewer's own description of the tour, and a page."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.interpolation.export.datasets import safe_name
from omnisyn_cli.interpolation.export.site import (
    DEPTH,
    depth_model,
    hotspot_pictures,
    levelled,
    photograph,
    site_of,
)
from omnisyn_cli.interpolation.export.viewers import krpano_depth, site_files
from omnisyn_cli.interpolation.loading import Loader
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.surfaces import PairSurfaces
from omnisyn_cli.io import read_panorama
from omnisyn_cli.io.encode import jpeg_bytes
from omnisyn_cli.io.outputs import make_folder, staged_folder, write_errors, write_parts
from omnisyn_cli.types import View


def write_site(
    plan: TourPlan, viewer: str, columns: int, dome: float, surfaces: Iterator[PairSurfaces] | None, clock: Stopwatch,
    on_panorama: Callable[[int], None] | None = None,
) -> int:  # fmt: skip
    """Write the folder of a site; it appears when everything has gone well.

    Args:
        plan: of the tour.
        viewer: one of :data:`omnisyn_cli.interpolation.export.viewers.VIEWERS`.
        columns: that panoramas have at most.
        dome: metres beyond which depth is not modelled.
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
    site = site_of(tour, {panorama.name: identities[panorama.image] for panorama in tour.panoramas}, images)
    pictures = {panorama.identity: panorama.picture for panorama in site.panoramas}
    with staged_folder(job.output, overwrite=job.overwrite) as staged:
        views = _views(plan, clock) if surfaces is None else _views_with_depth(plan, surfaces, dome)
        known = ((identities[image], view, depth) for image, view, depth in views if image in identities)
        for done, (identity, view, depth) in enumerate(known, start=1):
            with clock("export"):
                picture = levelled(photograph(view, columns), view.pose.rotation)
                _write(staged / pictures[identity], jpeg_bytes(picture))
                if depth is not None:
                    _write(staged / DEPTH / f"{identity}.depth", depth)
            if on_panorama:
                on_panorama(done)
        with clock("write"):
            for name, content in site_files(viewer, site).items():
                _write(staged / name, content)
            for source, name in images.items():
                make_folder((staged / name).parent, "pictures of hotspots")
                with write_errors(job.output / name):
                    shutil.copyfile(source, staged / name)
    return site.links


def _views(plan: TourPlan, clock: Stopwatch) -> Iterator[tuple[Path, View, None]]:
    """File and view of every panorama. What moves with the camera is not looked for, because it is shown."""
    loader = Loader(replace(plan, job=replace(plan.job, nadir=plan.job.nadir or 0.0)), clock, read_panorama)
    for panorama in plan.tour.panoramas:
        yield panorama.image, loader[plan.job.images.index(panorama.image)], None


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


def _write(target: Path, content: bytes) -> None:
    make_folder(target.parent, "the site")
    write_parts(target, [content])
