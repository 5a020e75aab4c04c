"""A ball in a great hollow ball, seen from anywhere: what is hit, and what of it another place sees, in closed form."""

import numpy as np

from omnisyn_cli.geometry.sphere import pixel_directions

RADIUS, AROUND = 0.5, 4.0
CENTRE = np.array([0.0, 0.0, -1.2])


def hits(origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances along unit rays to the front of the ball (infinite if missed) and to the hollow ball."""
    near, far = _roots(origin - CENTRE, directions, RADIUS), _roots(origin, directions, AROUND)
    return np.where((near[0] > 1e-6) & ~np.isnan(near[0]), near[0], np.inf), far[1]


def _roots(origin: np.ndarray, directions: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    along, beyond = (directions * origin).sum(axis=-1), (origin * origin).sum() - radius**2
    with np.errstate(invalid="ignore"):
        half = np.sqrt(along**2 - beyond)
    return -along - half, -along + half


def inverse_depth(position: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """As exact as float32 is; cameras are not turned."""
    return (1.0 / np.minimum(*hits(position, pixel_directions(*size)))).astype(np.float32)


def seen_by(view: np.ndarray, target: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Inverse depth at a target of the first thing on every ray that a view sees from its front; −1 where none."""
    directions = pixel_directions(*size)
    ball, hollow = hits(target, directions)
    shown = np.full(size, -1.0)
    for distance in (hollow, ball):  # what is nearer is written last
        points = target + np.where(np.isfinite(distance), distance, 1.0)[..., None] * directions
        away = points - view
        length = np.linalg.norm(away, axis=-1)
        first = np.minimum(*hits(view, away / length[..., None]))
        shown = np.where(np.isfinite(distance) & (first > length - 1e-6), 1.0 / distance, shown)
    return shown
