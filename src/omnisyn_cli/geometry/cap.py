"""Pixels around a direction."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool

from omnisyn_cli.geometry.sphere import direction_tables

__all__ = ["outside_nadir"]


def outside_nadir(size: tuple[int, int], angle: float) -> Bool[np.ndarray, "height width"]:
    """True where a panorama looks farther than ``angle`` radians away from its own straight down.

    Its own: the last row of the image, whatever the pose says, because a tripod and the roof of a car turn with the
    camera. With an angle of 0 it is True everywhere.
    """
    cos_polar = direction_tables(*size)[1]
    rows = np.asarray(-cos_polar <= math.cos(angle)) if angle > 0.0 else np.ones(size[0], bool)
    return np.repeat(rows[:, None], size[1], axis=1)
