"""Walks in closed form: inside a ball with colours on its wall."""

import math

import numpy as np

from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.training.walks import Walk, save_walk


def ball_walk(seed=0, size=(64, 128), radius=2.0, positions=((0, 0, 0), (0.3, 0.05, 0.1), (0.9, 0.1, -0.6))):
    """Views from within; the wall's colours are waves in space."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-0.4, 0.4, 3)
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
    return Walk(np.stack(images), np.stack(inverse_depths), np.array(positions, np.float32), is_mesh=bool(seed % 2))


def write_walk(path, seed):
    """What a run takes as the maker of its scenes."""
    save_walk(path, ball_walk(seed))


def make_walks(folder, count=2, **options):
    for seed in range(count):
        save_walk(folder / f"{seed:08d}.npz", ball_walk(seed, **options))
    return folder
