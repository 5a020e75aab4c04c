"""What a network says about the depth of one panorama: of the whole, or of perspective pictures of it that overlap."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.geometry.perspective import PerspectiveSize, cell_directions
from omnisyn_cli.geometry.pose import rotation_from_heading
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import rotated_image, sample_bilinear
from omnisyn_cli.types import View

PICTURE_FOV = math.radians(90.0)  # angle that perspective pictures see, the smaller one of width and height
ELEVATIONS = ((0.0, 6), (50.0, 4), (-50.0, 4))  # degrees above the horizon, and how many pictures look there all around


class Reading(NamedTuple):
    """What the numbers of an answer are: a power of depth, or with a power of 0 its logarithm."""

    power: int

    def of_log(self, log_inverse: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
        """The number for a depth, given the logarithm of its inverse."""
        return np.asarray(np.exp(-self.power * log_inverse) if self.power else -log_inverse)

    def to_log(self, number: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
        """The logarithm of inverse depth; numbers that no depth has count as the smallest that one has."""
        return np.asarray(-np.log(np.maximum(number, 1e-6)) / self.power if self.power else -number)


# By the name that users give them.
READINGS: Mapping[str, Reading] = MappingProxyType(
    {"depth": Reading(1), "inverse-depth": Reading(-1), "log-depth": Reading(0)}
)


class Samples(NamedTuple):
    """What the pictures of a panorama say in some directions."""

    values: Float[np.ndarray, "pictures rows cols"]  # numbers of the network
    weight: Float[np.ndarray, "pictures rows cols"]  # of each in a mean; 0 outside its picture
    # distance per depth: above 1 where depth is counted along the axis of a picture
    stretch: Float[np.ndarray, "pictures rows cols"]


@dataclass(frozen=True)
class MonocularAnswer:
    """What a network says about one panorama, up to a scale and a shift of each picture."""

    maps: Float32[np.ndarray, "pictures rows cols"]  # its numbers; one map where it sees the whole panorama
    world_from_picture: Float[np.ndarray, "pictures 3 3"]  # orientations
    readings: tuple[str, ...] = tuple(READINGS)  # names in :data:`READINGS` that the numbers may have
    # half the height and width of perspective pictures on the plane at distance 1; None for panoramas
    half_extent: tuple[float, float] | None = None
    is_distance: bool = True  # whether depth is counted along the rays; in panoramas it always is

    def at(self, directions: Float[np.ndarray, "rows cols 3"]) -> Samples:
        """What it says in directions of the world, given as unit vectors."""
        found = [self._of_picture(*each, directions) for each in zip(self.maps, self.world_from_picture, strict=True)]
        return Samples(*(np.stack(each) for each in zip(*found, strict=True)))

    def _of_picture(
        self, numbers: np.ndarray, rotation: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values, weight and stretch of one picture."""
        seen = directions @ rotation
        if self.half_extent is None:
            values = np.asarray(sample_bilinear(numbers, seen), np.float64)
            return values, np.ones_like(values), np.ones_like(values)
        ahead = np.maximum(-seen[..., 2], 1e-6)
        down, across = self.half_extent
        y, x = seen[..., 1] / ahead / down, seen[..., 0] / ahead / across
        (rows, cols) = numbers.shape
        col, row = (0.5 * (x + 1.0) * cols - 0.5), (0.5 * (1.0 - y) * rows - 0.5)
        maps = np.asarray(col, np.float32), np.asarray(row, np.float32)
        values = cv2.remap(numbers, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
        weight = np.clip(1.0 - np.abs(x), 0.0, None) * np.clip(1.0 - np.abs(y), 0.0, None) * (seen[..., 2] < 0.0)
        return values, weight, np.ones_like(ahead) if self.is_distance else 1.0 / ahead


class PictureNetwork(Protocol):
    """A network that says something about the depth of one picture, however it is run."""

    size: tuple[int, int]  # height and width of its pictures
    is_panoramic: bool  # whether they are panoramas; else they are perspective ones

    def __call__(self, picture: Float32[np.ndarray, "3 height width"]) -> tuple[np.ndarray, tuple[str, ...], bool]:
        """Its numbers ``(rows, cols)``, the readings that they may have, and whether they are distances along rays."""
        ...


@dataclass(frozen=True)
class MonocularModel:
    """Asks a network about panoramas."""

    network: PictureNetwork  # which

    def __call__(self, view: View) -> MonocularAnswer:
        """What it says about a panorama, which it sees upright."""
        is_panoramic, size = self.network.is_panoramic, self.network.size
        rotations = np.eye(3)[None] if is_panoramic else picture_rotations()
        half_extent = None if is_panoramic else perspective_size(size).half_extent
        maps, readings, are_distances = zip(*map(self.network, pictures_of(view, size, is_panoramic)), strict=True)
        is_distance = is_panoramic or are_distances[0]
        return MonocularAnswer(np.stack(maps), rotations, readings[0], half_extent, is_distance)


def pictures_of(view: View, size: tuple[int, int], is_panoramic: bool) -> Iterator[Float32[np.ndarray, "3 rows cols"]]:
    """What a network of pictures of a size is asked about a panorama."""
    if is_panoramic:
        pictures = [rotated_image(view.image, view.pose.rotation, np.eye(3), size)]
    else:
        pictures = perspective_pictures(view, picture_rotations(), perspective_size(size))
    yield from (np.ascontiguousarray(np.moveaxis(each, -1, 0)) for each in pictures)


def perspective_size(size: tuple[int, int]) -> PerspectiveSize:
    """Of pictures that see :data:`PICTURE_FOV` along their shorter side."""
    across = size[1] / min(size) * math.tan(PICTURE_FOV / 2.0)
    return PerspectiveSize(*size, 2.0 * math.atan(across))


def picture_rotations() -> Float[np.ndarray, "pictures 3 3"]:
    """World from picture of all pictures of a panorama: upright, they look along −z and have +y up."""
    found = []
    for elevation, count in ELEVATIONS:
        headings = 2.0 * np.pi * np.arange(count) / count
        found += [rotation_from_heading(heading, math.radians(elevation)) for heading in headings]
    return np.stack(found)


def perspective_pictures(view: View, rotations: np.ndarray, size: PerspectiveSize) -> list[np.ndarray]:
    """What pictures of these orientations show of a panorama: RGB in [0, 1]."""
    rows = 2 * min(size)
    image = resize_area(view.image, (rows, 2 * rows)) if view.image.shape[0] > rows else view.image
    rays = cell_directions(size, (size[0], size[1]))
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    in_camera = (rays @ (view.pose.rotation.T @ each).T for each in rotations)
    return [np.asarray(sample_bilinear(image, directions), np.float32) for directions in in_camera]
