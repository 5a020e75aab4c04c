"""What a frame shows that is not there: flying pixels, and shards.

Flying pixels are far from the truth, and from all that either photograph shows near. The true depth of both, carried to
the frame, says for every cell of 2.8° between which distances things lie in and around it. Between the places of these
on its epipolar line, and 1.4° beside it, a photograph may rightly show a pixel's direction. In cells that no depth
reaches the line begins at infinity and ends at the nearest scored distance.

Shards are edges of a frame that neither photograph has anywhere near, as torn surfaces make them. An edge is the
colours on its two sides and its direction: nine numbers, each in its own scale. One that is farther than 1 from every
edge of both photographs is a shard. The wide scale of directions allows for parallax, so no depth or true frame is
needed.

Constants are those that tell torn frames from true ones best on fifteen wide walks through generated scenes.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.compute.jit import kernel
from omnisyn_cli.evaluation.metrics.depth import SCORED_DEPTH
from omnisyn_cli.evaluation.metrics.image import Picture, check_same_size
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import add_border, filter_across_seam, sample_nearest
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions, pixel_scale, row_weights
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.types import View

COLOUR_TOLERANCE = 30 / 255  # largest difference of a channel between colours that count as equal: 30 of 255 levels
CELL_GRID_SIZE = (64, 128)  # rows and columns of cells of 2.8°
# Rows and columns of the true depth that gives the range of a cell: four samples each, 36 with its neighbours.
DEPTH_GRID_SIZE = (128, 256)
EPIPOLAR_MARGIN = np.radians(1.4)  # radians beside the epipolar line that are searched: half a cell


class _Pixels(NamedTuple):
    """Pixels that are off the truth: unit vectors, RGB, and the ends of their lines in 1/metre."""

    directions: Float[np.ndarray, "count 3"]
    colours: Float[np.ndarray, "count 3"]
    farthest: Float[np.ndarray, " count"]
    nearest: Float[np.ndarray, " count"]


def flying_share(image: Picture, truth: Picture, pose: Pose, views: tuple[View, View]) -> float:
    """Share of the sphere that flies; RGB in [0, 1], ``truth`` seen at ``pose``; ValueError: other sizes, no depth."""
    weights = np.broadcast_to(row_weights(len(truth))[:, None], truth.shape[:2])
    return float(weights[flying_pixels(image, truth, pose, views)].sum() / weights.sum())


def flying_pixels(
    image: Picture, truth: Picture, pose: Pose, views: tuple[View, View]
) -> Bool[np.ndarray, "height width"]:
    """Which pixels fly; arguments as above."""
    check_same_size(image, truth)
    flying: np.ndarray = np.abs(image - truth).max(axis=-1) > COLOUR_TOLERANCE
    directions = pixel_directions(*flying.shape)[flying]
    ends = (sample_nearest(end, directions) for end in _true_range(pose, views))
    pixels = _Pixels(directions, image[flying].astype(np.float32), *ends)
    for view in views:
        is_shown = _is_shown(pixels, view, pose)
        flying[flying] = ~is_shown
        pixels = _Pixels(*(values[~is_shown] for values in pixels))
    return flying


def _true_range(pose: Pose, views: tuple[View, View]) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest true inverse depth around every cell of a frame, 1/metre."""
    least, greatest = np.full(CELL_GRID_SIZE, np.inf), np.full(CELL_GRID_SIZE, -1.0)
    directions = pixel_directions(*DEPTH_GRID_SIZE)
    for view in views:
        if view.known_depth is None:
            raise ValueError("expected views with known depth, got one without; leave flying pixels out")
        is_known = sample_nearest(view.known_depth.confidence, directions) > 0
        inverse_depth = sample_nearest(view.known_depth.inverse_depth, directions)[is_known].astype(np.float64)
        rays = sweep_directions(directions[is_known], inverse_depth, pose.inverse() @ view.pose)
        cells = _pixels_of(rays, CELL_GRID_SIZE)  # of the frame, that the true depth of the view falls into
        inverse_depth /= np.maximum(np.linalg.norm(rays, axis=-1), 1e-9)
        np.minimum.at(least, cells, inverse_depth)
        np.maximum.at(greatest, cells, inverse_depth)
    around = np.ones((3, 3), np.uint8)
    least, greatest = (
        filter_across_seam(partial(extreme, kernel=around), values, 1)
        for extreme, values in ((cv2.erode, least), (cv2.dilate, greatest))
    )
    is_known = greatest >= 0.0
    return np.where(is_known, least, 0.0), np.where(is_known, greatest, 1.0 / SCORED_DEPTH[0])


def _is_shown(pixels: _Pixels, view: View, pose: Pose) -> Bool[np.ndarray, " count"]:
    """Whether a photograph has the colour of each pixel near its line: looked for from the far end to the near one."""
    view_from_frame = view.pose.inverse() @ pose
    step = 2.0 * EPIPOLAR_MARGIN / max(float(np.linalg.norm(view_from_frame.position)), 1e-9)
    size = (view.image.shape[0], view.image.shape[1])
    reach = max(1, round(EPIPOLAR_MARGIN * pixel_scale(size)[0]))
    wide, is_shown = add_border(view.image.astype(np.float32), reach), np.zeros(len(pixels.colours), bool)
    left, inverse_depth = np.arange(len(is_shown)), pixels.farthest
    while left.size:
        rays = sweep_directions(pixels.directions[left], inverse_depth, view_from_frame)
        is_shown[left] = is_around(wide, reach, *_pixels_of(rays, size), pixels.colours[left])
        is_open = ~is_shown[left] & (inverse_depth < pixels.nearest[left])
        left, inverse_depth = left[is_open], inverse_depth[is_open]
        inverse_depth = np.minimum(inverse_depth + step, pixels.nearest[left])
    return is_shown


@kernel()
def is_around(wide: np.ndarray, reach: int, rows: np.ndarray, cols: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Whether a picture has each colour within ``reach`` rows and columns of each pixel, ``(count,)``.

    ``wide``: the picture with a border of ``reach``, ``(rows, cols, 3)`` float32; ``rows``, ``cols`` count without it.
    """
    is_found = np.zeros(len(rows), np.bool_)
    side = 2 * reach + 1
    for k in range(len(rows)):
        for place in range(side * side):
            shown = wide[rows[k] + place // side, cols[k] + place % side]
            if (
                abs(shown[0] - colours[k, 0]) <= COLOUR_TOLERANCE
                and abs(shown[1] - colours[k, 1]) <= COLOUR_TOLERANCE
                and abs(shown[2] - colours[k, 2]) <= COLOUR_TOLERANCE
            ):
                is_found[k] = True
                break
    return is_found


def _pixels_of(rays: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    row, col = direction_to_pixel(rays, size)
    return np.clip(np.rint(row).astype(np.int64), 0, size[0] - 1), np.rint(col).astype(np.int64) % size[1]


MAX_ROWS = 512  # rows at which edges are found: finer ones depend on the sharpness of a picture
SMOOTHING_SIGMA = 1.0  # pixels of the Gaussian filter before edges are found
SIDE_DISTANCE = 2.5  # pixels from an edge to where the colours of its sides are read: beyond the smoothed step
# Least difference of both sides in some channel. Fainter edges of photographs count: frames may show them sharper.
MIN_CONTRAST, MIN_PHOTOGRAPH_CONTRAST = 0.3, 0.12
# Distances that count as 1: of all six values of RGB in [0, 1], and of unit vectors (60°).
COLOUR_SCALE, DIRECTION_SCALE = 0.15, 1.0
# Most columns for one row: within 14° of a pole, steps along a row get shorter than those along a column.
MAX_STRETCH = 4.0
BORDER = int(np.ceil(MAX_STRETCH * SIDE_DISTANCE)) + 1  # pixels beyond the picture that its edges are read from
# FLANN_INDEX_KDTREE_SINGLE, which is exact.
KD_TREE: dict[str, bool | int | float | str] = {"algorithm": 4, "leaf_max_size": 16}
EXACT_SEARCH: dict[str, bool | int | float | str] = {"checks": -1, "eps": 0.0}  # no leaf is left out


class Edges(NamedTuple):
    """Pixels on edges: both colours and the direction in units of the scales, and the area up to a factor."""

    points: Float[np.ndarray, "count 9"]
    weights: Float[np.ndarray, " count"]


class PhotographEdges:
    """All edges of some photographs, to find those nearest to the edges of frames."""

    def __init__(self, views: Sequence[View], size: tuple[int, int]) -> None:
        """``size`` is that of the frames; edges are found at no more than :data:`MAX_ROWS` rows."""
        self.size = size if size[0] <= MAX_ROWS else (MAX_ROWS, 2 * MAX_ROWS)
        found = [find_edges(view.image, view.pose, self.size, MIN_PHOTOGRAPH_CONTRAST) for view in views]
        self._points = np.concatenate([edges.points for edges in found])
        self._tree = cv2.flann.Index(self._points, KD_TREE) if len(self._points) else None

    def lack(self, points: Float[np.ndarray, "count 9"]) -> Bool[np.ndarray, " count"]:
        """Which edges are farther than 1 from every edge of the photographs."""
        if self._tree is None or not len(points):
            return np.ones(len(points), bool)
        _, squared = self._tree.knnSearch(points, 1, params=EXACT_SEARCH)
        return np.asarray(squared[:, 0] > 1.0)


def shard_share(image: Picture, pose: Pose, photographs: PhotographEdges) -> float:
    """Share of a frame's edges that are shards, by area; RGB in [0, 1], ``pose`` world-from-camera; 0 without edges."""
    edges = find_edges(image, pose, photographs.size, MIN_CONTRAST)
    is_shard = photographs.lack(edges.points)
    return float(edges.weights[is_shard].sum() / max(edges.weights.sum(), 1e-9))


def find_edges(image: Picture, pose: Pose, size: tuple[int, int], min_contrast: float) -> Edges:
    """The edges of a panorama: where its brightness changes most along its gradient, and by enough of a channel."""
    how = cv2.INTER_AREA if len(image) > size[0] else cv2.INTER_LINEAR
    resized = cv2.resize(np.asarray(image, np.float32), size[::-1], interpolation=how)
    smooth = cv2.GaussianBlur(add_border(np.asarray(resized), BORDER), (0, 0), SMOOTHING_SIGMA)
    stretch = 1.0 / np.maximum(row_weights(size[0]), 1.0 / MAX_STRETCH).astype(np.float32)[:, None]
    grey = smooth.mean(axis=-1)
    right = cv2.Sobel(grey, cv2.CV_32F, 1, 0) * np.pad(stretch, ((BORDER, BORDER), (0, 0)), mode="symmetric")
    down = cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    slope = np.hypot(right, down)
    inside = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    steepness = np.maximum(slope[inside], 1e-9)
    cols, rows = stretch * right[inside] / steepness, down[inside] / steepness
    darker, lighter = (_moved(smooth, side * cols, side * rows) for side in (-SIDE_DISTANCE, SIDE_DISTANCE))
    is_edge = np.abs(lighter - darker).max(axis=-1) > min_contrast
    for side in (-1.0, 1.0):
        is_edge &= slope[inside] >= _moved(slope, side * cols, side * rows)
    directions = pixel_directions(*size)[is_edge] @ pose.rotation.T
    colours = np.concatenate([darker[is_edge], lighter[is_edge]], axis=-1)
    points = np.concatenate([colours / COLOUR_SCALE, directions / DIRECTION_SCALE], axis=-1)
    weights = np.broadcast_to(row_weights(size[0])[:, None], size)[is_edge]
    return Edges(points.astype(np.float32), weights)


def _moved(wide: np.ndarray, cols: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A picture with a border, read that many columns and rows beside each pixel within the border."""
    row, col = np.mgrid[BORDER : BORDER + rows.shape[0], BORDER : BORDER + rows.shape[1]].astype(np.float32)
    return np.asarray(cv2.remap(wide, col + cols, row + rows, cv2.INTER_LINEAR))
