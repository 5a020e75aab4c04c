"""Panoramas with their masks and depth, read from files when they are needed and held as small as they can be."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, lru_cache, partial
from weakref import ref

import numpy as np
from jaxtyping import Float

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.interpolation.job import reading_of
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.io import MAX_PIXELS, Panorama, read_inverse_depth
from omnisyn_cli.io.images import INTEGER_PEAKS, usable_part
from omnisyn_cli.poses.file import PosedPanorama
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

    Attributes:
        left_out: share of the sphere that was found to move with the camera, by the index of the panorama.
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
        self.left_out: dict[int, float] = {}

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
    return CachedPanorama(
        read(job.images[index], allow_aspect=job.allow_aspect, max_pixels=job.max_pixels, reading=reading)
    )


def _read_companions(
    plan: TourPlan, panorama_of: Callable[[int], CachedPanorama], index: int
) -> tuple[np.ndarray | None, DepthEstimate | None]:
    """What of a panorama may be used, and its depth if that is known."""
    job, entry, panorama = plan.job, plan.entries[index], panorama_of(index)
    mask = usable_part(
        panorama.mask, panorama.size, (entry.mask, *job.masks[index : index + 1]), job.nadir or 0.0,
        allow_aspect=job.allow_aspect, max_pixels=job.max_pixels,
        reading=replace(reading_of(job), view_transform=False, size=plan.source_sizes[index]),
    )  # fmt: skip
    return mask, known_depth(entry, job.max_pixels) if plan.config.depth.strategy.reads_files else None


def _find_camera_fixed(
    plan: TourPlan,
    panorama_of: Callable[[int], CachedPanorama],
    companions_of: Callable[[int], tuple[np.ndarray | None, DepthEstimate | None]],
    still: Callable[[], np.ndarray | None],
    first: int,
    second: int,
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """What moves with the camera in two neighbours, ``still`` that in all panoramas."""
    from omnisyn_cli.synthesis.camera_fixed import find_camera_fixed  # OpenCV is needed to make something only

    a, b = (View(panorama_of(k).image(), plan.entries[k].pose, companions_of(k)[0]) for k in (first, second))
    return find_camera_fixed(a, b, still())


def _still_region(plan: TourPlan, read: PanoramaReader) -> np.ndarray | None:
    """What moves with the camera in all panoramas of a tour, in a map around the nadir; None of two, or where none."""
    from omnisyn_cli.synthesis.still_outlines import PICTURE_SIZE, find_still_region, spread_out

    small = replace(plan, source_sizes=(PICTURE_SIZE,) * len(plan.entries))
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
