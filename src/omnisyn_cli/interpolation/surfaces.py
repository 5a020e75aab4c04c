"""The depth and the meshes of a tour, for what is made of surfaces instead of frames.

:func:`tour_surfaces` goes through the pairs of neighbours as ``interpolate`` does, with the same poses, masks, depth
and preset; :func:`panorama_surfaces` is for what wants the surface of each panorama once.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, groupby

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.interpolation.loading import Loader
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.summary import TourSummary, refuse_doubtful
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.render.mesh import Cut, Mesh, build_mesh, mask_of_vertices
from omnisyn_cli.synthesis.chain_depth import ChainDepth
from omnisyn_cli.synthesis.consistency import CrossCheck
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions, drawn_surfaces, measure_pair, usable_image
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View


@dataclass(frozen=True)
class PanoramaSurface:
    """A posed panorama, by its index in the job, and its surface.

    Depth (1/metre and confidence) has a resolution of its own. The mesh is in the frame of the panorama and cut by the
    config's rule; masked vertices have no surface.
    """

    index: int
    view: View
    depth: DepthEstimate
    mesh: Mesh

    def texture(self) -> Float[np.ndarray, "height width 3"] | UInt8[np.ndarray, "height width 3"]:
        """The photograph, with masked pixels painted over from around them: samples of 8 bits, or RGB in [0, 1]."""
        return usable_image(self.view, SynthesisOptions(self.mesh.size))

    def samples(self, columns: int | None = None) -> UInt8[np.ndarray, "rows cols 3"]:
        """That in 8 bits, at most so many columns wide."""
        return quantized_picture(self.texture(), columns)


def quantized_picture(picture: np.ndarray, columns: int | None) -> UInt8[np.ndarray, "rows cols 3"]:
    """A panorama, samples of 8 bits or RGB in [0, 1], in 8 bits and at most so many columns wide."""
    if picture.dtype != np.uint8:
        picture = np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)
    if columns is None or picture.shape[1] <= columns:
        return picture
    return np.asarray(cv2.resize(picture, (columns, columns // 2), interpolation=cv2.INTER_AREA))


@dataclass(frozen=True)
class PairSurfaces:
    """The surfaces of two neighbours, by the index of the pair in the plan: in a chain that of its first panorama.

    The cross-check says how differently they are exposed, and how far what is made of them can be relied on. Soft ones
    are uncut and dissolve into each other (:mod:`omnisyn_cli.synthesis.soft_surface`).
    """

    index: int
    surfaces: tuple[PanoramaSurface, PanoramaSurface]
    cross_check: CrossCheck
    is_soft: bool = False


def tour_surfaces(
    plan: TourPlan,
    summary: TourSummary | None = None,
    *,
    estimator: DepthEstimator | None = None,
    clock: Stopwatch | None = None,
) -> Iterator[PairSurfaces]:
    """The surfaces of every pair of the plan, one pair at a time, in order.

    The summary is given what there is to know about pairs and panoramas, the clock the seconds of each stage. An
    estimator finds depth in place of that of the plan's config, of which depth, cut and device matter.

    Raises InputError: a picture, mask or depth file turns out to be damaged, a network cannot be used, or a pair is
    doubtful and the fallback is to give up.
    """
    clock, config, threads = clock or Stopwatch(), plan.config, plan.job.threads
    loader = Loader(plan, clock, read_panorama)
    estimator = estimator or make_estimator(config.depth, device=config.device, threads=threads)
    tour = ChainDepth(loader, estimator, clock, threads, plan.pairs)
    for index, (first, second) in enumerate(plan.pairs):
        with limited_threads(threads):
            views = loader[first], loader[second]
            size, cut = min(view.image.shape[:2] for view in views), Cut(config.cut, config.cut_metres)
            depths, check = measure_pair(index, tour, SynthesisOptions(size, cut=cut, threads=threads), clock)
            with clock("mesh"):
                pair = pair_surfaces(plan, index, views, depths, check)
        refuse_doubtful(plan, index, check.confidence)
        if summary is not None:
            summary.pairs[index] = check.confidence
            summary.left_out.update(loader.left_out)
            if pair.is_soft:
                summary.soft_pairs.append(index)
        yield pair


def pair_surfaces(
    plan: TourPlan, index: int, views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate], check: CrossCheck
) -> PairSurfaces:
    """The surfaces of a pair whose depth is known; the plan's config says where they are cut, and whether softly."""
    cut, softens = Cut(plan.config.cut, plan.config.cut_metres), plan.config.fallback == "soft"
    views, depths, cut, is_soft = drawn_surfaces(views, depths, check, cut, softens=softens)
    first, second = (
        PanoramaSurface(place, view, depth, mesh_of(view, depth, depth.inverse_depth, cut))
        for place, view, depth in zip(plan.pairs[index], views, depths, strict=True)
    )
    return PairSurfaces(index, (first, second), check, is_soft)


def mesh_of(view: View, depth: DepthEstimate, inverse_depth: Float[np.ndarray, "rows cols"], cut: Cut) -> Mesh:
    """A mesh of inverse depth (1/metre) with the view's mask and the confidence of its depth."""
    mask = mask_of_vertices(view.mask, inverse_depth.shape)
    return build_mesh(inverse_depth, cut, mask, depth.confidence)


def panorama_surfaces(pairs: Iterator[PairSurfaces]) -> Iterator[PanoramaSurface]:
    """One surface of every panorama, in order, as soon as all its pairs (:func:`tour_surfaces`) are there.

    Both pairs of one inside a chain have the same, but for a pair at one place, which has next to nothing: the one of
    more vertices is taken.
    """
    every = chain.from_iterable(pair.surfaces for pair in pairs)
    for _, found in groupby(every, key=lambda surface: surface.index):
        yield max(found, key=lambda surface: surface.depth.inverse_depth.size)
