"""More matches where few are found: features of walls and floors, rectified by gravity.

A wall that is near one camera and seen obliquely by the other is squeezed horizontally there. The levelled panorama is
therefore searched twice, once at half its width. The floor is searched as a bird sees it: nearly the same picture from
both cameras, while their own views foreshorten it differently.

Source: Morel and Yu, ASIFT: a new framework for fully affine invariant image comparison, 2009, whose tilts are reduced
to those that gravity leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.geometry.pose import rotation_taking
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sphere import UP, pixel_scale, pixel_to_direction
from omnisyn_cli.poses.registration.features import (
    MAX_SIFT_POINTS,
    Features,
    Matches,
    band_directions,
    detect_sift,
    grey_of,
    match_features,
    strongest_features,
)

FINE_ROWS, MAX_ENLARGEMENT = 1536, 1.5
"""Rows of the picture that is searched: larger panoramas are reduced to it, smaller ones enlarged by at most this. That
finds a third more matches in panoramas of 1024 rows."""

WALL_LATITUDE = math.radians(55.0)
"""Radians above and below the horizon that walls are looked for in."""

SQUEEZE = 2
"""Factor by which the second search narrows walls: those seen at 30° instead of 90°."""

FLOOR_PIXELS, FLOOR_TANGENT = 600, math.tan(math.radians(68.0))
"""Side of the bird's-eye view, and tangent of the largest angle from straight down along its sides."""


@dataclass(frozen=True)
class LevelledFeatures:
    """Features of one panorama, in the camera's frame.

    Attributes:
        walls: of the levelled panorama.
        squeezed_walls: of the same at half its width.
        floor: of the bird's-eye view.
    """

    walls: Features
    squeezed_walls: Features
    floor: Features


def fine_grey_of(image: Float[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "rows cols"]:
    """The picture of a panorama, RGB in [0, 1], that :func:`find_levelled_features` searches."""
    rows = min(FINE_ROWS, round(MAX_ENLARGEMENT * image.shape[0]))
    grey = grey_of(image, rows)
    return np.asarray(cv2.resize(grey, (2 * rows, rows), interpolation=cv2.INTER_CUBIC))


def find_levelled_features(
    grey: UInt8[np.ndarray, "height width"],
    up: Float[np.ndarray, " 3"],
    usable: Bool[np.ndarray, "rows cols"] | None = None,
    threads: int | None = None,
) -> LevelledFeatures:
    """Features of a panorama in grey whose zenith is ``up``."""
    level_from_camera = rotation_taking(up, UP)
    with limited_threads(threads):
        views = (_walls(grey, level_from_camera, 1), _walls(grey, level_from_camera, SQUEEZE))
        found = (*views, _floor(grey, level_from_camera))
    pixel = 1.0 / pixel_scale(grey.shape)[0]
    return LevelledFeatures(
        *(
            strongest_features(direction @ level_from_camera, descriptor, response, usable, pixel, MAX_SIFT_POINTS)
            for direction, descriptor, response in found
        )
    )


def match_levelled_features(first: LevelledFeatures, second: LevelledFeatures) -> Matches:
    """Walls with walls, squeezed or not in either panorama, and floor with floor."""
    pairs = (
        (first.walls, second.walls),
        (first.squeezed_walls, second.walls),
        (first.walls, second.squeezed_walls),
        (first.squeezed_walls, second.squeezed_walls),
        (first.floor, second.floor),
    )
    matches = match_features(*pairs[0])
    for pair in pairs[1:]:
        matches += match_features(*pair)
    return matches


def _walls(grey: np.ndarray, level_from_camera: np.ndarray, squeeze: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    _, width = size = (grey.shape[0], grey.shape[1])
    directions, top, wrap = band_directions(size, WALL_LATITUDE)
    band = RemapTable.for_directions(directions @ level_from_camera, grey.shape).bilinear(grey)
    narrow = cv2.resize(band, (band.shape[1] // squeeze, band.shape[0]), interpolation=cv2.INTER_AREA)
    place, descriptor, response = detect_sift(narrow)
    col = (place[:, 0] + 0.5) * (band.shape[1] / narrow.shape[1]) - 0.5 - wrap
    is_inside = (col >= -0.5) & (col < width - 0.5)
    direction = pixel_to_direction(place[is_inside, 1] + top, col[is_inside], size)
    return direction, descriptor[is_inside], response[is_inside]


def _floor(grey: np.ndarray, level_from_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows, cols = np.mgrid[:FLOOR_PIXELS, :FLOOR_PIXELS]
    view = RemapTable.for_directions(_floor_directions(cols, rows) @ level_from_camera, grey.shape).bilinear(grey)
    place, descriptor, response = detect_sift(view)
    return _floor_directions(place[:, 0], place[:, 1]), descriptor, response


def _floor_directions(col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Directions of places in the bird's-eye view, of which the right is +x and the top is −z."""
    x, z = (((place + 0.5) / FLOOR_PIXELS * 2.0 - 1.0) * FLOOR_TANGENT for place in (col, row))
    below = np.stack([x, -np.ones_like(x), z], axis=-1)
    return np.asarray(below / np.linalg.norm(below, axis=-1, keepdims=True))
