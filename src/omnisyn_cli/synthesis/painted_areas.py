"""Painted areas: an operator painted over in one colour, or bands beside a panorama that is a part of the sphere.

Paint has exactly one colour, even after JPEG, and ends in an edge; surfaces with light or grain on them do not. It is
the colour at the nadir of both panoramas. A plain floor of a rendered scene looks the same, but it moves as ground does
when the camera moves, where paint keeps its place. Bands are whole rows and columns.
"""

import cv2
import numpy as np
from jaxtyping import UInt8

from omnisyn_cli.geometry.pose import distance_between
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.synthesis.nadir_map import GROUND_HEIGHTS, Mask, NadirMap, ground_pixels, look_up, morphed
from omnisyn_cli.types import View

MAX_ROWS = 1024  # rows of a picture that are looked at. Set by hand, as are all constants of this file.
# Share of the rows that are at the nadir or zenith, and share of their pixels that have the colour of paint.
POLE_SHARE, MIN_COLOUR_SHARE = 0.03, 0.5
# Noise of JPEG in levels of 255, and the share of an area that has none: .95 of paint, .3 of the plainest surfaces.
TOLERANCE, MIN_EXACT_SHARE = 2, 0.8
# Half the width of the narrowest area, and what is left out around it: JPEG spoils pixels beside an edge.
OPENING_PIXELS, MARGIN_PIXELS = 2, 3
# Shares of the sphere: of the least area, of all, and of the largest hole in paint that goes too.
MIN_AREA, MAX_AREA, MAX_HOLE = 0.0005, 0.15, 0.005
# Where pixels beside an area must have other colours, by how many levels, and how many of them.
RING_PIXELS, MIN_EDGE_STEP, MIN_EDGE_SHARE = 6, 10, 0.35
# Overlap in place of what is paint, by how much more a floor overlaps, and the overlap that needs no such lead.
MIN_IN_PLACE, MIN_FLOOR_LEAD, MIN_FLOOR_OVERLAP = 0.35, 0.1, 0.8
# Heights of the camera above a floor, in baselines.
FLOOR_HEIGHTS = np.concatenate([GROUND_HEIGHTS, np.geomspace(4.0, 12.0, 8)])
JPEG_BLOCK = 16  # rows before an edge that its noise can reach
# Share of the rows that a band may have, as skies end at the horizon, and share of a column that has its colour.
MAX_BAND_SHARE, MIN_COLUMN_SHARE = 0.47, 0.98


def find_painted(views: tuple[View, View], maps: tuple[NadirMap, NadirMap]) -> tuple[Mask, Mask]:
    """Pixels of both views, each at its own size, that are painted in the same colour."""
    pictures = [_reduced(view) for view in views]
    found = [np.zeros(picture.shape[:2], bool) for picture, _ in pictures]
    for find_areas in (_areas_at_nadir, _band_at_nadir, _band_at_zenith):
        areas = [find_areas(*picture) for picture in pictures]
        if areas[0] is None or areas[1] is None or not _has_colour(areas[0][1][None, None], areas[1][1]).all():
            continue
        painted = areas[0][0], areas[1][0]
        if find_areas is not _areas_at_nadir or _keeps_its_place(painted, maps, views):
            found = [before | now for before, now in zip(found, painted, strict=True)]
    grown = (_morphed(mask, cv2.MORPH_DILATE, MARGIN_PIXELS) for mask in found)
    first, second = (_at_size(mask, view.image.shape[:2]) for mask, view in zip(grown, views, strict=True))
    return first, second


def _reduced(view: View) -> tuple[UInt8[np.ndarray, "rows cols 3"], Mask]:
    """Some of the pixels, as they are but in levels of 255, and which of them may be used."""
    height = min(view.image.shape[0], MAX_ROWS)
    size = (2 * height, height)
    image = cv2.resize(np.asarray(view.image, np.float32), size, interpolation=cv2.INTER_NEAREST)
    image = np.rint(np.clip(image, 0.0, 1.0) * np.float32(255.0)).astype(np.uint8)
    usable = np.ones(image.shape[:2], bool) if view.mask is None else _at_size(view.mask, (height, 2 * height))
    return image, usable


def _at_size(mask: Mask, size: tuple[int, ...]) -> Mask:
    return np.asarray(cv2.resize(mask.astype(np.uint8), (size[1], size[0]), interpolation=cv2.INTER_NEAREST) > 0)


def _areas_at_nadir(image: np.ndarray, usable: Mask) -> tuple[Mask, np.ndarray] | None:
    """Areas of the colour at the nadir that can be paint, and that colour; None without any."""
    rows = max(1, round(POLE_SHARE * len(image)))
    if (colour := _colour_of(image[-rows:][usable[-rows:]])) is None:
        return None
    near = usable & _has_colour(image, colour)
    label = connected_regions(_morphed(near, cv2.MORPH_OPEN, OPENING_PIXELS), is_diagonal=True)
    count, area = int(label.max()) + 1, solid_angles(*label.shape)
    area /= area.sum()
    exact = np.bincount(label.ravel(), _has_colour(image, colour, 0).ravel(), count)
    is_kept = np.bincount(label.ravel(), area.ravel(), count) >= MIN_AREA
    is_kept &= exact >= MIN_EXACT_SHARE * np.bincount(label.ravel(), minlength=count)
    if colour.max() <= TOLERANCE or colour.min() >= 255 - TOLERANCE:  # lamps, windows and the dark have it too
        is_kept &= np.isin(np.arange(count), label[-1])
    is_kept[0] = False
    painted = is_kept[label]
    if not painted.any() or area[painted].sum() > MAX_AREA:
        return None
    wide, narrow = (_morphed(painted, cv2.MORPH_DILATE, reach) for reach in (RING_PIXELS, RING_PIXELS // 2))
    is_edge = ~_has_colour(image, colour, MIN_EDGE_STEP)[wide & ~narrow & usable & ~near]
    if is_edge.sum() < MIN_EDGE_SHARE * max(len(is_edge), 1):
        return None
    rest = connected_regions(~painted, is_diagonal=False)
    is_hole = np.bincount(rest.ravel(), area.ravel()) < MAX_HOLE
    return painted | is_hole[rest], colour


def _band_at_zenith(image: np.ndarray, usable: Mask) -> tuple[Mask, np.ndarray] | None:
    """Whole rows of one colour from the zenith to a straight edge, whole columns too, and that colour; None without."""
    rows = max(1, round(POLE_SHARE * len(image)))
    if (colour := _colour_of(image[:rows][usable[:rows]])) is None:
        return None
    band = _has_colour(image, colour)
    columns, count = band.mean(axis=0) > MIN_COLUMN_SHARE, int(np.argmin(band.all(axis=1)))
    if not rows < count < MAX_BAND_SHARE * len(image):
        return None
    count += int(np.argmin(band[count : count + JPEG_BLOCK + 1, ~columns].mean(axis=1) > 0.5))
    is_edge = ~_has_colour(image[count + RING_PIXELS][None], colour, MIN_EDGE_STEP)[0, ~columns]
    is_exact = _has_colour(image[:count], colour, 0)
    if is_edge.mean() < MIN_EDGE_SHARE or is_exact.mean() < MIN_EXACT_SHARE:
        return None
    band[:count], band[count:] = True, columns
    return band, colour


def _band_at_nadir(image: np.ndarray, usable: Mask) -> tuple[Mask, np.ndarray] | None:
    """Likewise from the nadir."""
    found = _band_at_zenith(image[::-1], usable[::-1])
    return None if found is None else (found[0][::-1], found[1])


def _colour_of(pixels: np.ndarray) -> np.ndarray | None:
    """The colour that most of the pixels have; None if they have many."""
    if not len(pixels):
        return None
    codes, counts = np.unique(pixels @ np.array([1 << 16, 1 << 8, 1]), return_counts=True)
    code = int(codes[np.argmax(counts)])
    colour = np.array([code >> 16, code >> 8 & 255, code & 255], np.uint8)
    return colour if _has_colour(pixels[None], colour).mean() >= MIN_COLOUR_SHARE else None


def _has_colour(image: np.ndarray, colour: np.ndarray, tolerance: int = TOLERANCE) -> Mask:
    """Where no channel differs by more than that."""
    low, high = (np.asarray(colour, float) + sign * tolerance for sign in (-1, 1))
    return np.asarray(cv2.inRange(np.ascontiguousarray(image), low, high) > 0)


def _keeps_its_place(areas: tuple[Mask, Mask], maps: tuple[NadirMap, NadirMap], views: tuple[View, View]) -> bool:
    """Whether areas of two panoramas are alike where they are, and less so as parts of a floor at any height."""
    first, second = (
        sample_nearest(area.astype(np.float32), each.directions) for area, each in zip(areas, maps, strict=True)
    )
    in_place = _overlap(first, second)
    baseline = distance_between(views[0].pose, views[1].pose)
    for height in FLOOR_HEIGHTS:
        on_floor = _overlap(first, look_up(second, *ground_pixels(maps[0], views, float(height) * baseline)))
        is_far = height > GROUND_HEIGHTS[-1]
        least = MIN_FLOOR_OVERLAP if is_far else min(in_place + MIN_FLOOR_LEAD, MIN_FLOOR_OVERLAP)
        if on_floor > max(in_place, least):
            return False
    return in_place >= MIN_IN_PLACE


def _overlap(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union of what is above a half, where the second is known."""
    one, other = (first > 0.5) & (second >= 0.0), second > 0.5
    return int(np.count_nonzero(one & other)) / max(int(np.count_nonzero(one | other)), 1)


def _morphed(mask: Mask, operation: int, reach: int) -> Mask:
    """Opened, or with a border, across the seam too."""
    margin = 2 * reach + 1
    around = np.pad(mask, ((0, 0), (margin, margin)), mode="wrap")
    return morphed(around, operation, reach)[:, margin:-margin]
