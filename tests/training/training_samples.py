"""Walks in closed form: inside a ball with colours on its wall, seen from a line through it, and a small network."""

import math

import numpy as np

from depth_samples import TINY as TINY
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.training.data import Walk, save_samples


def ball_scene(seed=0, size=(64, 128), along=(0.0, 0.4, 1.0), radius=2.0):
    """Views straight ahead, off centre."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-0.5, 0.5, 3) - np.array([0.0, 0.0, 0.5])
    positions = [(0.0, 0.0, -ahead) for ahead in along]
    return Walk(*ball_views(positions, centre, radius, size, rng), np.array(positions, np.float32))


def ball_walk(seed=0, size=(64, 128), radius=2.0, positions=((0, 0, 0), (0.3, 0.05, 0.1), (0.9, 0.1, -0.6))):
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-0.4, 0.4, 3)
    views = ball_views(positions, centre, radius, size, rng)
    return Walk(*views, np.array(positions, np.float32), is_mesh=bool(seed % 2))


def ball_views(positions, centre, radius, size, rng):
    """Pictures and inverse depths from within a ball; the wall's colours are waves in space."""
    waves, phases = rng.normal(0.0, 2.5, (3, 4, 3)), rng.uniform(0, 2 * math.pi, (3, 4))
    directions = pixel_directions(*size)
    images, inverse_depths = [], []
    for position in np.array(positions, np.float64):
        offset = position - centre
        slope = directions @ offset
        depth = -slope + np.sqrt(slope**2 - offset @ offset + radius**2)
        points = offset + depth[..., None] * directions
        colours = 0.5 + 0.12 * np.sin(np.einsum("hwi,cki->hwck", points, waves) + phases).sum(axis=-1)
        images.append((colours.clip(0, 1) * 255 + 0.5).astype(np.uint8))
        inverse_depths.append(1.0 / depth)
    return np.stack(images), np.stack(inverse_depths).astype(np.float16)


def make_pool(folder, scenes=2, **options):
    for seed in range(scenes):
        save_samples(folder / f"{seed:08d}.npz", [ball_scene(seed, **options)])
    return folder


def make_walks(folder, count=2, **options):
    for seed in range(count):
        save_samples(folder / f"{seed:08d}.npz", [ball_walk(seed, **options)])
    return folder
