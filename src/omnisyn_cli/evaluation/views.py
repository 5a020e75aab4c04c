"""The pictures of a pair read into memory: two views, the true frames between, where and when they were taken."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.evaluation.datasets.sources import Pair, SceneFrame
from omnisyn_cli.evaluation.metrics.image import comparable_pixels
from omnisyn_cli.geometry.pose import Pose, distance_between, interpolate_pose
from omnisyn_cli.io import read_mask, read_panorama
from omnisyn_cli.io.images import check_mask_size
from omnisyn_cli.synthesis.camera_fixed import find_camera_fixed
from omnisyn_cli.synthesis.synthesize import turned_panorama
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View

HALF_WAY = "half way"  # name of the frame that is made where there are no true ones
MAX_HALF_WAY_ROWS = 512  # rows of that frame at most: what is measured without a true frame does not need more


@dataclass(frozen=True)
class Target:
    """Where methods make a frame between the two views."""

    name: str  # of the frame
    waypoint: Waypoint  # its pose, and the share of the way by distance
    distance: float  # metres to the nearer view


@dataclass(frozen=True)
class TrueFrame(Target):
    """What a camera saw between the two views."""

    image: Float[np.ndarray, "height width 3"]  # RGB in [0, 1], at the size of the comparison
    # pixels that may be compared, of a photograph; None of a rendering, of which all may
    usable: Bool[np.ndarray, "height width"] | None = None


@dataclass(frozen=True)
class LoadedPair:
    """A pair with everything that is known about it."""

    # both panoramas at their own resolution, with true depth as ``known_depth`` where there is any
    views: tuple[View, View]
    truths: tuple[TrueFrame, ...]  # of the frames between
    size: tuple[int, int]  # height and width at which frames are compared
    # the panorama before the first and the one after the second view, where the pair is part of a tour
    around: tuple[View | None, View | None] = (None, None)
    # what moves with the camera in a whole tour, see :mod:`omnisyn_cli.synthesis.still_outlines`, or None
    still: Bool[np.ndarray, "rows cols"] | None = None

    @property
    def are_photographs(self) -> bool:
        """Whether the true frames are photographs of a tour."""
        return any(truth.usable is not None for truth in self.truths)

    @property
    def targets(self) -> tuple[Target, ...]:
        """The true frames; half way on the straight line where there are none."""
        if self.truths:
            return self.truths
        first, second = (view.pose for view in self.views)
        distance = 0.5 * distance_between(first, second)
        return (Target(HALF_WAY, Waypoint(0, 0.5, interpolate_pose(first, second, 0.5)), distance),)


def at_size(
    image: Float[np.ndarray, "rows cols 3"], size: tuple[int, int], threads: int | None
) -> Float[np.ndarray, "height width 3"]:
    """A panorama resampled to a size; the same if it has that."""
    return image if image.shape[:2] == size else turned_panorama(image, Pose.identity(), size, threads)


def load_pair(
    pair: Pair, size: tuple[int, int] | None = None, threads: int | None = None, *,
    are_photographs: bool = False, still: Bool[np.ndarray, "rows cols"] | None = None,
) -> LoadedPair:  # fmt: skip
    """Read all pictures, masks and depth of a pair; frames are compared at ``size`` or that of the first true frame.

    Without true frames it is that of the first panorama, at most :data:`MAX_HALF_WAY_ROWS`; so it is with photographs,
    in which what moves with the camera is not compared. InputError: a missing or damaged file, a mask of another size.
    """
    views = (_view(pair.first), _view(pair.second))
    rows = min(views[0].image.shape[0], MAX_HALF_WAY_ROWS)
    if are_photographs:
        size = size or (rows, 2 * rows)
    truths = []
    for frame in pair.between:
        true_view, usable = _view(frame), None
        image = true_view.image
        size = size or (image.shape[0], image.shape[1])
        if are_photographs:
            fixed = find_camera_fixed(true_view, views[0], still)[0]
            usable = comparable_pixels(size, true_view.mask, None if fixed is None else ~fixed)
        d1, d2 = (distance_between(end.pose, frame.pose) for end in (pair.first, pair.second))
        t = d1 / (d1 + d2) if d1 + d2 > 0 else 0.5
        shown = np.clip(at_size(image, size, threads), 0, 1)
        truths.append(TrueFrame(frame.name, Waypoint(0, t, frame.pose), min(d1, d2), shown, usable))
    before, after = (None if frame is None else _view(frame) for frame in (pair.before, pair.after))
    return LoadedPair(views, tuple(truths), size or (rows, 2 * rows), (before, after), still)


def _view(frame: SceneFrame) -> View:
    panorama = read_panorama(frame.image)
    mask = panorama.mask
    if frame.mask is not None:
        given = read_mask(frame.mask)
        check_mask_size(frame.mask, given.shape, panorama.image.shape[:2])
        mask = given if mask is None else mask & given
    depth = None
    if frame.depth is not None:
        inverse_depth = frame.read_depth(frame.depth)
        known = inverse_depth > 0 if frame.has_holes else np.ones(inverse_depth.shape, bool)
        depth = DepthEstimate(inverse_depth, known.astype(np.float32))
    return View(panorama.image, frame.pose, mask, depth)
