"""Planes of the depth that a network expects, moved to where the images match best.

A sweep finds a plane if enough windows match on it, wherever it is. Far apart, cameras see walls too differently for
that. The network says where planes are to within some 10 %, and so near a plane a linear fit finds the rest.
"""

from functools import partial

import numpy as np
from jaxtyping import Float

from omnisyn_cli.stereo.depth_prior import DepthPrior
from omnisyn_cli.stereo.epipolar_grid import EpipolarGrid
from omnisyn_cli.stereo.plane_fitting import PlanePoints, are_near, find_planes
from omnisyn_cli.stereo.plane_sweep import Directions, fit_plane
from omnisyn_cli.stereo.rectify import RectifiedPair

EXPECTED_SIZE = (64, 128)  # rows and columns of the expected depth that planes are fitted to
MIN_CONFIDENCE, MIN_INVERSE_DEPTH = 0.4, 0.02  # of the pixels that take part; the second in 1/baselines
RELATIVE_TOLERANCE = 0.05  # of inverse depth, for pixels of a plane
# The number of planes, and the share of the pixels' solid angle that each has to explain.
MAX_PLANES, MIN_SUPPORT = 16, 0.004
# A fitted plane that turns by more than 14° or moves by more than a quarter has gone to another surface.
MIN_PARALLEL_COSINE, MAX_DISTANCE_FACTOR = 0.97, 1.25

# An expected floor or ceiling nearer to a swept one is that one, less exactly. On 31 wide walks 1.1 % more of what is
# below the horizon is within 5 % without such copies. Walls may stand that near each other: homes lose without them.
MAX_FLOOR_DISTANCE_FACTOR = 1.4


def expected_planes(
    pair: RectifiedPair, directions: tuple[Directions, Directions], swept: Float[np.ndarray, "swept 3"]
) -> Float[np.ndarray, "planes 3"]:
    """Normals in the frame of the pair, best supported first; none where nothing is expected.

    A plane that no texture can move stays where it is expected. The sweep had these directions, and found ``swept``.
    """
    small = pair if pair.priors is None else pair.resized(EXPECTED_SIZE)
    if small.priors is None:
        return np.zeros((0, 3))
    points = _points(small.grid, small.priors[0]), _points(small.reversed().grid, small.priors[1])
    expected = find_planes(points, pair.grid.up, max_planes=MAX_PLANES, min_support=MIN_SUPPORT)
    fitted = [fit_plane(directions, normal) for normal in expected]
    planes = [
        after if are_near(before, after, MIN_PARALLEL_COSINE, MAX_DISTANCE_FACTOR) else before
        for before, after in zip(expected, fitted, strict=True)
    ]
    floors = [plane for plane in swept if abs(plane @ pair.grid.up) > MIN_PARALLEL_COSINE * np.linalg.norm(plane)]
    near_floor = partial(are_near, min_cosine=MIN_PARALLEL_COSINE, distance_factor=MAX_FLOOR_DISTANCE_FACTOR)
    return np.reshape([plane for plane in planes if not any(near_floor(floor, plane) for floor in floors)], (-1, 3))


def _points(grid: EpipolarGrid, prior: DepthPrior) -> PlanePoints:
    """The pixels of a grid that the network is sure of."""
    inverse_depth = np.square(prior.sqrt_inv_depth, dtype=np.float64)
    row, col = np.nonzero((prior.confidence > MIN_CONFIDENCE) & (inverse_depth > MIN_INVERSE_DEPTH))
    found = inverse_depth[row, col]
    solid_angle = np.sin(grid.polar_angle[row, 0])
    return PlanePoints(grid.directions[row, col], found, RELATIVE_TOLERANCE * found, solid_angle, row, col)
