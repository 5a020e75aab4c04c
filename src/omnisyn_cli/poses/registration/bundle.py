"""All poses of a set and the distances of all points at once: bundle adjustment.

A point lies on the ray of the panorama that it is anchored in, and one number tells where: its inverse distance. Each
match is used twice, anchored in either panorama. Matches of one feature with several panoramas share their point, which
carries scale along a chain. Points are eliminated from the normal equations (the Schur complement). That leaves six
numbers for each panorama.

Source: Triggs, McLauchlan, Hartley and Fitzgibbon, Bundle adjustment: a modern synthesis, 2000.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.poses.registration.bundle_equations import Equations, Lengths, Observations, State
from omnisyn_cli.poses.registration.least_squares import cross_matrices
from omnisyn_cli.poses.registration.pose_graph import Edge, connected_with

MAX_ITERATIONS = 40
MIN_STEP = 2e-5  # Radians, or shares of a baseline: smaller steps end the search

# Pixels of a residual that quarter the weight of a match, at first and in the end, and their factor in between.
FIRST_SPREAD, LAST_SPREAD, SPREAD_SHRINKAGE = 8.0, 1.0, 0.7


@dataclass(frozen=True)
class Adjustment:
    """Adjusted poses."""

    poses: dict[int, Pose]  # by the number of the panorama
    # of the rotation vector in the world and the position of each panorama in turn
    covariance: Float[np.ndarray, "m m"]

    def relative_std(self, first: int, second: int) -> tuple[float, float]:
        """Of the second pose as the first camera sees it: radians, and share of the distance, infinite in one place."""
        begins = [6 * list(self.poses).index(panorama) for panorama in (first, second)]
        step = self.poses[second].position - self.poses[first].position
        change = np.zeros((6, len(self.covariance)))
        change[:, begins[0] : begins[0] + 6] = -np.eye(6)
        change[3:, begins[0] : begins[0] + 3] = cross_matrices(step)
        change[:, begins[1] : begins[1] + 6] = np.eye(6)
        variance = np.einsum("ij,jk,ik->i", change, self.covariance, change)
        rotation, position = np.sqrt(variance.reshape(2, 3).sum(axis=1)).tolist()
        length = float(np.linalg.norm(step))
        return rotation, position / length if length > 0.0 else math.inf


def adjust(
    world: Mapping[int, Pose], edges: Sequence[Edge], given: Mapping[tuple[int, int], float] | None = None
) -> Adjustment:
    """The poses that explain all matches best; the first stays, and so do ``given`` distances, or else their sum."""
    number = {panorama: k for k, panorama in enumerate(world)}
    matches = Observations.of(edges, number)
    rotation, position = (
        np.stack([getattr(pose, name) for pose in world.values()]) for name in ("rotation", "position")
    )
    lengths = Lengths.of(edges, given or {}, number, position)
    state = State(rotation, position, matches.inverse_distances(rotation, position))
    damping, spread = 1e-3, FIRST_SPREAD
    for _ in range(MAX_ITERATIONS):
        equations = Equations.of(matches, lengths, state, spread)
        tried, step = equations.step(state, damping)
        is_better = equations.cost(tried) <= equations.cost(state)
        damping = min(max(damping * (0.1 if is_better else 10.0), 1e-8), 1e8)
        if is_better:
            state = tried
            if spread == LAST_SPREAD and step < MIN_STEP:
                break
            spread = max(SPREAD_SHRINKAGE * spread, LAST_SPREAD)
    covariance = Equations.of(matches, lengths, state, LAST_SPREAD).covariance()
    home = connected_with([edge for edge in edges if edge.estimate.have_same_position], max(number) + 1)
    poses = {each: Pose(state.rotation[k], state.position[number[home[each]]]) for each, k in number.items()}
    return Adjustment(poses, covariance)
