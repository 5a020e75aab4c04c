"""What moves with the camera, from three or more panoramas of one camera: hoods, tripods, rods of any shape.

In the camera's own frame the scene changes from picture to picture, and the outline of a hood does not. So the median
of the gradients is nothing but that outline. What it surrounds is the hood.
"""

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from jaxtyping import Bool

from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.synthesis.nadir_map import DEG_PER_PIXEL, MAP_SIZE, Mask, NadirMap, map_degrees, morphed
from omnisyn_cli.types import View

MIN_PICTURES, MAX_PICTURES = 3, 12  # a median of two says nothing; more than the last number need not be read
PICTURE_SIZE = (512, 1024)  # height and width at which pictures are read: finer than the map
# Added to grey values before their logarithm, in which exposure has no say. Set by hand, as are all constants here.
BLACK = 0.02
# Least gradient of an outline, per pixel of the map, and the one from so many pictures on: noise is less there.
MIN_SLOPE, MIN_SLOPE_OF_MANY, MANY_PICTURES = 0.02, 0.03, 9
MIN_SIGNIFICANCE = 3.0  # ratio of the median gradient to its uncertainty
NOISE = 0.003  # gradient that differs from picture to picture anyhow
CLOSING_PIXELS, MARGIN_PIXELS = 3, 1  # how far parts of an outline may be apart, and what is left out around it
# Where an outline has to begin, from the nadir, and to end: lines along the way of the camera reach the horizon.
MAX_START_DEG, MAX_END_DEG = 12.0, 58.0
MIN_OUTLINE_PIXELS = 60  # of the map, that an outline has to have
# Turns of a cross of four rays, and how many of all sixteen rays meet an outline from inside of it.
TURNS_DEG, MIN_HITS = (0.0, 22.5, 45.0, 67.5), 13


def spread_out(count: int) -> list[int]:
    """Which of so many pictures are read: at most :data:`MAX_PICTURES`, none of fewer than :data:`MIN_PICTURES`."""
    wanted = min(count, MAX_PICTURES) if count >= MIN_PICTURES else 0
    return [int(index) for index in np.linspace(0, count - 1, wanted).round()]


def find_still_region(views: Iterable[View]) -> Mask | None:
    """What moves with the camera in all views, in the :class:`NadirMap` that is not turned; None without any.

    They were taken at several places with one camera that is held alike. Poses do not matter.
    """
    maps = [NadirMap.of(view, np.eye(3)) for view in views]
    if len(maps) < MIN_PICTURES:
        return None
    edges = _still_edges(maps)
    label = connected_regions(morphed(edges, cv2.MORPH_CLOSE, CLOSING_PIXELS), is_diagonal=True)
    radius, outlines = np.hypot(*map_degrees()), np.zeros(edges.shape, bool)
    nadir = radius < DEG_PER_PIXEL
    for number in np.unique(label[edges & (radius <= MAX_END_DEG) & (label > 0)]):
        part = label == number
        if radius[part].max() > MAX_END_DEG or np.count_nonzero(part & edges) < MIN_OUTLINE_PIXELS:
            continue
        if radius[part].min() <= MAX_START_DEG or _surrounded(part)[nadir].all():
            outlines |= part
    if not outlines.any():
        return None
    return morphed(outlines | _surrounded(outlines), cv2.MORPH_DILATE, MARGIN_PIXELS)


def _still_edges(maps: Sequence[NadirMap]) -> Mask:
    """Where the median gradient of a colour is large and certain; nowhere beside what is masked."""
    least = MIN_SLOPE if len(maps) < MANY_PICTURES else MIN_SLOPE_OF_MANY
    edges = np.zeros(maps[0].usable.shape, bool)
    hidden = [morphed(~each.usable, cv2.MORPH_DILATE, CLOSING_PIXELS) for each in maps]
    for channel in range(3):
        gradients = []
        for each, left_out in zip(maps, hidden, strict=True):
            light = cv2.GaussianBlur(np.log(np.maximum(each.image[..., channel], 0.0) + np.float32(BLACK)), (0, 0), 1.0)
            gradient = np.stack([cv2.Sobel(light, cv2.CV_32F, *axes, scale=0.125) for axes in ((1, 0), (0, 1))])
            gradients.append(np.where(left_out, np.float32(0.0), gradient))
        median = np.median(gradients, axis=0)
        slope = np.hypot(*median)
        spread = np.median(np.linalg.norm(gradients - median, axis=1), axis=0).astype(np.float32)
        significance = slope * np.sqrt(len(maps) - 1) / (cv2.blur(spread, (3, 3)) + NOISE)
        edges |= (slope > least) & (significance > MIN_SIGNIFICANCE)
    return edges


def _surrounded(outlines: Mask) -> Bool[np.ndarray, "rows cols"]:
    """Pixels from which most rays meet an outline, whatever gaps it has."""
    hits, centre = np.zeros(outlines.shape, np.float32), (0.5 * (MAP_SIZE - 1),) * 2
    for angle in TURNS_DEG:
        turn = cv2.getRotationMatrix2D(centre, angle, 1.0)
        turned = cv2.warpAffine(outlines.astype(np.uint8), turn, outlines.shape, flags=cv2.INTER_NEAREST)
        met = np.zeros(outlines.shape, np.float32)
        for axis in (0, 1):
            met += np.maximum.accumulate(turned, axis=axis)
            met += np.flip(np.maximum.accumulate(np.flip(turned, axis), axis=axis), axis)
        hits += cv2.warpAffine(met, turn, outlines.shape, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
    return np.asarray(hits >= MIN_HITS)
