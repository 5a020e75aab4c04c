"""How far a finished estimate may be trusted, as a network says that sees it (:mod:`omnisyn_cli.networks.doubt`).

Everything is dimensionless, as in :mod:`omnisyn_cli.stereo.evidence`: distances count in baselines, and inverse depth
enters as its square root.
"""

from dataclasses import replace
from functools import partial
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped

from omnisyn_cli.geometry.lookup import Lookup
from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import motion_in_baselines, seen_from_second
from omnisyn_cli.stereo.evidence import root_of
from omnisyn_cli.stereo.rectify import resize_area
from omnisyn_cli.types import DepthEstimate, View

__all__ = [
    "COLOURED",
    "DIFFERENCES",
    "EAST_PLANE",
    "ROWS",
    "DoubtingNetwork",
    "doubt_planes",
    "doubted",
    "middles",
    "shrunk",
]

ROWS = 256
"""Of the maps that are looked at, at most."""

AROUND = 13
"""Side in pixels of the square in which the nearest and the farthest surface are looked for."""

EAST_PLANE = 8
"""Of the planes: the one that is odd in a mirror."""

COLOURED = (0, 11, 14, 17)
"""First of three planes that hold a picture."""

DIFFERENCES = slice(20, 23)
"""Planes that hold differences of pictures."""

POLE = np.array([0.0, 1.0, 0.0])
"""Of a camera's own frame: up, if it is held upright."""


class DoubtingNetwork(Protocol):
    """A trained network that is shown planes of a panorama of a pair, however it is run."""

    def __call__(self, planes: Float32[np.ndarray, "27 height width"]) -> Float32[np.ndarray, "height width"]:
        """The probability that the depth of a pixel is within 10 % of the truth."""
        ...


def doubted(
    first: View, second: View, estimates: tuple[DepthEstimate, DepthEstimate], network: DoubtingNetwork
) -> tuple[DepthEstimate, DepthEstimate]:
    """Both estimates as they are; their confidence is the geometric mean of what it was and what the network says.

    Neither knows everything: alone, what the network says ranks errors as well, but frames that it misleads lose more.

    Args:
        first: a panorama.
        second: the other one, from another place.
        estimates: of both, of one size.
        network: doubts.
    """
    one, other = (shrunk(estimate) for estimate in estimates)
    answers = (  # one after the other: planes and network take much memory
        network(doubt_planes((first, second), (one, other))),
        network(doubt_planes((second, first), (other, one))),
    )
    return _believed(estimates[0], answers[0]), _believed(estimates[1], answers[1])


def shrunk(estimate: DepthEstimate, rows: int = ROWS) -> DepthEstimate:
    """An estimate of so many rows at most: depth in the middle of the larger pixels, mean confidence."""
    size = (rows, 2 * rows)
    if len(estimate.inverse_depth) <= rows:
        return estimate
    confidence = resize_area(estimate.confidence, size)
    return replace(estimate, inverse_depth=middles(estimate.inverse_depth, size), confidence=confidence)


def middles(values: Shaped[np.ndarray, "height width"], size: tuple[int, int]) -> Shaped[np.ndarray, "rows columns"]:
    """The values at the middles of the pixels of a smaller map."""
    rows, columns = (((np.arange(n) + 0.5) * many / n).astype(int) for n, many in zip(size, values.shape, strict=True))
    return np.ascontiguousarray(values[rows[:, None], columns])


def _believed(estimate: DepthEstimate, told: Float32[np.ndarray, "rows columns"]) -> DepthEstimate:
    """The estimate with what the network says of it."""
    at = Lookup.along(pixel_directions(*estimate.inverse_depth.shape), told.shape)
    return replace(estimate, confidence=np.sqrt(estimate.confidence * at.bilinear(told)).astype(np.float32))


def doubt_planes(
    views: tuple[View, View], estimates: tuple[DepthEstimate, DepthEstimate]
) -> Float32[np.ndarray, "27 height width"]:
    """The input of a doubting network for the first of two panoramas.

    In order: its picture (3); the root of its map, how much greater the greatest and how much less the least root
    around is; its confidence; cosine to the direction of the other camera, and how far that lies to the east and to the
    north of the pixel; sine of the elevation; the other picture where the map, the nearest and the farthest surface
    around say that it shows the same point (3 each); mean absolute difference of colours at these (3); how much farther
    (roots) the other panorama's map is there than expected (3); its confidence at the first of them.
    """
    (view, other), (own, theirs) = views, estimates
    size, baseline = own.inverse_depth.shape, _baseline(view, other)
    image, other_image = (resize_area(each.image, size) for each in views)
    motion = motion_in_baselines(view.pose, other.pose)
    root, their_root = (root_of(each.inverse_depth * baseline) for each in estimates)
    nearest, farthest = _around(root)
    directions = pixel_directions(*size)
    seen, differences, gaps, places = [], [], [], []
    for candidate in (root, nearest, farthest):
        moved, expected = seen_from_second(directions, np.square(candidate.astype(np.float64)), motion)
        place = Lookup.along(moved, size)
        colours = place.bilinear(other_image)
        seen += list(np.moveaxis(colours, -1, 0).astype(np.float32))
        differences.append(np.abs(colours - image).mean(axis=-1).astype(np.float32))
        gaps.append((root_of(expected) - place.nearest(their_root)).astype(np.float32))
        places.append(place)
    towards = motion.inverse().position
    planes = [
        *np.moveaxis(image, -1, 0),
        root,
        nearest - root,
        root - farthest,
        own.confidence,
        *_where_is(towards / np.linalg.norm(towards), directions),
        directions[..., 1],
        *seen,
        *differences,
        *gaps,
        places[0].nearest(theirs.confidence),
    ]
    return np.stack(planes).astype(np.float32)


def _baseline(view: View, other: View) -> float:
    return float(np.linalg.norm(other.pose.position - view.pose.position))


def _around(root: Float32[np.ndarray, "height width"]) -> tuple[np.ndarray, np.ndarray]:
    """The greatest and the least root around every pixel, over the seam."""
    window = np.ones((AROUND, AROUND), np.uint8)
    nearest, farthest = (
        filter_across_seam(partial(extreme, kernel=window), root, AROUND) for extreme in (cv2.dilate, cv2.erode)
    )
    return nearest, farthest


def _where_is(
    towards: Float[np.ndarray, " 3"], directions: Float[np.ndarray, "height width 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A unit vector seen from every pixel: its parts along the pixel's direction, to the east and to the north."""
    east = np.cross(directions, POLE)
    east /= np.maximum(np.linalg.norm(east, axis=-1, keepdims=True), 1e-6)
    return directions @ towards, east @ towards, np.cross(east, directions) @ towards
