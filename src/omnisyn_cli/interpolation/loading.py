"""Panoramas with their masks and depth, read from files when they are needed; and the surfaces that are made of them.

:func:`tour_surfaces` goes through the pairs of neighbours as ``interpolate`` does, with the same poses, masks, depth
and preset; :func:`panorama_surfaces` is for what wants the surface of each panorama once.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from itertools import chain, groupby
from weakref import ref

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.interpolation.blurring import blurred_panorama
from omnisyn_cli.interpolation.job import reading_of
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.summary import TourSummary, refuse_doubtful
from omnisyn_cli.io import MAX_PIXELS, Panorama, read_inverse_depth, read_panorama
from omnisyn_cli.io.images import INTEGER_PEAKS, usable_part
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.poses.file import PosedPanorama
from omnisyn_cli.poses.floor import wall_distance
from omnisyn_cli.render.mesh import Cut, Mesh, build_mesh, mask_of_vertices
from omnisyn_cli.synthesis import prepared_pair
from omnisyn_cli.synthesis.chain_depth import ChainDepth
from omnisyn_cli.synthesis.consistency import CrossCheck
from omnisyn_cli.synthesis.ground import continue_ground
from omnisyn_cli.types import DepthEstimate, View

PanoramaReader = Callable[..., Panorama]
"""Called as :func:`omnisyn_cli.io.read_panorama` is: with a path and its keywords."""


class CachedPanorama:
    """A panorama that can be held as the samples of its file; numbers are made of them again where they are needed."""

    def __init__(self, panorama: Panorama) -> None:
        self.original, self.mask, self.size = panorama.original, panorama.mask, panorama.image.shape[:2]
        self.samples = panorama.original if str(getattr(panorama.original, "dtype", "")) == "uint8" else None
        self._image: np.ndarray | None = panorama.image
        self._known = ref(panorama.image)

    def image(self) -> Float[np.ndarray, "height width 3"]:
        """RGB in [0, 1]."""
        image = self._known() if self._image is None else self._image
        if image is None:  # forgotten, which it is only where there are samples
            image = np.divide(np.asarray(self.samples), np.float32(INTEGER_PEAKS["uint8"]), dtype=np.float32)
            self._known = ref(image)
        return image

    def release_floats(self) -> None:
        """Hold samples only, if they say everything."""
        if self.samples is not None:
            self._image = None


class Loader(Sequence[View]):
    """All views, read from their files when they are needed.

    The last two are kept, as long as the loader is; three where depth is looked for in a tour, more at its crossings.
    """

    def __init__(self, plan: TourPlan, clock: Stopwatch, read: PanoramaReader) -> None:
        self._plan, self._clock = plan, clock
        # Methods of its own in here would keep the loader, and what it keeps, alive until somebody looks for cycles.
        kept = plan.views_at_once
        self.panorama = lru_cache(maxsize=kept)(partial(_read_panorama, plan, read))
        self._companions = lru_cache(maxsize=kept)(partial(_read_companions, plan, self.panorama))
        still = cache(partial(_still_region, plan, read))
        find = partial(_find_camera_fixed, plan, self.panorama, self._companions, still)
        self._camera_fixed = lru_cache(maxsize=kept)(find)
        self._neighbour = {view: pair for pair in reversed(plan.pairs) for view in pair}
        self.left_out: dict[int, float] = {}  # share of the sphere that moves with the camera, by index

    def __len__(self) -> int:
        return len(self._plan.entries)

    def __getitem__(self, index: int) -> View:  # type: ignore[override]
        with self._clock("decode"):
            panorama, (mask, known_depth) = self.panorama(index), self._companions(index)
        if self._plan.job.nadir is None:
            with self._clock("decode"):
                pair = self._neighbour[index]
                fixed = self._camera_fixed(*pair)[pair.index(index)]
            if fixed is not None:
                mask = ~fixed if mask is None else mask & ~fixed
                area = solid_angles(*fixed.shape)
                self.left_out[index] = float(area[fixed].sum() / area.sum())
        shows_masked = panorama.mask is None and not self._plan.job.nadir_fill
        pose = self._plan.entries[index].pose
        return View(panorama.image(), pose, mask, known_depth, image_uint8=panorama.samples, shows_masked=shows_masked)

    def release_floats(self, index: int) -> None:
        """What the surfaces of a pair have been made of is not needed as numbers any more."""
        for view in range(index, min(index + 2 + self._plan.looks_ahead, len(self))):
            self.panorama(view).release_floats()


def _read_panorama(plan: TourPlan, read: PanoramaReader, index: int) -> CachedPanorama:
    job, reading = plan.job, replace(reading_of(plan.job), size=plan.source_sizes[index])
    panorama = read(job.images[index], allow_aspect=job.allow_aspect, max_pixels=job.max_pixels, reading=reading)
    return CachedPanorama(blurred_panorama(job, index, panorama))


def _read_companions(
    plan: TourPlan, panorama_of: Callable[[int], CachedPanorama], index: int
) -> tuple[np.ndarray | None, DepthEstimate | None]:
    """What of a panorama may be used, and its depth if that is known."""
    job, entry, panorama = plan.job, plan.entries[index], panorama_of(index)
    mask = usable_part(
        panorama.mask, panorama.size, (entry.mask, *job.masks[index : index + 1]), job.nadir or 0.0,
        allow_aspect=job.allow_aspect, max_pixels=job.max_pixels,
        reading=replace(reading_of(job), size=plan.source_sizes[index]),
    )  # fmt: skip
    return mask, known_depth(entry, job.max_pixels) if plan.config.depth.strategy.reads_files else None


def _find_camera_fixed(
    plan: TourPlan, panorama_of: Callable[[int], CachedPanorama],
    companions_of: Callable[[int], tuple[np.ndarray | None, DepthEstimate | None]],
    still: Callable[[], np.ndarray | None], first: int, second: int,
) -> tuple[np.ndarray | None, np.ndarray | None]:  # fmt: skip
    """What moves with the camera in two neighbours, ``still`` that in all panoramas."""
    from omnisyn_cli.synthesis.camera_fixed import find_camera_fixed  # OpenCV is needed to make something only

    a, b = (View(panorama_of(k).image(), plan.entries[k].pose, companions_of(k)[0]) for k in (first, second))
    return find_camera_fixed(a, b, still())


def _still_region(plan: TourPlan, read: PanoramaReader) -> np.ndarray | None:
    """What moves with the camera in all panoramas of a tour, in a map around the nadir; None of two, or where none."""
    from omnisyn_cli.synthesis.still_outlines import PICTURE_SIZE, find_still_region, spread_out

    small = replace(plan, job=replace(plan.job, blur=()), source_sizes=(PICTURE_SIZE,) * len(plan.entries))
    panorama_of = lru_cache(maxsize=1)(partial(_read_panorama, small, read))
    return find_still_region(
        View(panorama_of(index).image(), plan.entries[index].pose, _read_companions(small, panorama_of, index)[0])
        for index in spread_out(len(plan.entries))
    )


def known_depth(entry: PosedPanorama, max_pixels: int = MAX_PIXELS) -> DepthEstimate | None:
    """What the depth file of a panorama says, if it has one. ImageError: it is damaged, or has more pixels."""
    if entry.depth is None:
        return None
    inverse_depth = read_inverse_depth(entry.depth, max_pixels=max_pixels)
    return DepthEstimate(inverse_depth, np.ones_like(inverse_depth))


@dataclass(frozen=True)
class PanoramaSurface:
    """A posed panorama and its surface."""

    index: int  # in the job
    view: View
    depth: DepthEstimate  # at a resolution of its own
    mesh: Mesh  # in the frame of the panorama, cut by the config's rule; masked vertices have no surface

    def texture(self) -> Float[np.ndarray, "height width 3"] | UInt8[np.ndarray, "height width 3"]:
        """The photograph, with masked pixels painted over from around them: samples of 8 bits, or RGB in [0, 1]."""
        return prepared_pair.usable_image(self.view, prepared_pair.SynthesisOptions(self.mesh.size))

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
    """The surfaces of two neighbours."""

    index: int  # of the pair in the plan: in a chain that of its first panorama
    surfaces: tuple[PanoramaSurface, PanoramaSurface]
    cross_check: CrossCheck  # how differently they are exposed, and how far what is made of them can be relied on


def tour_surfaces(
    plan: TourPlan, summary: TourSummary | None = None, clock: Stopwatch | None = None
) -> Iterator[PairSurfaces]:
    """The surfaces of every pair of the plan, one pair at a time, in order.

    The summary is given what there is to know about pairs and panoramas, the clock the seconds of each stage. Of the
    plan's config depth, cut and device matter. InputError: a picture, mask or depth file turns out to be damaged, a
    network cannot be used, or a pair is doubtful and the fallback is to give up.
    """
    clock, config, threads = clock or Stopwatch(), plan.config, plan.job.threads
    loader = Loader(plan, clock, read_panorama)
    estimator = make_estimator(config.depth, device=config.device, threads=threads)
    tour = ChainDepth(loader, estimator, clock, threads, plan.pairs)
    for index, (first, second) in enumerate(plan.pairs):
        with limited_threads(threads):
            views = loader[first], loader[second]
            size, cut = min(view.image.shape[:2] for view in views), Cut(config.cut, config.cut_metres)
            options = prepared_pair.SynthesisOptions(size, cut=cut, threads=threads)
            depths, check = prepared_pair.measure_pair(index, tour, options, clock)
            with clock("mesh"):
                pair = pair_surfaces(plan, index, views, depths, check)
        refuse_doubtful(plan, index, check.confidence)
        if summary is not None:
            summary.pairs[index] = check.confidence
            summary.left_out.update(loader.left_out)
            summary.walls[index] = wall_distance((views[0].pose, views[1].pose), depths)
        yield pair


def pair_surfaces(
    plan: TourPlan, index: int, views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate],
    check: CrossCheck,
) -> PairSurfaces:  # fmt: skip
    """The surfaces of a pair whose depth is known, cut as the plan's config says."""
    cut = Cut(plan.config.cut, plan.config.cut_metres)
    views, depths = continue_ground(views, depths)
    first, second = (
        PanoramaSurface(place, view, depth, mesh_of(view, depth, depth.inverse_depth, cut))
        for place, view, depth in zip(plan.pairs[index], views, depths, strict=True)
    )
    return PairSurfaces(index, (first, second), check)


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
