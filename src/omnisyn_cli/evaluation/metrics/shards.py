"""Shards: edges of a frame that neither photograph has anywhere near, as torn surfaces make them.

An edge is the colours on its two sides and its direction from the camera. Two edges are as far apart as these nine
numbers, each in its own scale. An edge that is farther than 1 from every edge of both photographs is a shard. The wide
scale of directions allows for parallax, so no depth is needed. No true frame is needed either.

The constants are those that tell torn frames from true ones best on fifteen wide walks through generated scenes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.evaluation.metrics.image import Picture
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import pixel_directions, row_weights
from omnisyn_cli.types import View

MAX_ROWS = 512
"""Rows at which edges are found: finer ones depend on the sharpness of a picture."""

SMOOTHING_SIGMA = 1.0
"""Pixels of the Gaussian filter before edges are found."""

SIDE_DISTANCE = 2.5
"""Pixels from an edge to where the colours of its sides are read: beyond the smoothed step."""

MIN_CONTRAST, MIN_PHOTOGRAPH_CONTRAST = 0.3, 0.12
"""Least difference of both sides in some channel. Fainter edges of photographs count: frames may show them sharper."""

COLOUR_SCALE, DIRECTION_SCALE = 0.15, 1.0
"""Distances that count as 1: of all six values of RGB in [0, 1], and of unit vectors (60°)."""

MAX_STRETCH = 4.0
"""Most columns for one row: within 14° of a pole, steps along a row get shorter than those along a column."""

BORDER = int(np.ceil(MAX_STRETCH * SIDE_DISTANCE)) + 1
"""Pixels beyond the picture that its edges are read from."""

KD_TREE: dict[str, bool | int | float | str] = {"algorithm": 4, "leaf_max_size": 16}
"""FLANN_INDEX_KDTREE_SINGLE, which is exact."""

EXACT_SEARCH: dict[str, bool | int | float | str] = {"checks": -1, "eps": 0.0}
"""No leaf is left out."""


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
    """Share of the edges of a frame that are shards, by the area of their pixels; 0 of a frame without edges.

    ``image`` is RGB in [0, 1], taken at ``pose``, world-from-camera.
    """
    edges = find_edges(image, pose, photographs.size, MIN_CONTRAST)
    is_shard = photographs.lack(edges.points)
    return float(edges.weights[is_shard].sum() / max(edges.weights.sum(), 1e-9))


def find_edges(image: Picture, pose: Pose, size: tuple[int, int], min_contrast: float) -> Edges:
    """The edges of a panorama: where its brightness changes most along its gradient, and by enough of a channel."""
    smooth = cv2.GaussianBlur(add_border(_resized(image, size), BORDER), (0, 0), SMOOTHING_SIGMA)
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


def _resized(image: Picture, size: tuple[int, int]) -> Picture:
    pixels = np.asarray(image, np.float32)
    how = cv2.INTER_AREA if len(pixels) > size[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, size[::-1], interpolation=how))


def _moved(wide: np.ndarray, cols: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A picture with a border, read that many columns and rows beside each pixel within the border."""
    row, col = np.mgrid[BORDER : BORDER + rows.shape[0], BORDER : BORDER + rows.shape[1]].astype(np.float32)
    return np.asarray(cv2.remap(wide, col + cols, row + rows, cv2.INTER_LINEAR))
