"""The methods that know no geometry: a cross-fade, and a fade along optical flow.

Both turn the two panoramas into the orientation of the frame first, as everything else would be compared with a
rotation that costs nothing to undo.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.evaluation.synthesizers import Picture
from omnisyn_cli.geometry.border import add_border
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.segments import Stopwatch
from omnisyn_cli.synthesis import turned_panorama
from omnisyn_cli.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["CrossFade", "FlowFade", "optical_flow"]

LEAST_HEIGHT = 32
"""Rows of the smallest pictures that optical flow is looked for in."""


class CrossFade:
    """Both panoramas, turned, averaged by time; a :class:`~omnisyn_cli.evaluation.synthesizers.Synthesizer`."""

    def __init__(self, views: tuple[View, View], threads: int | None = None) -> None:
        self._views, self._threads = views, threads

    @property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate] | None:
        """None: nothing is known about distances."""
        return None

    def pictures(self, path: Sequence[Waypoint], size: tuple[int, int], clock: Stopwatch) -> Iterator[Picture]:
        """See :class:`~omnisyn_cli.evaluation.synthesizers.Synthesizer`."""
        for waypoint in path:
            with clock("render"):
                first, second = turned_views(self._views, waypoint.pose, size, self._threads)
            with clock("fuse"):
                image = np.float32(1 - waypoint.t) * first + np.float32(waypoint.t) * second
            yield Picture(image)


class FlowFade:
    """Both panoramas, turned, moved along the optical flow between them and averaged by time.

    The flow of the second picture towards the first, times t, says where a pixel of the frame comes from in the first;
    the flow of the first towards the second, times 1 − t, where it comes from in the second. It is found again only
    where the orientation changes.
    """

    def __init__(self, views: tuple[View, View], threads: int | None = None) -> None:
        self._views, self._threads = views, threads
        self._rotation: np.ndarray | None = None
        self._turned: tuple[np.ndarray, np.ndarray] = (np.empty(0), np.empty(0))
        self._flows: tuple[np.ndarray, np.ndarray] = (np.empty(0), np.empty(0))

    @property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate] | None:
        """None: nothing is known about distances."""
        return None

    def pictures(self, path: Sequence[Waypoint], size: tuple[int, int], clock: Stopwatch) -> Iterator[Picture]:
        """See :class:`~omnisyn_cli.evaluation.synthesizers.Synthesizer`."""
        self._rotation = None
        for waypoint in path:
            self._prepare(waypoint.pose, size, clock)
            (first, second), (forth, back), t = self._turned, self._flows, waypoint.t
            with clock("render"):
                moved = _moved(first, np.float32(t) * back), _moved(second, np.float32(1 - t) * forth)
            with clock("fuse"):
                image = np.asarray((1 - t) * moved[0] + t * moved[1], np.float32)
            yield Picture(np.maximum(image, np.float32(0)))

    def _prepare(self, pose: Pose, size: tuple[int, int], clock: Stopwatch) -> None:
        if self._rotation is not None and np.array_equal(pose.rotation, self._rotation):
            return
        with clock("render"):
            self._turned = turned_views(self._views, pose, size, self._threads)
        with clock("flow"):
            self._flows = optical_flow(*self._turned), optical_flow(*self._turned[::-1])
        self._rotation = pose.rotation


def turned_views(
    views: tuple[View, View], pose: Pose, size: tuple[int, int], threads: int | None
) -> tuple[Float32[np.ndarray, "height width 3"], Float32[np.ndarray, "height width 3"]]:
    """Both panoramas as cameras held like ``pose`` would have taken them at the places of the panoramas."""
    first, second = (
        turned_panorama(view.image, Pose(pose.rotation.T @ view.pose.rotation, np.zeros(3)), size, threads)
        for view in views
    )
    return first, second


def optical_flow(
    first: Float[np.ndarray, "height width 3"], second: Float[np.ndarray, "height width 3"]
) -> Float32[np.ndarray, "height width 2"]:
    """Rows and columns by which every pixel of an equirectangular picture moves to where it is in another.

    The pictures are continued over the seam and the poles before flow is looked for, so that neither is a border.
    Pictures of fewer than 32 rows are too small for it: their flow is 0.

    Source: Kroeger et al., Fast optical flow using dense inverse search, 2016, as in OpenCV.
    """
    height, width = first.shape[:2]
    if height < LEAST_HEIGHT:
        return np.zeros((height, width, 2), np.float32)
    border = height // 4
    grey = [add_border(cv2.cvtColor(_bytes(image), cv2.COLOR_RGB2GRAY), border) for image in (first, second)]
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = np.asarray(search.calc(grey[0], grey[1], np.zeros((*grey[0].shape, 2), np.float32)), np.float32)
    inside: np.ndarray = flow[border : border + height, border : border + width, ::-1]
    return np.ascontiguousarray(inside)


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.asarray(np.rint(np.clip(image, 0, 1) * 255), np.uint8)


def _moved(image: np.ndarray, flow: np.ndarray) -> Float32[np.ndarray, "height width 3"]:
    """The picture read (bicubic, to 1/32 of a pixel) at every pixel plus ``flow``, as far as it is continued."""
    height, width = image.shape[:2]
    border = height // 4
    rows = np.arange(border, border + height, dtype=np.float32)[:, None] + np.clip(flow[..., 0], -border, border)
    columns = np.arange(border, border + width, dtype=np.float32)[None, :] + np.clip(flow[..., 1], -border, border)
    whole = add_border(image.astype(np.float32), border)
    return np.asarray(cv2.remap(whole, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.float32)
