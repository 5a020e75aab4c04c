"""The edges of a finished estimate, decided pixel by pixel by a network (:mod:`omnisyn_cli.networks.silhouettes`).

Everything is dimensionless, as in :mod:`omnisyn_cli.stereo.evidence`: distances count in baselines, and inverse depth
enters as its square root.
"""

from functools import partial

import cv2
import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.geometry.lookup import Lookup
from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import motion_in_baselines, seen_from_second
from omnisyn_cli.stereo.evidence import GREATEST_ROOT, PlanesNetwork, root_of
from omnisyn_cli.stereo.rectify import resize_area
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["COLOURED", "DIFFERENCES", "EAST_PLANE", "silhouette_planes", "with_silhouettes"]

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

DOUBTED = 0.3
"""Confidence below which an estimate may be changed: edges that are believed are thin things more often than errors.

Frames of 1024×512 between three sets of pairs, in dB: +0.07 (twelve pairs of the bench), +0.18 (fifteen of five kinds),
+0.23 (warehouses); with 0.5 +0.04, +0.18, +0.28; with 0.8 −0.02, +0.17, +0.31; everywhere −0.07, +0.10, +0.25.
"""

UNCHANGED = 1e-4
"""Difference of roots below which a pixel has kept its depth."""


def with_silhouettes(
    first: View, second: View, estimates: tuple[DepthEstimate, DepthEstimate], network: PlanesNetwork
) -> tuple[DepthEstimate, DepthEstimate]:
    """Both estimates with edges as the network has them, believed no more than before and no more than it says.

    Args:
        first: a panorama.
        second: the other one, from another place.
        estimates: of both, of one size.
        network: decides.
    """
    one, other = estimates
    baseline = _baseline(first, second)
    return (  # one after the other: planes and network take much memory
        _decided(first, one, *network(silhouette_planes((first, second), (one, other))), baseline),
        _decided(second, other, *network(silhouette_planes((second, first), (other, one))), baseline),
    )


def silhouette_planes(
    views: tuple[View, View], estimates: tuple[DepthEstimate, DepthEstimate]
) -> Float32[np.ndarray, "27 height width"]:
    """The input of a silhouette network for the first of two panoramas.

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


def _decided(
    view: View, estimate: DepthEstimate, inverse_depth: np.ndarray, confidence: np.ndarray, baseline: float
) -> DepthEstimate:
    """What the network says where the estimate is doubted; where it keeps that, it is kept bit for bit.

    In pictures of fewer rows than the estimate edges are too soft to choose by: there only the confidence is taken.
    """
    is_kept = (estimate.confidence >= DOUBTED) | (view.image.shape[0] < estimate.inverse_depth.shape[0])
    is_kept |= np.abs(root_of(inverse_depth) - root_of(estimate.inverse_depth * baseline)) < UNCHANGED
    is_kept |= estimate.inverse_depth * baseline > GREATEST_ROOT**2
    chosen = np.where(is_kept, estimate.inverse_depth, inverse_depth / baseline)
    trust = np.minimum(estimate.confidence, confidence)
    return DepthEstimate(chosen.astype(np.float32), trust.astype(np.float32), estimate.sure)
