"""The methods that know no geometry: a cross-fade, and a fade along optical flow.

Both turn the panoramas into the orientation of the frame first: a rotation costs nothing to undo, so none may count.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import Frame, FrameAllocator, turned_panorama
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import View

MIN_FLOW_ROWS = 32  # rows of the smallest pictures that optical flow is looked for in


class PairWithoutGeometry:
    """Of a :class:`~omnisyn_cli.synthesis.methods.Pair`: there is no depth from any waypoint."""

    def inverse_depth(self, waypoint: Waypoint) -> None:
        """None."""

    def renderings(self, waypoint: Waypoint) -> None:
        """None."""


class _CrossFadePair(PairWithoutGeometry):
    """A :class:`~omnisyn_cli.synthesis.methods.Pair` about whose distances nothing is known."""

    depths = None

    def __init__(self, views: tuple[View, View], options: SynthesisOptions, clock: Stopwatch) -> None:
        self._views, self._options, self._clock = views, options, clock

    def frame(self, waypoint: Waypoint, out: FrameAllocator | None = None) -> Frame:
        """Their average, as numbers."""
        with self._clock("render"):
            first, second = self._turned_to(waypoint.pose)
        with self._clock("fuse"):
            return Frame(np.float32(1 - waypoint.t) * first + np.float32(waypoint.t) * second, waypoint, None)

    def _turned_to(self, pose: Pose) -> tuple[Float32[np.ndarray, "height width 3"], ...]:
        """Both panoramas as cameras held like ``pose`` would have taken them at the places of the panoramas."""
        turns = (Pose(pose.rotation.T @ view.pose.rotation, np.zeros(3)) for view in self._views)
        return tuple(
            turned_panorama(view.image, turn, self._options.size, self._options.threads)
            for view, turn in zip(self._views, turns, strict=True)
        )


class _FlowPair(_CrossFadePair):
    _rotation: np.ndarray | None = None
    _turned: tuple[np.ndarray, ...] = ()
    _flows: tuple[np.ndarray, ...] = ()

    def frame(self, waypoint: Waypoint, out: FrameAllocator | None = None) -> Frame:
        """The average of both, moved, as numbers."""
        if self._rotation is None or not np.array_equal(waypoint.pose.rotation, self._rotation):
            with self._clock("render"):
                self._turned = self._turned_to(waypoint.pose)
            with self._clock("flow"):
                self._flows = optical_flow(*self._turned), optical_flow(*self._turned[::-1])
            self._rotation = waypoint.pose.rotation
        (first, second), (forth, back), t = self._turned, self._flows, waypoint.t
        with self._clock("render"):
            pictures = moved(first, np.float32(t) * back), moved(second, np.float32(1 - t) * forth)
        with self._clock("fuse"):
            image = np.asarray((1 - t) * pictures[0] + t * pictures[1], np.float32)
            return Frame(np.maximum(image, np.float32(0)), waypoint, None)


class CrossFadeMethod:
    """A :class:`~omnisyn_cli.synthesis.methods.Method`: both panoramas, turned, averaged by time."""

    pair_type: type[_CrossFadePair] = _CrossFadePair

    def __init__(self, options: SynthesisOptions, clock: Stopwatch | None = None) -> None:
        self.options, self.clock = options, clock or Stopwatch()

    def prepare(self, index: int, views: Sequence[View]) -> _CrossFadePair:
        """Both as they are."""
        return self.pair_type((views[index], views[index + 1]), self.options, self.clock)


class FlowMethod(CrossFadeMethod):
    """Both panoramas, turned, moved along the optical flow between them and averaged by time.

    Flow from second to first times t says where a pixel comes from in the first, and the other way round times 1 − t in
    the second. It is found again only where the orientation changes.
    """

    pair_type = _FlowPair


def optical_flow(
    first: Float[np.ndarray, "height width 3"], second: Float[np.ndarray, "height width 3"]
) -> Float32[np.ndarray, "height width 2"]:
    """Rows and columns by which every pixel of an equirectangular picture moves to where it is in another.

    Pictures are continued over the seam and the poles first; below 32 rows the flow is 0. Source: Kroeger et al., Fast
    optical flow using dense inverse search, 2016, as in OpenCV.
    """
    height, width = first.shape[:2]
    if height < MIN_FLOW_ROWS:
        return np.zeros((height, width, 2), np.float32)
    border = height // 4
    samples = [np.asarray(np.rint(np.clip(image, 0, 1) * 255), np.uint8) for image in (first, second)]
    grey = [add_border(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), border) for image in samples]
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = search.calc(grey[0], grey[1], np.zeros((*grey[0].shape, 2), np.float32))
    return np.ascontiguousarray(flow[border : border + height, border : border + width, ::-1], np.float32)


def moved(image: np.ndarray, flow: np.ndarray) -> Float32[np.ndarray, "height width 3"]:
    """The picture read (bicubic, to 1/32 of a pixel) at every pixel plus ``flow``, as far as it is continued."""
    height, width = image.shape[:2]
    border = height // 4
    rows = np.arange(border, border + height, dtype=np.float32)[:, None] + np.clip(flow[..., 0], -border, border)
    columns = np.arange(border, border + width, dtype=np.float32)[None, :] + np.clip(flow[..., 1], -border, border)
    whole = add_border(image.astype(np.float32), border)
    return np.asarray(cv2.remap(whole, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.float32)
