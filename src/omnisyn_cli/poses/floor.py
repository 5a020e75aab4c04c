"""How far below a camera the floor is: what a known height of the camera makes metres of."""

import math

import numpy as np

from omnisyn_cli.geometry.pose import at_same_position
from omnisyn_cli.stereo.plane_sweep import sweep_planes
from omnisyn_cli.stereo.rectify import rectify
from omnisyn_cli.types import View

FLOOR_SIZE = (256, 512)
"""Height and width of the pair in which planes are found: twice that of the sweep, for the fit."""

MAX_FLOOR_SLOPE = math.radians(15.0)
"""Radians by which the normal of a floor may be off the vertical."""


def floor_distance(first: View, second: View) -> float | None:
    """Distance of the first camera from the lowest level plane that both panoramas see; None if there is none.

    In the unit of the positions.
    """
    if at_same_position(first.pose, second.pose):
        return None
    pair = rectify(first, second, FLOOR_SIZE)
    planes = sweep_planes(pair, pair.grid.up[None])
    lengths = np.linalg.norm(planes, axis=1)
    is_floor = -planes @ pair.grid.up > math.cos(MAX_FLOOR_SLOPE) * lengths
    return float((pair.baseline / lengths[is_floor]).max()) if is_floor.any() else None
