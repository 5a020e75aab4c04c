"""Walks in closed form: inside a ball with colours on its wall."""

import numpy as np
from training_samples import ball_views

from omnisyn_cli.training.walks import Walk, save_walk


def ball_walk(seed=0, size=(64, 128), radius=2.0, positions=((0, 0, 0), (0.3, 0.05, 0.1), (0.9, 0.1, -0.6))):
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-0.4, 0.4, 3)
    views = ball_views(positions, centre, radius, size, rng)
    return Walk(*views, np.array(positions, np.float32), is_mesh=bool(seed % 2))


def write_walk(path, seed):
    """What a run takes as the maker of its scenes."""
    save_walk(path, ball_walk(seed))


def make_walks(folder, count=2, **options):
    for seed in range(count):
        save_walk(folder / f"{seed:08d}.npz", ball_walk(seed, **options))
    return folder
