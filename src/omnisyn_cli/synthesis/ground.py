"""The ground continued where a panorama is masked around its nadir: a cap, a tripod, an operator.

The ground is a horizontal plane at the height that most of the depth around the gap agrees on. Its colours come from
the other panorama of the pair where that sees the same ground, else from a patch of the own ground nearby. The patch is
the one whose surroundings fit best around the gap (Criminisi et al., Region filling by exemplar-based inpainting, 2004,
with one patch for the whole gap).
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.compute.threads import both
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import (
    direction_to_pixel,
    pixel_directions,
    pixel_scale,
    pixel_to_direction,
    solid_angles,
)
from omnisyn_cli.synthesis.nadir_map import MAP_SIZE, look_up, to_map
from omnisyn_cli.types import DepthEstimate, View

ViewPair = tuple[View, View]
DepthPair = tuple[DepthEstimate, DepthEstimate]

# Up to which angle from the nadir ground is continued, and within which a masked region has to begin. Set by hand.
MAX_GROUND_DEG, MAX_START_DEG = 60.0, 40.0
RING_DEG = 12.0  # degrees around a gap whose depth says where its ground is. Set by hand.

# Share of what is known around a gap that has to agree on a height, and the relative range that counts as one. The last
# one is for depth of little confidence.
MIN_HEIGHT_SHARE, HEIGHT_TOLERANCE, UNSURE_HEIGHT_TOLERANCE = 0.4, 0.1, 0.2
SAME_GROUND_TOLERANCE = 0.12  # relative difference of inverse depth up to which a pixel shows the ground. Set by hand.
# Confidence of continued ground: what the other panorama shows there counts more. Set by hand.
GROUND_CONFIDENCE = 0.05

# Confidence from which on depth is that of the ground itself, and the other panorama's colours are too. Set by hand.
MIN_GROUND_CONFIDENCE = 0.3
# Pixels around a gap that its filling has to join, and the greatest difference that is added for it. Set by hand.
EDGE_PIXELS, MAX_STEP = 4, 0.3
MAX_GAIN = 2.0  # ratio of brightness between the panoramas that is believed. Set by hand.
# The other panorama is believed if this share of the pixels around a gap differs by less. Set by hand.
MAX_RING_DIFFERENCE, MIN_RING_SHARE = 0.12, 0.6

# Confidence of depth from which on a pixel may be part of a patch: furniture must not be copied. The second one is
# tried where no patch has the first. Set by hand.
SOURCE_CONFIDENCES = (0.5, 0.1)
MIN_RING_PIXELS = 32  # pixels around a gap that brightness can be compared at. Set by hand.
RING_PIXELS = 12  # pixels around a gap that a patch has to fit. Set by hand.
MAX_FLAT_ROWS = 900  # rows of the ground seen from above in which patches are looked for. Set by hand.


def continue_ground(views: ViewPair, depths: DepthPair) -> tuple[ViewPair, DepthPair]:
    """Views and depths in which masked regions around the nadir are ground; the very same where there are none."""
    first, second = both(
        lambda: _continued(views[0], views[1], depths[0], depths[1]),
        lambda: _continued(views[1], views[0], depths[1], depths[0]),
    )
    return (first[0], second[0]), (first[1], second[1])


def _continued(view: View, other: View, depth: DepthEstimate, other_depth: DepthEstimate) -> tuple[View, DepthEstimate]:
    """One of both views."""
    gap = _nadir_hole(view)
    if gap is None or view.mask is None:
        return view, depth
    height = _height(view, depth, gap)
    if height is None:
        return view, depth
    image = np.array(view.image, np.float32)
    rows, cols = np.nonzero(gap)
    directions = pixel_to_direction(rows, cols, gap.shape)
    seen, colour = _seen_by_other(directions, view, other, other_depth, height)
    recoloured = None
    if seen.any():
        recoloured = _recolour(colour, directions[seen], image, gap, view, other, other_depth, height)
    if recoloured is None:
        seen[:] = False
    else:
        image[rows[seen], cols[seen]] = recoloured
    missing = np.zeros_like(gap)
    missing[rows[~seen], cols[~seen]] = True
    is_whole = not missing.any() or _fill_with_patch(image, missing, view, depth, height)
    filled = gap if is_whole else gap & ~missing
    mask = view.mask | filled
    rho = _plane(pixel_directions(*depth.inverse_depth.shape), view, height)
    here = sample_nearest(filled.astype(np.float32), pixel_directions(*rho.shape)) > 0.5
    known = DepthEstimate(
        np.where(here, rho, depth.inverse_depth).astype(np.float32),
        np.where(here, np.float32(GROUND_CONFIDENCE), depth.confidence).astype(np.float32),
        depth.stereo_valid,
    )
    samples = None if view.image_uint8 is None else view.image_uint8.copy()
    if samples is not None:
        samples[filled] = np.rint(255.0 * image[filled])
    return replace(view, image=image, image_uint8=samples, mask=None if mask.all() else mask), known


def _nadir_hole(view: View) -> Bool[np.ndarray, "height width"] | None:
    """Masked pixels that are to be ground; None if there are none."""
    if view.mask is None or view.mask.all():
        return None
    height = view.mask.shape[0]
    low, start = (int(height * (1.0 - angle / 180.0)) for angle in (MAX_GROUND_DEG, MAX_START_DEG))
    gap = ~view.mask
    gap[:low] = False
    label = connected_regions(gap, is_diagonal=True)
    gap &= np.isin(label, np.unique(label[start:]))
    return gap if gap.any() else None


def _plane(directions: np.ndarray, view: View, height: float) -> Float[np.ndarray, "..."]:
    """Inverse depth of the ground in directions in the frame of the camera."""
    return np.asarray(np.maximum(-(directions @ view.pose.rotation[1]), 0.0) / height)


def _height(view: View, depth: DepthEstimate, gap: Bool[np.ndarray, "height width"]) -> float | None:
    """Height above the ground: the one that most of the depth around the gap agrees on; None without any."""
    size = depth.inverse_depth.shape
    directions = pixel_directions(*size)
    reach = max(1, round(size[0] * RING_DEG / 180.0))
    inside = sample_nearest(gap.astype(np.float32), directions)
    ring = cv2.dilate(inside, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0.5
    ring &= sample_nearest(np.asarray(view.mask, np.float32), directions) > 0.5
    down, rho = _plane(directions, view, 1.0), depth.inverse_depth
    usable = ring & (rho > 0.0) & (down > 0.0)
    weight = (solid_angles(*size) * depth.confidence)[usable]
    if weight.sum() <= 0.0:
        return None
    heights = np.log(down[usable] / rho[usable])
    order = np.argsort(heights)
    heights, sums = heights[order], np.concatenate([[0.0], np.cumsum(weight[order])])
    is_confident = np.median(depth.confidence[usable]) > MIN_GROUND_CONFIDENCE
    ends = np.searchsorted(heights, heights + (HEIGHT_TOLERANCE if is_confident else UNSURE_HEIGHT_TOLERANCE))
    within = sums[ends] - sums[: len(heights)]
    best = int(np.argmax(within))
    if within[best] < MIN_HEIGHT_SHARE * sums[-1]:
        return None
    return float(np.exp(np.median(heights[best : ends[best]])))


def _seen_by_other(
    directions: Float[np.ndarray, "pixels 3"], view: View, other: View, other_depth: DepthEstimate, height: float
) -> tuple[Bool[np.ndarray, " pixels"], Float[np.ndarray, "seen 3"]]:
    """Where the other view sees the ground that lies in directions of a view, and the colours of what it sees."""
    distance = 1.0 / np.maximum(_plane(directions, view, height), 1e-6)
    world = (directions @ view.pose.rotation.T) * distance[:, None] + view.pose.position - other.pose.position
    rho = 1.0 / np.maximum(np.linalg.norm(world, axis=-1), 1e-9)
    to_ground = (world * rho[:, None]) @ other.pose.rotation
    known, confidence = np.moveaxis(sample_nearest(_with_confidence(other_depth), to_ground), -1, 0)
    seen = np.abs(known - rho) < SAME_GROUND_TOLERANCE * np.maximum(known, rho)
    seen &= confidence > MIN_GROUND_CONFIDENCE
    if other.mask is not None:
        seen &= sample_nearest(other.mask.astype(np.float32), to_ground) > 0.5
    return np.asarray(seen), np.asarray(sample_bilinear(np.asarray(other.image, np.float32), to_ground[seen]))


def _with_confidence(depth: DepthEstimate) -> Float32[np.ndarray, "height width 2"]:
    return np.stack([depth.inverse_depth, depth.confidence], axis=-1, dtype=np.float32)


def _recolour(
    colour: Float[np.ndarray, "pixels 3"], inside: Float[np.ndarray, "pixels 3"],
    image: Float32[np.ndarray, "height width 3"], gap: Bool[np.ndarray, "height width"], view: View, other: View,
    other_depth: DepthEstimate, height: float,
) -> Float[np.ndarray, "pixels 3"] | None:  # fmt: skip
    """Colours that the other view sees inside a gap, as bright as the ground around it; None where that differs."""
    ring = (cv2.dilate(gap.astype(np.uint8), np.ones((2 * EDGE_PIXELS + 1,) * 2, np.uint8)) > 0) & ~gap
    rows, cols = np.nonzero(ring & np.asarray(view.mask))
    directions = pixel_to_direction(rows, cols, gap.shape)
    seen, around = _seen_by_other(directions, view, other, other_depth, height)
    if np.count_nonzero(seen) < MIN_RING_PIXELS:
        return None
    own = image[rows[seen], cols[seen]]
    ratio = np.median(own, axis=0) / np.maximum(np.median(around, axis=0), 1e-3)
    gain = np.clip(ratio, 1.0 / MAX_GAIN, MAX_GAIN)
    difference = own - gain * around
    # wrong depth would move other things onto the ground
    if (np.abs(difference).mean(axis=-1) < MAX_RING_DIFFERENCE).mean() < MIN_RING_SHARE:
        return None
    return np.asarray(np.clip(colour * gain + _continued_step(difference, directions[seen], inside), 0.0, 1.0))


def _continued_step(
    difference: Float[np.ndarray, "edge 3"], edge: Float[np.ndarray, "edge 3"], inside: Float[np.ndarray, "pixels 3"]
) -> Float32[np.ndarray, "pixels 3"]:
    """Differences of colour around a gap, continued smoothly into it (Pérez et al., Poisson image editing, 2003)."""
    size = (MAP_SIZE, MAP_SIZE)
    col, row = (np.clip(np.rint(index), 0, MAP_SIZE - 1).astype(np.intp) for index in to_map(edge))
    step, weight = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    np.add.at(step, (row, col), np.clip(difference, -MAX_STEP, MAX_STEP) + 1.0)  # the filler knows no colour below 0
    np.add.at(weight, (row, col), 1.0)
    step /= np.maximum(weight, 1.0)[..., None]
    step = HoleFiller(size)(step, np.minimum(weight, 1.0))
    wanted = np.resize(inside, (-(-len(inside) // MAP_SIZE), MAP_SIZE, 3))  # OpenCV looks up no longer rows
    return look_up(step, *to_map(wanted)).reshape(-1, 3)[: len(inside)] - np.float32(1.0)


def _fill_with_patch(
    image: Float32[np.ndarray, "height width 3"], gap: Bool[np.ndarray, "height width"], view: View,
    depth: DepthEstimate, height: float,
) -> bool:  # fmt: skip
    """Fill a gap of the image, in place, with a patch of the ground whose depth is confident; whether one fits."""
    # the ground is seen from above, so that a pattern keeps its shape wherever it is
    reach = float(np.tan(np.radians(MAX_GROUND_DEG)))
    count = min(MAX_FLAT_ROWS, round(2.0 * reach * pixel_scale(gap.shape)[0]))
    axis = (np.arange(count) + 0.5) * (2.0 * reach / count) - reach
    x, y = np.meshgrid(axis, axis)
    world = np.stack([x, np.full_like(x, -1.0), y], axis=-1)
    directions = ((world / np.linalg.norm(world, axis=-1, keepdims=True)) @ view.pose.rotation).astype(np.float32)
    row, col = (np.asarray(at, np.float32) for at in direction_to_pixel(directions, gap.shape))
    flat = cv2.remap(image, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    marks = np.stack([gap, np.asarray(view.mask)], axis=-1, dtype=np.float32)
    hole, usable = np.moveaxis(sample_nearest(marks, directions) > 0.5, -1, 0)
    known, confidence = np.moveaxis(sample_nearest(_with_confidence(depth), directions), -1, 0)
    plane = _plane(directions, view, height)
    ground = (np.abs(known - plane) < SAME_GROUND_TOLERANCE * np.maximum(known, plane)) & ~hole & usable
    rows, cols = (np.flatnonzero(hole.any(axis=k)) for k in (1, 0))
    if not len(rows):
        return False
    top, left = max(rows[0] - RING_PIXELS, 0), max(cols[0] - RING_PIXELS, 0)
    box = slice(top, rows[-1] + RING_PIXELS + 1), slice(left, cols[-1] + RING_PIXELS + 1)
    around = cv2.dilate(hole.astype(np.uint8), np.ones((2 * RING_PIXELS + 1,) * 2, np.uint8)) > 0
    for least in SOURCE_CONFIDENCES:
        valid = ground & (confidence > least)
        if (patch := _best_patch(flat, box, hole, valid, valid & around)) is not None:
            break
    else:
        return False
    near = cv2.dilate(hole[box].astype(np.uint8), np.ones((2 * EDGE_PIXELS + 1,) * 2, np.uint8)) > 0
    edge, inside, rays = near & (valid & around)[box], hole[box], directions[box]
    step = _continued_step((flat[box] - patch)[edge], rays[edge], rays[inside])
    flat[box][inside] = np.clip(patch[inside] + step, 0.0, 1.0)
    first = int(np.flatnonzero(gap.any(axis=1))[0])
    below = np.arange(first, len(gap))[:, None]
    seen = pixel_to_direction(below, np.arange(gap.shape[1]), gap.shape) @ view.pose.rotation.T
    scale = count / (2.0 * reach) / np.maximum(-seen[..., 1], 1e-3)
    col, row = ((seen[..., k] * scale + 0.5 * count - 0.5).astype(np.float32) for k in (0, 2))
    continued = cv2.remap(flat, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    image[first:][gap[first:]] = continued[gap[first:]]
    return True


def _best_patch(
    flat: Float32[np.ndarray, "rows cols 3"], box: tuple[slice, slice], hole: Bool[np.ndarray, "rows cols"],
    valid: Bool[np.ndarray, "rows cols"], ring: Bool[np.ndarray, "rows cols"],
) -> Float32[np.ndarray, "height width 3"] | None:  # fmt: skip
    """The patch of the box's size that fits the ring around a hole best and is valid inside; None if there is none."""
    if max(ring[box].shape) > len(flat) // 2 or np.count_nonzero(ring[box]) < MIN_RING_PIXELS:
        return None
    weight = np.repeat(ring[box].astype(np.float32)[..., None], 3, axis=2)
    misfit = cv2.matchTemplate(flat, flat[box], cv2.TM_SQDIFF, mask=weight)
    lacking = cv2.matchTemplate((~valid).astype(np.float32), hole[box].astype(np.float32), cv2.TM_CCORR)
    misfit[lacking > 0.5] = np.inf
    row, col = np.unravel_index(int(np.argmin(misfit)), misfit.shape)
    if not np.isfinite(misfit[row, col]):
        return None
    return flat[row : row + ring[box].shape[0], col : col + ring[box].shape[1]].copy()
