"""Points that two panoramas have in common, as pairs of directions.

An equirectangular image is stretched without bound at its poles. It is therefore looked at three times, as a band
around the great circle orthogonal to each axis; a direction belongs to the band whose circle is nearest, at most 35.3°
away, where nothing is stretched by more than 1.23. The bands close in themselves, so there is neither pole nor seam.

Where few matches are found, walls and floors are rectified by gravity. A wall that is near one camera and seen
obliquely by the other is squeezed horizontally there. The levelled panorama is therefore searched twice, once at half
its width. The floor is searched as a bird sees it: nearly the same picture from both cameras, while their own views
foreshorten it differently.

Source: Morel and Yu, ASIFT: a new framework for fully affine invariant image comparison, 2009, whose tilts are reduced
to those that gravity leaves.
"""

import math
from dataclasses import dataclass
from functools import lru_cache, reduce
from itertools import product
from operator import add

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.geometry.pose import rotation_taking
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import UP, angles_to_pixel, normalize, pixel_scale, pixel_to_direction

MAX_IMAGE_ROWS = 1024  # Larger panoramas are reduced to this height: features are then found within about 0.05°

# Points that are looked for in a flat image, and features of a panorama; matching takes time with its square.
MAX_SIFT_POINTS, MAX_FEATURES = 10_000, 6000
# Latitude within which every direction lies in one of three orthogonal bands.
BAND_LATITUDE = math.asin(1.0 / math.sqrt(3.0))
BAND_MARGIN = math.radians(9.0)  # Radians around a band that descriptors may reach into
SIFT_CONTRAST_THRESHOLD = 0.02  # OpenCV's default is 0.04; half of it still finds features in plain rooms
LOWE_RATIO = 0.8  # The best match has to be nearer than this share of the distance to the second best one (Lowe, 2004)

INLIER_THRESHOLD_PIXELS = 1.0  # Of the searched image, within which a match agrees with a pose
# Length of descriptors of whole numbers: sums of 128 products stay below 2²⁴, exact in float32 in any order.
DESCRIPTOR_NORM = 512.0
# ``camera_from_band``: three turns of the axes into each other.
CAMERA_FROM_BAND = tuple(
    np.linalg.matrix_power(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), k) for k in range(3)
)

# Rows of the picture that is searched: larger panoramas are reduced to it, smaller ones enlarged by at most this. That
# finds a third more matches in panoramas of 1024 rows.
FINE_ROWS, MAX_ENLARGEMENT = 1536, 1.5
WALL_LATITUDE = math.radians(55.0)  # Radians above and below the horizon that walls are looked for in
SQUEEZE = 2  # Factor by which the second search narrows walls: those seen at 30° instead of 90°

# Side of the bird's-eye view, and tangent of the largest angle from straight down along its sides.
FLOOR_PIXELS, FLOOR_TANGENT = 600, math.tan(math.radians(68.0))

Picture = Float[np.ndarray, "height width 3"]  # RGB in [0, 1]
Grey = UInt8[np.ndarray, "height width"]
Usable = Bool[np.ndarray, "rows cols"] | None
"""Where a panorama may be used, at any size; None is everywhere."""

FoundPoints = tuple[np.ndarray, ...]
"""``(n, 3)`` directions in the camera's frame, ``(n, 128)`` descriptors and ``(n,)`` responses of SIFT's points."""


@dataclass(frozen=True)
class Features:
    """Distinctive points of one panorama."""

    direction: Float[np.ndarray, "n 3"]  # unit vectors in the camera's frame
    descriptor: Float[np.ndarray, "n 128"]  # float32, whole numbers
    pixel: float  # radians that one pixel of the searched image covers

    def strongest(self, count: int) -> "Features":
        """The first ones; they are sorted by their response."""
        return Features(self.direction[:count], self.descriptor[:count], self.pixel)


@dataclass(frozen=True)
class Matches:
    """What is seen by both panoramas of a pair; some of it is wrong."""

    # unit vectors, each in its own camera's frame
    first: Float[np.ndarray, "n 3"]
    second: Float[np.ndarray, "n 3"]
    pixel: float  # radians of the larger one of the two images' pixels

    def __len__(self) -> int:
        return len(self.first)

    @property
    def tolerance(self) -> float:
        """Radians within which one agrees with a pose: from its epipolar circle, or from where a turn takes it."""
        return INLIER_THRESHOLD_PIXELS * self.pixel

    def __add__(self, other: "Matches") -> "Matches":
        first, second = np.concatenate([self.first, other.first]), np.concatenate([self.second, other.second])
        return Matches(first, second, max(self.pixel, other.pixel))

    def select(self, chosen: np.ndarray) -> "Matches":
        """Those of a mask or of indices."""
        return Matches(self.first[chosen], self.second[chosen], self.pixel)


def find_features(grey: Grey, usable: Usable = None, threads: int | None = None) -> Features:
    """SIFT features of a :func:`grey_of` panorama, the strongest :data:`MAX_FEATURES`; ``threads`` change nothing.

    Source: Lowe, Distinctive image features from scale-invariant keypoints, 2004; descriptors as in Arandjelović and
    Zisserman, Three things everyone should know to improve object retrieval, 2012.
    """
    with limited_threads(threads):
        found = [_band_features(grey, axis) for axis in range(3)]
    every = tuple(np.concatenate(parts) for parts in zip(*found, strict=True))
    return strongest_features(every, usable, 1.0 / pixel_scale(grey.shape)[0], MAX_FEATURES)


def strongest_features(found: FoundPoints, usable: Usable, pixel: float, count: int) -> Features:
    """At most ``count`` of SIFT's points where the panorama is usable."""
    direction, descriptor, response = found
    if usable is not None:
        kept = np.asarray(sample_nearest(usable.astype(np.float32), direction) > 0)
        direction, descriptor, response = direction[kept], descriptor[kept], response[kept]
    strongest = np.argsort(-response, kind="stable")[:count]
    descriptor = descriptor[strongest]
    total = descriptor.sum(axis=1, keepdims=True)
    share = descriptor / np.where(total > 0, total, 1.0)
    # roots of shares (Hellinger's distance instead of Euclid's), as whole numbers
    return Features(direction[strongest], np.asarray(np.rint(np.sqrt(share) * DESCRIPTOR_NORM), np.float32), pixel)


def match_features(first: Features, second: Features) -> Matches:
    """Pairs of features that are each other's best match, and clearly so."""
    pixel = max(first.pixel, second.pixel)
    if min(len(first.direction), len(second.direction)) < 2:
        return Matches(np.zeros((0, 3)), np.zeros((0, 3)), pixel)
    similarity = first.descriptor @ second.descriptor.T
    best = np.argmax(similarity, axis=1)
    every = np.arange(len(best))
    top = similarity[every, best]
    is_mutual = top == similarity.max(axis=0)[best]
    similarity[every, best] = -np.inf
    nearest, runner_up = (2.0 * (DESCRIPTOR_NORM**2 - each).clip(0.0) for each in (top, similarity.max(axis=1)))
    chosen = np.flatnonzero(is_mutual & (nearest < LOWE_RATIO**2 * runner_up))
    return Matches(first.direction[chosen], second.direction[best[chosen]], pixel)


def grey_of(image: Picture, max_rows: int = MAX_IMAGE_ROWS) -> Grey:
    """Luma of a panorama as uint8, at most so many rows high."""
    luma: np.ndarray = np.asarray(image, np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    if len(luma) > max_rows:
        luma = cv2.resize(luma, (2 * max_rows, max_rows), interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(luma.clip(0.0, 1.0) * 255.0), np.uint8)


def _band_features(grey: np.ndarray, axis: int) -> FoundPoints:
    """Those that belong to one band."""
    _, width = size = (grey.shape[0], grey.shape[1])
    table, top, wrap = band_table(size, axis)
    place, descriptor, response = detect_sift(table.bilinear(grey))
    place += np.array([-wrap, top])
    direction = pixel_to_direction(place[:, 1], place[:, 0], size)
    is_inside = (place[:, 0] >= -0.5) & (place[:, 0] < width - 0.5) & (np.argmin(np.abs(direction), axis=1) == 1)
    return direction[is_inside] @ CAMERA_FROM_BAND[axis].T, descriptor[is_inside], response[is_inside]


@lru_cache(maxsize=3)
def band_table(size: tuple[int, int], axis: int) -> tuple[RemapTable, int, int]:
    """Where a band is in images of a size; its first row, and the columns that are repeated on both sides."""
    directions, top, wrap = band_directions(size, BAND_LATITUDE + BAND_MARGIN)
    return RemapTable.for_directions(directions @ CAMERA_FROM_BAND[axis].T, size), top, wrap


def band_directions(size: tuple[int, int], latitude: float) -> tuple[Float[np.ndarray, "rows cols 3"], int, int]:
    """Of pixels up to a latitude; the first row; columns repeated on both sides, so that the seam has no features."""
    height, width = size
    edge, _ = angles_to_pixel(0.0, math.acos(math.sin(latitude)), size)
    top, wrap = max(math.floor(edge), 0), width // 16
    row, col = np.arange(top, height - top)[:, None], np.arange(-wrap, width + wrap)[None, :]
    return pixel_to_direction(row.astype(float), col.astype(float), size), top, wrap


def detect_sift(image: Grey) -> FoundPoints:
    """Column and row ``(n, 2)``, descriptor and response of SIFT's points in a flat image."""
    threshold = SIFT_CONTRAST_THRESHOLD
    sift = cv2.SIFT.create(nfeatures=MAX_SIFT_POINTS, contrastThreshold=threshold, enable_precise_upscale=True)
    points, descriptor = sift.detectAndCompute(image, None)
    if not points:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0)
    return np.array([p.pt for p in points], float), descriptor, np.array([p.response for p in points])


@dataclass(frozen=True)
class LevelledFeatures:
    """Features of one panorama, in the camera's frame."""

    walls: Features  # of the levelled panorama
    squeezed_walls: Features  # of the same at half its width
    floor: Features  # of the bird's-eye view


def fine_grey_of(image: Picture) -> Grey:
    """The picture of a panorama that :func:`find_levelled_features` searches."""
    rows = min(FINE_ROWS, round(MAX_ENLARGEMENT * image.shape[0]))
    grey = grey_of(image, rows)
    return np.asarray(cv2.resize(grey, (2 * rows, rows), interpolation=cv2.INTER_CUBIC))


def find_levelled_features(
    grey: Grey, up: Float[np.ndarray, " 3"], usable: Usable = None, threads: int | None = None
) -> LevelledFeatures:
    """Features of a panorama in grey whose zenith is ``up``."""
    level_from_camera = rotation_taking(up, UP)
    with limited_threads(threads):
        views = (_walls(grey, level_from_camera, 1), _walls(grey, level_from_camera, SQUEEZE))
        found = (*views, _floor(grey, level_from_camera))
    pixel = 1.0 / pixel_scale(grey.shape)[0]
    return LevelledFeatures(*(strongest_features(each, usable, pixel, MAX_SIFT_POINTS) for each in found))


def match_levelled_features(first: LevelledFeatures, second: LevelledFeatures) -> Matches:
    """Walls with walls, squeezed or not in either panorama, and floor with floor."""
    walls = product((second.walls, second.squeezed_walls), (first.walls, first.squeezed_walls))
    found = [match_features(of_first, of_second) for of_second, of_first in walls]
    return reduce(add, [*found, match_features(first.floor, second.floor)])


def _walls(grey: np.ndarray, level_from_camera: np.ndarray, squeeze: int) -> FoundPoints:
    _, width = size = (grey.shape[0], grey.shape[1])
    directions, top, wrap = band_directions(size, WALL_LATITUDE)
    band = RemapTable.for_directions(directions @ level_from_camera, grey.shape).bilinear(grey)
    narrow = cv2.resize(band, (band.shape[1] // squeeze, band.shape[0]), interpolation=cv2.INTER_AREA)
    place, descriptor, response = detect_sift(narrow)
    col = (place[:, 0] + 0.5) * (band.shape[1] / narrow.shape[1]) - 0.5 - wrap
    is_inside = (col >= -0.5) & (col < width - 0.5)
    direction = pixel_to_direction(place[is_inside, 1] + top, col[is_inside], size)
    return direction @ level_from_camera, descriptor[is_inside], response[is_inside]


def _floor(grey: np.ndarray, level_from_camera: np.ndarray) -> FoundPoints:
    rows, cols = np.mgrid[:FLOOR_PIXELS, :FLOOR_PIXELS]
    view = RemapTable.for_directions(_floor_directions(cols, rows) @ level_from_camera, grey.shape).bilinear(grey)
    place, descriptor, response = detect_sift(view)
    return _floor_directions(place[:, 0], place[:, 1]) @ level_from_camera, descriptor, response


def _floor_directions(col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Directions of places in the bird's-eye view, of which the right is +x and the top is −z."""
    x, z = (((place + 0.5) / FLOOR_PIXELS * 2.0 - 1.0) * FLOOR_TANGENT for place in (col, row))
    return np.asarray(normalize(np.stack([x, -np.ones_like(x), z], axis=-1)))
