"""What moves with the camera: caps over the nadir, tripods, car roofs and operators, found in a pair of panoramas.

Both panoramas are looked at around their own nadir, in a map whose pixels have equal angles. A cap is a uniform patch,
or a disc with a round edge or a blurred inside. Paint over an operator has exactly one colour
(:mod:`omnisyn_cli.synthesis.painted_areas`). Everything else keeps its place in both maps although the ground has
moved. The ground is a horizontal plane; the camera's height above it is the one that explains most of both maps.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int

from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.synthesis.nadir_map import (
    DEG_PER_PIXEL,
    GROUND_HEIGHTS,
    MAP_SIZE,
    WINDOW,
    Mask,
    NadirMap,
    ground_pixels,
    look_up,
    map_degrees,
    morphed,
    on_sphere,
    turn_along,
)  # fmt: skip
from omnisyn_cli.synthesis.painted_areas import find_painted
from omnisyn_cli.types import View

CAP_RADII_DEG = (4.0, 45.0)  # least and largest radius of a cap. Set by hand, as are all constants of this file.
MAX_CAP_AREA_RATIO = 1.7  # the caps of both panoramas have about the same area
MAX_PAINT_RATIO = 1.1  # a painted area larger than the cap that is found in it, by this ratio, is no cap
PATCH_TOLERANCE = 0.036  # difference of colour inside a uniform patch: JPEG noise.
# Share of its convex hull that a uniform patch has to fill, and how far from the nadir it lies, in half sides.
MIN_SOLIDITY, MAX_OFFSET = 0.85, 0.34
# Step of colour at the edge of a cap, share of the circumference that has it, and its ratio to steps elsewhere.
MIN_EDGE_STEP, MIN_EDGE_SHARE, MIN_EDGE_LEAD = 0.04, 0.75, 3.0
# Mean difference from a smoothed picture beside a blurred disc, and the share of it inside.
MIN_DETAIL, MAX_BLURRED_DETAIL = 0.006, 0.45
# Sectors of a circle around the nadir in which edges are looked for, and samples across each.
SECTORS, SUBSECTORS = 72, 4
# Share of the map that has to show the ground at its best height, and its ratio to the median of all heights.
MIN_GROUND_SHARE, MIN_GROUND_LEAD = 0.004, 2.0
# Horizontal distance of the cameras, in heights above the ground, from which on the ground moves enough.
MIN_BASELINE = 0.25
MIN_GROUND_MOTION_DEG = 6.0  # angle by which the ground must move at a place
SEARCH_PIXELS = 3  # pixels of the map that something may move beside the camera: an operator is never quite still
MIN_GROUND_CONTRAST, MIN_OBJECT_CONTRAST = 0.02, 0.03  # standard deviation of colours in windows that can be compared
MIN_CORRELATION = 0.85  # correlation of windows that show the same ground
# Likeness in place of what moves with the camera, and its lead over the correlation of the moved ground.
MIN_LIKENESS, MIN_LIKENESS_LEAD = 0.8, 0.25
# Distances at which a window may look like itself, and how much it does where a pattern repeats.
REPEAT_PIXELS, MIN_REPEAT_LIKENESS = range(4, 12), 0.7
# Differences of smoothed colours in place, and from the moved ground, of what belongs to such windows.
MAX_STILL_DIFFERENCE, MIN_GROUND_DIFFERENCE = 0.04, 0.06
# How far from such windows the rest of an object is looked for, and how wide its gaps may be.
GROWTH_PIXELS, CLOSING_PIXELS = 8, 4
# Where such an object has to begin, from the nadir, and its least area in square degrees.
MAX_START_DEG, MIN_AREA_DEG2 = 22.0, 60.0
# Of the seeds of an object: a striped line on the ground may lie where another one lay in the other picture.
MIN_UNIQUE_SHARE = 0.5
MARGIN_PIXELS = 2  # what is left out around everything found: soft edges, shadows of contact


def find_camera_fixed(first: View, second: View, still: Mask | None = None) -> tuple[Mask | None, Mask | None]:
    """Pixels of both views, each at its own size, that show what moves with the camera; None where nothing does.

    They were taken elsewhere with the same camera: where both stand at one place nothing can be said. ``still`` is what
    was found in more than two pictures, see :func:`omnisyn_cli.synthesis.still_outlines`.
    """
    if at_same_position(first.pose, second.pose):
        return None, None
    turn = turn_along(first.pose.rotation.T @ (second.pose.position - first.pose.position))
    views, maps = (first, second), (NadirMap.of(first, turn), NadirMap.of(second, turn))
    painted = find_painted(views, maps)
    if still is not None:
        sizes = (view.image.shape[:2] for view in views)
        whole = [paint | on_sphere(still, np.eye(3), size) for paint, size in zip(painted, sizes, strict=True)]
        return whole[0], whole[1]
    on_map = [
        np.asarray(sample_nearest(mask.astype(np.float32), each.directions) > 0.5)
        for mask, each in zip(painted, maps, strict=True)
    ]
    caps = [_uniform_patch(each.image) for each in maps]
    if not all(cap.any() for cap in caps):
        caps = [_round_cap(each.image) for each in maps]
    areas = sorted(int(cap.sum()) for cap in caps)
    has_cap = areas[0] > 0 and areas[1] < MAX_CAP_AREA_RATIO * areas[0]
    has_cap = has_cap and max(int(mask.sum()) for mask in on_map) < MAX_PAINT_RATIO * areas[1]
    still = _find_static_regions(maps, views, on_map)
    masks = []
    for view, cap, paint in zip(views, caps, painted, strict=True):
        found = _dilated(still | cap if has_cap else still, MARGIN_PIXELS)
        mask = paint | on_sphere(found, turn, view.image.shape[:2]) if found.any() else paint
        masks.append(mask if mask.any() else None)
    return masks[0], masks[1]


def _dilated(mask: Mask, reach: int) -> Mask:
    return morphed(mask, cv2.MORPH_DILATE, reach)


def _uniform_patch(image: np.ndarray) -> Mask:
    """The uniform region that contains the nadir, if it is compact, of the size of a cap, and ends in an edge."""
    x, y = map_degrees()
    radius, nothing, middle = np.hypot(x, y), np.zeros(image.shape[:2], bool), MAP_SIZE // 2
    colour = np.median(image[radius < 0.5 * CAP_RADII_DEG[0]], axis=0)
    label = connected_regions(_step(image, colour) < PATCH_TOLERANCE, is_diagonal=False)
    region = (label == label[middle, middle]) & (label > 0)
    if not region[radius < 0.5 * CAP_RADII_DEG[0]].all() or radius[region].max() > CAP_RADII_DEG[1]:
        return nothing
    contours, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = cv2.fillConvexPoly(np.zeros(image.shape[:2], np.uint8), cv2.convexHull(np.concatenate(contours)), 1) > 0
    size = 0.5 * np.sqrt(hull.sum()) * DEG_PER_PIXEL  # half the side of a square of its area
    offset = np.hypot(x[region].mean(), y[region].mean())
    if size < CAP_RADII_DEG[0] or region.sum() < MIN_SOLIDITY * hull.sum() or offset > MAX_OFFSET * size:
        return nothing
    ring = _dilated(hull, 4) & ~_dilated(hull, 2)
    is_edge = _step(image, colour)[ring] > MIN_EDGE_STEP
    return hull if is_edge.mean() >= MIN_EDGE_SHARE else nothing


def _round_cap(image: np.ndarray) -> Mask:
    """A disc around the nadir that ends in a circular edge, or that is blurred where the ground beside it is not."""
    radius = np.hypot(*map_degrees())
    first, last = (round(angle / DEG_PER_PIXEL) for angle in CAP_RADII_DEG)
    count, centre = last + 12, (MAP_SIZE / 2 - 0.5, MAP_SIZE / 2 - 0.5)
    fine = _step(image, cv2.GaussianBlur(image, (0, 0), 1.5))
    colour, detail = (
        cv2.warpPolar(values, (count, SECTORS * SUBSECTORS), centre, count, cv2.WARP_POLAR_LINEAR)
        .reshape(SECTORS, SUBSECTORS, count, -1)
        .mean(axis=1)
        for values in (image, fine)
    )  # sectors, radii, channels
    steps = np.zeros((SECTORS, count))
    steps[:, 2:-2] = np.abs(colour[:, 3:-1] - colour[:, 1:-3]).max(axis=-1)
    share, strength = (steps > MIN_EDGE_STEP).mean(axis=0), np.median(steps, axis=0)
    lead = np.zeros(count)
    for k in range(first, last + 1):
        if share[k] >= MIN_EDGE_SHARE and strength[k] == strength[k - 2 : k + 3].max():
            around = max(np.median(strength[k + 3 : k + 10]), np.median(strength[max(1, k - 10) : k - 2]))
            lead[k] = strength[k] / max(around, 0.25 * MIN_EDGE_STEP)
    if lead.max() >= MIN_EDGE_LEAD:
        return np.asarray(radius <= np.argmax(lead) * DEG_PER_PIXEL)
    inner = np.maximum.accumulate(cv2.blur(detail[..., 0], (5, 1)).mean(axis=0))  # the most up to a radius
    for k in range(last, first - 1, -1):
        outside = detail[:, k + 3 : k + 8].mean(axis=(1, 2))
        is_step = detail[:, k - 6 : k - 1].mean(axis=(1, 2)) < MAX_BLURRED_DETAIL * outside
        is_blurred = inner[k - 2] < MAX_BLURRED_DETAIL * outside.mean()
        if outside.mean() > MIN_DETAIL and is_blurred and is_step.mean() >= MIN_EDGE_SHARE:
            return np.asarray(radius <= (k + 4) * DEG_PER_PIXEL)
    return np.zeros(radius.shape, bool)


def _find_static_regions(maps: tuple[NadirMap, NadirMap], views: tuple[View, View], painted: Sequence[Mask]) -> Mask:
    """What keeps its place in both maps although the ground has moved; beside paint nothing is known."""
    nothing = np.zeros(maps[0].image.shape[:2], bool)
    way = views[1].pose.position - views[0].pose.position
    repeats = [_repetition_count(each, view.pose, way) for each, view in zip(maps, views, strict=True)]
    height = _ground_height(maps, views, repeats[0])
    if height is None:
        return nothing
    in_place = [np.full(nothing.shape, -1.0, np.float32) for _ in maps]
    difference = [np.full(nothing.shape, 9.0, np.float32) for _ in maps]
    smooth = [cv2.blur(each.image, (3, 3)) for each in maps]
    reach = range(-SEARCH_PIXELS, SEARCH_PIXELS + 1)
    for shift in ((down, right) for down in reach for right in reach):
        back = (-shift[0], -shift[1])
        like = _likeness(*maps, shift)
        colour = _step(smooth[0], np.roll(smooth[1], shift, (0, 1)))
        moved_back = np.roll(like, back, (0, 1)), np.roll(colour, back, (0, 1))
        for k, (values, steps) in enumerate(((like, colour), moved_back)):
            np.maximum(in_place[k], values, out=in_place[k])
            np.minimum(difference[k], steps, out=difference[k])
    at = [ground_pixels(maps[k], (views[k], views[1 - k]), height + k * float(way[1])) for k in (0, 1)]
    predicted = [look_up(maps[1 - k].image, *at[k]) for k in (0, 1)]
    on_ground = [_correlation(maps[k].grey, predicted[k] @ np.full(3, 1.0 / 3.0, np.float32)) for k in (0, 1)]
    near = np.ones((2 * SEARCH_PIXELS + 1,) * 2, np.uint8)
    kept = []
    for k in (0, 1):
        motion = np.hypot(at[k][0] - np.arange(MAP_SIZE), at[k][1] - np.arange(MAP_SIZE)[:, None]) * DEG_PER_PIXEL
        is_moving = (motion > MIN_GROUND_MOTION_DEG) & maps[k].usable & ~_dilated(painted[k], WINDOW[0] // 2)
        ground = np.maximum(cv2.dilate(on_ground[k], near[:3, :3]), cv2.dilate(on_ground[1 - k], near))
        step = _step(smooth[k], cv2.blur(predicted[k], (3, 3)))
        is_other = cv2.dilate(step, near[:5, :5]) > 2.0 * MIN_GROUND_DIFFERENCE
        is_like = (in_place[k] > MIN_LIKENESS) & (in_place[k] > ground + MIN_LIKENESS_LEAD)
        seeds = is_moving & is_other & is_like & (repeats[k] < 2)
        rest = (difference[k] < MAX_STILL_DIFFERENCE) & (step > MIN_GROUND_DIFFERENCE)
        kept.append(_objects(seeds, repeats[k] == 0, seeds | (_dilated(seeds, GROWTH_PIXELS) & is_moving & rest)))
    both = (kept[0] & _dilated(kept[1], GROWTH_PIXELS)) | (kept[1] & _dilated(kept[0], GROWTH_PIXELS))
    outlines, _ = cv2.findContours(both.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)  # without holes
    return np.asarray(cv2.drawContours(np.zeros(both.shape, np.uint8), outlines, -1, 1, cv2.FILLED) > 0)


def _objects(seeds: Mask, unique: Mask, region: Mask) -> Mask:
    """The connected parts of a region that begin near the nadir and have enough seeds, most of which repeat nowhere."""
    closed = morphed(morphed(region, cv2.MORPH_OPEN, 1), cv2.MORPH_CLOSE, CLOSING_PIXELS)
    label, radius = connected_regions(closed, is_diagonal=True), np.hypot(*map_degrees())
    kept = np.zeros(seeds.shape, bool)
    for number in np.unique(label[seeds & closed]):
        part = label == number
        seed_count = np.count_nonzero(part & seeds)
        is_unique = np.count_nonzero(part & seeds & unique) >= MIN_UNIQUE_SHARE * seed_count
        if seed_count * DEG_PER_PIXEL**2 >= MIN_AREA_DEG2 and is_unique and radius[part].min() <= MAX_START_DEG:
            kept |= part
    return kept


def _ground_height(
    maps: tuple[NadirMap, NadirMap], views: tuple[View, View], repeats: Int[np.ndarray, "rows cols"]
) -> float | None:
    """The first camera's height above the ground, by patterns that do not repeat; None if no height stands out."""
    way = views[1].pose.position - views[0].pose.position
    heights = GROUND_HEIGHTS * float(np.linalg.norm(way))
    shares = []
    for height in heights:
        predicted = look_up(maps[1].grey, *ground_pixels(maps[0], views, float(height)))
        fits = (_correlation(maps[0].grey, predicted) > MIN_CORRELATION) & (repeats == 0)
        shares.append(float(fits.mean()))
    best = int(np.argmax(shares))
    if shares[best] < max(MIN_GROUND_SHARE, MIN_GROUND_LEAD * float(np.median(shares))):
        return None
    return float(heights[best]) if np.hypot(way[0], way[2]) >= MIN_BASELINE * heights[best] else None


def _repetition_count(one: NadirMap, pose: Pose, way: Float[np.ndarray, " 3"]) -> Int[np.ndarray, "rows cols"]:
    """In how many of four directions a pattern repeats itself: it may be found in place by chance."""
    axes = np.zeros(one.image.shape[:2], int)
    right, _, down = one.turn.T @ pose.rotation.T @ way / max(float(np.linalg.norm(way)), 1e-9)
    # the way of the camera counts twice: a line along it stays in place
    for axis, count in (((0, 1), 1), ((1, 0), 1), ((1, 1), 1), ((1, -1), 1), ((float(down), float(right)), 2)):
        alike = np.full(axes.shape, -1.0, np.float32)
        for far in REPEAT_PIXELS[:: 3 - count]:
            shift = (round(far * axis[0]), round(far * axis[1]))
            like = _likeness(one, one, shift)
            alike = np.maximum(alike, np.maximum(like, np.roll(like, (-shift[0], -shift[1]), (0, 1))))
        axes += count * (alike > MIN_REPEAT_LIKENESS)
    return axes


def _step(a: np.ndarray, b: np.ndarray) -> Float32[np.ndarray, "rows cols"]:
    """The largest difference of a channel."""
    step = np.abs(a - b)
    return np.asarray(np.maximum(np.maximum(step[..., 0], step[..., 1]), step[..., 2]))


def _correlation(a: np.ndarray, b: np.ndarray) -> Float32[np.ndarray, "rows cols"]:
    """Normalised correlation of windows of grey values; -1 where either has too little contrast."""
    mean_a, mean_b, mean_ab = cv2.blur(a, WINDOW), cv2.blur(b, WINDOW), cv2.blur(a * b, WINDOW)
    variances = cv2.blur(a * a, WINDOW) - mean_a**2, cv2.blur(b * b, WINDOW) - mean_b**2
    is_textured = np.minimum(*variances) > MIN_GROUND_CONTRAST**2
    scale = np.sqrt(np.maximum(variances[0] * variances[1], 1e-12))
    return np.asarray(np.where(is_textured, (mean_ab - mean_a * mean_b) / scale, -1.0), np.float32)


def _likeness(one: NadirMap, other: NadirMap, shift: tuple[int, int]) -> Float32[np.ndarray, "rows cols"]:
    """Of windows of a map and another, moved: 1: equal colours, 0: they differ as they vary, -1: without contrast."""
    step = one.image - np.roll(other.image, shift, (0, 1))
    variance = np.roll(other.variance, shift, (0, 1))
    difference = cv2.blur(np.einsum("ijk,ijk->ij", step, step), WINDOW)
    is_textured = np.minimum(one.variance, variance) > 3.0 * MIN_OBJECT_CONTRAST**2
    likeness = 1.0 - difference / np.maximum(one.variance + variance, 1e-12)
    return np.asarray(np.where(is_textured, likeness, -1.0), np.float32)
