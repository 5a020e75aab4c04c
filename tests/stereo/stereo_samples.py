"""A room and a landscape whose panoramas and depths are closed formulas."""

import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import View

SIZE = (192, 384)
HALF_ROOM = np.array([4.0, 1.6, 5.0])
OPENINGS = {
    "level": Pose(np.eye(3), np.array([0.4, 0.1, -0.9])),
    "vertical": Pose(np.eye(3), np.array([0.0, 0.7, 0.0])),
    "oblique and turned": Pose(rotation_from_heading(0.8, 0.2, -0.1), np.array([-0.7, 0.4, 0.5])),
}


def texture(point: np.ndarray) -> np.ndarray:
    """RGB in [0, 1] of points in space: waves of many lengths and directions, nowhere repeating."""
    rng = np.random.default_rng(5)
    value = np.zeros((*point.shape[:-1], 3))
    for scale in (1.5, 3.0, 6.0, 12.0):
        for _ in range(3):
            wave, phase = rng.normal(size=3) * scale, rng.uniform(0, 6.28, size=3)
            value += np.sin((point @ wave)[..., None] + phase) / scale**0.5
    return 0.5 + 0.5 * np.tanh(value)


def room(pose: Pose, size: tuple[int, int] = SIZE, *, blank_ceiling: bool = False) -> tuple[View, np.ndarray]:
    ray = pixel_directions(*size) @ pose.rotation.T
    with np.errstate(divide="ignore"):
        depth = ((np.sign(ray) * HALF_ROOM - pose.position) / ray).min(axis=-1)
    point = pose.position + depth[..., None] * ray
    image = texture(point)
    if blank_ceiling:
        image[point[..., 1] > HALF_ROOM[1] - 1e-6] = 0.97
    return View(image.astype(np.float32), pose), 1.0 / depth


def landscape(pose: Pose, size: tuple[int, int] = SIZE) -> tuple[View, np.ndarray]:
    """View and inverse depth of an endless plain 1.6 m below the origin under a cloudy sky."""
    ray = pixel_directions(*size) @ pose.rotation.T
    inverse_depth = np.maximum(-ray[..., 1], 0.0) / (1.6 + pose.position[1])
    point = pose.position + ray / np.maximum(inverse_depth, 1e-3)[..., None]
    is_ground = inverse_depth > 0
    clouds = 0.6 + 0.4 * texture(ray * 1.5)
    return View(np.where(is_ground[..., None], texture(point), clouds).astype(np.float32), pose), inverse_depth
