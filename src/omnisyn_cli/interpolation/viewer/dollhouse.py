"""A tour from outside: coarse surfaces of all panoramas, without what is far, overhead, or seen better from elsewhere.

The page (``web/dollhouse.js``) makes triangles of them and shows only those that face the eye, so walls and ceilings
are open towards it.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.pose import Pose, distance_between
from omnisyn_cli.geometry.sampling import sample_nearest, window_max
from omnisyn_cli.geometry.sphere import UP, pixel_directions
from omnisyn_cli.geometry.tolerances import SAME_POINT_TOLERANCE
from omnisyn_cli.interpolation.loading import PanoramaSurface
from omnisyn_cli.render.mesh import MASKED_INVERSE_DEPTH

GRID = (80, 160)  # rows and columns of vertices of a panorama: below its ceiling less than 20,000 triangles
MAX_ELEVATION_SINE = math.sin(math.radians(25.0))  # above, there is a ceiling or the sky. Set by hand.
MIN_SHOWN_CONFIDENCE = 0.1  # less is a guess
# How far from its panorama a surface is shown: mean lengths of links, and metres at the least. Set by hand.
REACH_LINKS, MIN_REACH_METRES = 3.0, 8.0
NEARER_SHARE = 0.98  # of the distance, from which on a panorama that sees a place shows it for others


def coarse_surface(surface: PanoramaSurface) -> Float[np.ndarray, "rows cols"]:
    """Inverse depth (1/metre) of a grid of vertices, negative where a panorama has nothing to show."""
    rays = _rays()
    is_hidden = (rays @ surface.view.pose.rotation.T @ UP > MAX_ELEVATION_SINE) | (
        sample_nearest(surface.depth.confidence, rays) < MIN_SHOWN_CONFIDENCE
    )
    return np.where(is_hidden, MASKED_INVERSE_DEPTH, sample_nearest(surface.mesh.inverse_depth, rays))


def stacked_surfaces(
    surfaces: Sequence[Float[np.ndarray, "rows cols"]], poses: Sequence[Pose], links: Sequence[Sequence[int]]
) -> Float[np.ndarray, "all_rows cols"]:
    """The coarse surfaces of all panoramas, one below the other, each place in that which sees it best."""
    mean_link = float(np.mean([distance_between(poses[first], poses[second]) for first, second in links]))
    reach = max(MIN_REACH_METRES, REACH_LINKS * mean_link)
    shown = []
    for index, (rho, pose) in enumerate(zip(surfaces, poses, strict=True)):
        is_near = rho > 1.0 / reach
        depth = 1.0 / rho[is_near]
        points = pose.position + depth[:, None] * (_rays()[is_near] @ pose.rotation.T)
        is_own = np.ones(len(points), bool)
        for other, elsewhere in enumerate(poses):
            if other != index and distance_between(elsewhere, pose) < 2.0 * reach:
                is_own &= ~_sees_better(surfaces[other], elsewhere, points, depth)
        owned = np.zeros(rho.shape, np.float32)
        owned[is_near] = is_own
        is_shown = is_near & (window_max(owned, 1) > 0.0)  # one vertex more, so that nothing is open between both
        shown.append(np.where(is_shown, rho, MASKED_INVERSE_DEPTH))
    return np.concatenate(shown)


def _sees_better(
    rho: Float[np.ndarray, "rows cols"], pose: Pose, points: Float[np.ndarray, "points 3"],
    depth: Float[np.ndarray, " points"],
) -> Bool[np.ndarray, " points"]:  # fmt: skip
    """Whether a panorama is nearer to points than ``depth``, and its own surface there is the same one."""
    seen = (points - pose.position) @ pose.rotation
    distance = np.linalg.norm(seen, axis=1)
    is_same = np.abs(sample_nearest(rho, seen) * distance - 1.0) < 2.0 * SAME_POINT_TOLERANCE
    return np.asarray(is_same & (distance < NEARER_SHARE * depth))


@cache
def _rays() -> Float[np.ndarray, "rows cols 3"]:
    return pixel_directions(*GRID)
