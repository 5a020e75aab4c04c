"""What the fusion network sees: two renderings at its own size, and what the geometric fusion makes of them.

Planes, in this order (``PLANES`` of them, float32):

* ``FIRST``, ``SECOND``: colours of both renderings, 0 where they show nothing (3 each),
* ``FUSED``: the geometric fusion, holes filled (3),
* ``WORTH``: of both colours (2),
* ``ROOT``: square root of inverse depth × baseline of both, at most ``GREATEST_ROOT`` (2),
* ``LOG_RATIO``: of the geometric weights, over ``GREATEST_LOG``, in [−1, 1]; positive where the first counts more,
* ``GAP``: difference of inverse depth over what counts as a disagreement, over ``GREATEST_GAP``, in [−1, 1],
* ``SEEN``: 1 where the first, and where the second, shows anything (2),
* ``RELEVANCE``: whether it matters which one is shown, from 0 to 1: they differ in colour, and near by in distance; 1
  in holes,
* ``TIME``: 2t − 1,
* ``LATITUDE``: 1 at the top of the picture, −1 at its bottom.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.geometric import kernel_views
from omnisyn_cli.fusion.kernels import blend_rows
from omnisyn_cli.fusion.network_kernels import compare_rows, reduce_rows
from omnisyn_cli.geometry.border import filter_across_seam
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.threads import run_bands
from omnisyn_cli.types import UNSEEN, Rendering

__all__ = [
    "FIRST",
    "FUSED",
    "GAP",
    "GREATEST_GAP",
    "GREATEST_LOG",
    "GREATEST_ROOT",
    "LATITUDE",
    "LOG_RATIO",
    "PLANES",
    "REACH",
    "RELEVANCE",
    "ROOT",
    "SECOND",
    "SEEN",
    "SOFTNESS",
    "TIME",
    "WORTH",
    "FusionPlanes",
    "PlaneMaker",
    "doubt_of",
]

FIRST, SECOND, FUSED, WORTH, ROOT, LOG_RATIO, GAP = 0, 3, 6, 9, 11, 13, 14
SEEN, RELEVANCE, TIME, LATITUDE, PLANES = 15, 17, 18, 19, 20

GREATEST_ROOT, GREATEST_LOG, GREATEST_GAP = 2.0, 8.0, 4.0

REACH, SOFTNESS = 9, 5
"""Pixels across within which a disagreement is near, and over which doubt about the weights fades."""


@dataclass(frozen=True)
class FusionPlanes:
    """The planes, ``(PLANES, height, width)``, and what is needed to carry answers to larger frames.

    Attributes:
        planes: see the module's docstring.
        log_ratio: ``(height, width)`` of the geometric weights.
        both: 1 where both views see, else 0.
        holes: 1 where neither view does, else 0.
        doubt: how much the network's shift of the weights counts, from 0 to 1.
    """

    planes: Float32[np.ndarray, "planes height width"]
    log_ratio: Float32[np.ndarray, "height width"]
    both: Float32[np.ndarray, "height width"]
    holes: Float32[np.ndarray, "height width"]
    doubt: Float32[np.ndarray, "height width"]

    @property
    def is_settled(self) -> bool:
        """Whether there is nothing to decide: no hole, and nothing that differs between the views."""
        return not self.planes[RELEVANCE].any()


class PlaneMaker:
    """Makes planes of one size from renderings of any larger one. Not shared between threads.

    Args:
        size: height and width of the planes.
        disagreement: relative difference of inverse depth at which the farther surface has lost most of its weight.
        threads: at most this many; None is one per core.
    """

    def __init__(self, size: tuple[int, int], disagreement: float, threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._disagreement = np.float32(disagreement)
        self._tables = tuple(table.astype(np.float32) for table in direction_tables(*size))
        self._filler = HoleFiller(size, threads)
        self._colours = [np.zeros((*size, 4), np.float32) for _ in range(2)]
        self._rhos = [np.zeros(size, np.float32) for _ in range(2)]
        self._image, self._weight = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
        self._latitude = np.broadcast_to(self._tables[1][:, None], size)

    def __call__(self, first: Rendering, second: Rendering, t: float, hidden: float) -> FusionPlanes:
        """Planes of two renderings, at least as high as the planes, at a share ``t`` of the way.

        Args:
            first: of the first view.
            second: of the second view.
            t: share of the way.
            hidden: the least share of its weight that a hidden surface keeps.
        """
        for view, colour, rho in zip((first, second), self._colours, self._rhos, strict=True):
            self._run(reduce_rows, view.colour, view.inverse_depth, colour, rho)
        small = [
            Rendering(rho, colour, view.target_from_source)
            for view, rho, colour in zip((first, second), self._rhos, self._colours, strict=True)
        ]
        views = kernel_views(*small)
        rule = (np.float32(t), self._disagreement, np.float32(hidden), *self._tables)
        self._run(blend_rows, *views, *rule, self._image, self._weight)
        planes = np.empty((PLANES, *self.size), np.float32)
        log_ratio = np.empty(self.size, np.float32)
        self._run(compare_rows, *views, *rule, log_ratio, planes[GAP], planes[RELEVANCE])
        self._filler(self._image, self._weight)
        baseline = np.linalg.norm(first.target_from_source.position - second.target_from_source.position)
        return self._assembled(planes, log_ratio, t, float(baseline))

    def _assembled(self, planes: np.ndarray, log_ratio: np.ndarray, t: float, baseline: float) -> FusionPlanes:
        for view, (colour, rho) in enumerate(zip(self._colours, self._rhos, strict=True)):
            planes[(FIRST, SECOND)[view] :][:3] = colour[..., :3].transpose(2, 0, 1)
            planes[WORTH + view] = colour[..., 3]
            planes[ROOT + view] = np.sqrt(np.clip(rho * baseline, 0.0, GREATEST_ROOT**2))
            planes[SEEN + view] = colour[..., 3] > UNSEEN
        planes[FUSED : FUSED + 3] = self._image.transpose(2, 0, 1)
        doubt = doubt_of(planes[GAP])
        planes[LOG_RATIO] = np.clip(log_ratio / GREATEST_LOG, -1.0, 1.0)
        planes[GAP] = np.clip(planes[GAP] / GREATEST_GAP, -1.0, 1.0)
        planes[TIME] = 2.0 * t - 1.0
        planes[LATITUDE] = self._latitude
        both = planes[SEEN] * planes[SEEN + 1]
        holes = (1.0 - planes[SEEN]) * (1.0 - planes[SEEN + 1])
        planes[RELEVANCE] *= np.where(both > 0.0, doubt, np.float32(1.0))
        return FusionPlanes(planes, log_ratio, both, holes, doubt)

    def _run(self, kernel: Callable[..., None], *arguments: Any) -> None:
        run_bands(lambda begin, end: kernel(*arguments, begin, end), self.size[0], self.threads)


def doubt_of(gap: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Smooth, from 0 to 1: 1 where the views disagree about the distance, and around there; wraps at the seam.

    Where they agree, the one that was nearer shows it sharper, and a mixture would only blur it.

    Args:
        gap: difference of inverse depth, in units of what counts as a disagreement.
    """

    def spread(wide: np.ndarray) -> np.ndarray:
        around = cv2.dilate(wide, np.ones((REACH, REACH), np.uint8))
        return cv2.blur(around, (SOFTNESS, SOFTNESS), borderType=cv2.BORDER_REPLICATE)

    soft = filter_across_seam(spread, -np.expm1(-gap * gap), REACH // 2 + SOFTNESS // 2)
    return np.ascontiguousarray(soft, np.float32)
