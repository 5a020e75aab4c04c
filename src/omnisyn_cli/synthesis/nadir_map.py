"""A panorama around its nadir, in a map whose pixels have equal angles, and where another panorama shows its ground."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.geometry.pose import rotation_from_heading
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.types import View

MAP_SIZE, MAP_DEG = 200, 70.0  # rows of a map, and the angle from the nadir to the middle of its sides
DEG_PER_PIXEL = 2.0 * MAP_DEG / MAP_SIZE  # of a map: 0.7°
PICTURE_ROWS = 256  # rows to which pictures are reduced before: as fine as the map
WINDOW = (9, 9)  # Windows of the map that are compared
GROUND_HEIGHTS = np.geomspace(0.15, 3.5, 34)  # heights of the camera above the ground that are tried, in baselines

Mask = Bool[np.ndarray, "rows cols"]


@dataclass(frozen=True)
class NadirMap:
    """A panorama around its nadir."""

    # RGB, and its mean over the channels
    image: Float32[np.ndarray, "rows cols 3"]
    usable: Mask  # where it may be used
    directions: Float[np.ndarray, "rows cols 3"]  # of its pixels, in the frame of the camera
    turn: Float[np.ndarray, "3 3"]  # rotation about the vertical that takes the map's frame to that of the camera
    grey: Float32[np.ndarray, "rows cols"]
    variance: Float32[np.ndarray, "rows cols"]  # of the colours in windows, summed over channels

    @staticmethod
    def of(view: View, turn: Float[np.ndarray, "3 3"]) -> "NadirMap":
        """Of a view, turned; at most as fine as its picture."""
        x, y = map_degrees()
        angle, azimuth = np.radians(np.hypot(x, y)), np.arctan2(x, -y)
        directions = np.stack([np.sin(angle) * np.sin(azimuth), -np.cos(angle), -np.sin(angle) * np.cos(azimuth)], -1)
        directions = directions @ turn.T
        height = min(view.image.shape[0], PICTURE_ROWS)
        size = (height, 2 * height)
        small = cv2.resize(np.asarray(view.image, np.float32), size[::-1], interpolation=cv2.INTER_AREA)
        row, col = direction_to_pixel(directions, size)
        image = look_up(np.concatenate([small, small[:, :1]], axis=1), col % size[1], np.minimum(row, height - 1))
        usable = np.ones(image.shape[:2], bool)
        if view.mask is not None:
            mask = cv2.resize(view.mask.astype(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST)
            usable = mask[np.clip(np.rint(row), 0, height - 1).astype(int), np.rint(col).astype(int) % size[1]] > 0
        variance = (cv2.blur(image * image, WINDOW) - cv2.blur(image, WINDOW) ** 2) @ np.ones(3, np.float32)
        return NadirMap(image, usable, directions, turn, image @ np.full(3, 1.0 / 3.0, np.float32), variance)


def map_degrees() -> tuple[np.ndarray, np.ndarray]:
    """Degrees to the right and down of the nadir."""
    axis = (np.arange(MAP_SIZE) + 0.5) * DEG_PER_PIXEL - MAP_DEG
    x, y = np.meshgrid(axis, axis)
    return x, y


def morphed(mask: Mask, operation: int, reach: int) -> Mask:
    """A morphological operation of OpenCV by a disc of so many pixels around its middle."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), operation, disc) > 0)


def turn_along(way: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """The turn of maps in which a camera moves up, whatever the seam of its panorama; ``way`` is in its own frame."""
    return rotation_from_heading(float(np.arctan2(way[0], -way[2])))


def to_map(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of a map that show directions, in the frame of the map."""
    across = np.hypot(direction[..., 0], direction[..., 2])
    scale = np.degrees(np.arctan2(across, -direction[..., 1])) / np.maximum(across, 1e-9)
    col, row = ((scale * direction[..., k] + MAP_DEG) / DEG_PER_PIXEL - 0.5 for k in (0, 2))
    return col, row


def look_up(image: np.ndarray, col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """The image there; -1 beyond it."""
    at = np.asarray(col, np.float32), np.asarray(row, np.float32)
    return np.asarray(cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(-1.0,) * 3))


def on_sphere(found: Mask, turn: Float[np.ndarray, "3 3"], size: tuple[int, int]) -> Mask:
    """What was found in a turned map, as a mask of the panorama."""
    mask, top = np.zeros(size, bool), int(size[0] * (1.0 - MAP_DEG / 180.0))
    mask[top:] = look_up(found.astype(np.float32), *to_map(pixel_directions(*size)[top:] @ turn)) > 0.5
    return mask


def ground_pixels(own: NadirMap, views: tuple[View, View], height: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of the second view's map that show the ground which the first view's map shows."""
    own_pose, other_pose = views[0].pose, views[1].pose
    world = own.directions @ own_pose.rotation.T
    point = world * (height / np.maximum(-world[..., 1:2], 1e-3)) + own_pose.position - other_pose.position
    col, row = to_map(point @ other_pose.rotation @ own.turn)
    is_below = world[..., 1] < -0.1
    return np.where(is_below, col, -MAP_SIZE), np.where(is_below, row, -MAP_SIZE)
