"""Panoramas with their masks and depth, read from files when they are needed and held as small as they can be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from weakref import ref

import numpy as np
from jaxtyping import Float

from omnisyn_cli.io import Panorama, PosedPanorama, read_inverse_depth
from omnisyn_cli.io.images import INTEGER_PEAKS
from omnisyn_cli.io.masks import usable_part
from omnisyn_cli.planning import InterpolationPlan
from omnisyn_cli.segments import Stopwatch
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["KeptPanorama", "Loader", "PanoramaReader"]

PanoramaReader = Callable[..., Panorama]
"""Called as :func:`omnisyn_cli.io.read_panorama` is: with a path, ``allow_aspect`` and ``max_pixels``."""


class KeptPanorama:
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

    def forget_numbers(self) -> None:
        """Hold samples only, if they say everything."""
        if self.samples is not None:
            self._image = None


class Loader:
    """Panoramas from their files when they are needed; the last two are kept."""

    def __init__(self, plan: InterpolationPlan, clock: Stopwatch, read: PanoramaReader) -> None:
        self._plan, self._clock, self._read = plan, clock, read
        self.panorama = lru_cache(maxsize=2)(self._read_panorama)
        self._companions = lru_cache(maxsize=2)(self._read_companions)

    def views(self) -> Sequence[View]:
        """All views, read on demand."""
        return _LazySequence(len(self._plan.entries), self._view)

    def forget_numbers(self, index: int) -> None:
        """What a surface has been made of is not needed as numbers any more."""
        self.panorama(index).forget_numbers()

    def _read_panorama(self, index: int) -> KeptPanorama:
        job = self._plan.job
        return KeptPanorama(self._read(job.images[index], allow_aspect=job.allow_aspect, max_pixels=job.max_pixels))

    def _view(self, index: int) -> View:
        with self._clock("decode"):
            panorama, (mask, known_depth) = self.panorama(index), self._companions(index)
            return View(panorama.image(), self._plan.entries[index].pose, mask, known_depth, samples=panorama.samples)

    def _read_companions(self, index: int) -> tuple[np.ndarray | None, DepthEstimate | None]:
        """What of a panorama may be used, and its depth if that is known."""
        job, entry, panorama = self._plan.job, self._plan.entries[index], self.panorama(index)
        mask = usable_part(
            panorama.mask, panorama.size, (entry.mask, *job.masks[index : index + 1]), job.nadir,
            allow_aspect=job.allow_aspect, max_pixels=job.max_pixels,
        )  # fmt: skip
        return mask, self._known_depth(entry)

    def _known_depth(self, entry: PosedPanorama) -> DepthEstimate | None:
        if self._plan.depth != "file" or entry.depth is None:
            return None
        inverse_depth = read_inverse_depth(entry.depth, max_pixels=self._plan.job.max_pixels)
        return DepthEstimate(inverse_depth, np.ones_like(inverse_depth))


class _LazySequence(Sequence[View]):
    def __init__(self, count: int, item: Callable[[int], View]) -> None:
        self._count, self._item = count, item

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> View:  # type: ignore[override]
        return self._item(index)
