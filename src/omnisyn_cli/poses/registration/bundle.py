"""All poses of a set and the distances of all points at once: bundle adjustment.

A point lies on the ray of the panorama that it is anchored in, and one number tells where: its inverse distance. Each
match is used twice, anchored in either panorama. Matches of one feature with several panoramas share their point, which
carries scale along a chain. An anchor and the panoramas that see its points make a star. Stars share no points: each is
eliminated from the normal equations by itself (the Schur complement). That leaves six numbers for each panorama.

Source: Triggs, McLauchlan, Hartley and Fitzgibbon, Bundle adjustment: a modern synthesis, 2000.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.poses.registration.least_squares import JACKKNIFE_ANGLE, cross_matrices, sphere_cells
from omnisyn_cli.poses.registration.pose_graph import Edge, Given, connected_with

MAX_ITERATIONS = 40
MIN_STEP = 2e-5  # Radians, or shares of a baseline: smaller steps end the search

# Pixels of a residual that quarter the weight of a match, at first and in the end, and their factor in between.
FIRST_SPREAD, LAST_SPREAD, SPREAD_SHRINKAGE = 8.0, 1.0, 0.7
MAX_OBSERVATIONS = 100_000  # Which bounds time and memory: points that more pairs share are kept first

# Pixels of residual that a doubled length counts as: one that is given stays, the former one only if nothing tells.
GIVEN_LENGTH_PIXELS, FORMER_LENGTH_PIXELS = 1e4, 0.1


@dataclass(frozen=True)
class State:
    """What is looked for: ``(n, 3, 3)`` rotations, ``(n, 3)`` positions, ``(p,)`` inverse distances of points."""

    rotation: np.ndarray
    position: np.ndarray
    inverse: np.ndarray


@dataclass(frozen=True)
class Observations:
    """Matches, each of them from its anchor and from another panorama; sorted by anchor, and so are points."""

    # ``(m,)`` numbers of the panoramas
    anchor: np.ndarray
    other: np.ndarray
    # ``(m, 3)`` its directions there, in the camera's frame
    ray: np.ndarray
    seen: np.ndarray
    point: np.ndarray  # ``(m,)`` number of the point
    parallax: np.ndarray  # ``(m,)`` 0 where both stand in one place, so that nothing is told of distances; else 1
    pixel: np.ndarray  # ``(m,)`` radians
    cluster: np.ndarray  # ``(m,)`` number of the part of the world that it shows: its matches err together

    @staticmethod
    def of(edges: Sequence[Edge], number: Mapping[int, int]) -> "Observations":
        """Of the matches of all pairs, each twice."""
        parts = []
        for edge in edges:
            ends = (number[edge.first], edge.matches.first), (number[edge.second], edge.matches.second)
            for (from_anchor, rays), (from_other, sights) in (ends, ends[::-1]):
                numbers = (from_anchor, from_other, float(not edge.estimate.have_same_position), edge.matches.pixel)
                parts.append((*(np.full(len(rays), each) for each in numbers), rays, sights))
        anchor, other, parallax, pixel, ray, seen = (np.concatenate(part) for part in zip(*parts, strict=True))
        point = np.unique(np.column_stack([anchor, ray]), axis=0, return_inverse=True)[1].ravel()
        cluster = _clusters(anchor, ray, _tracks(point, [len(edge.matches) for edge in edges]))
        kept = _most_shared(point)
        kept = kept[np.argsort(anchor[kept], kind="stable")]
        point = np.unique(point[kept], return_inverse=True)[1]
        return Observations(
            anchor[kept], other[kept], ray[kept], seen[kept], point, parallax[kept], pixel[kept], cluster[kept]
        )

    def world(self, rotation: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Both directions in the world, and the way from the other panorama to the anchor."""
        ray = np.einsum("nij,nj->ni", rotation[self.anchor], self.ray)
        seen = np.einsum("nij,nj->ni", rotation[self.other], self.seen)
        return ray, seen, (position[self.anchor] - position[self.other]) * self.parallax[:, None]

    def inverse_distances(self, rotation: np.ndarray, position: np.ndarray) -> Float[np.ndarray, " p"]:
        """Where the rays of each point meet by least squares."""
        ray, seen, apart = self.world(rotation, position)
        off, slope = np.cross(ray, seen), np.cross(apart, seen)
        above, below = (np.bincount(self.point, np.sum(part * slope, axis=1)) for part in (off, slope))
        return np.asarray(np.maximum(-above / np.maximum(below, 1e-12), 0.0))

    def residual(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Chords ``(m, 3)`` between where points are and where they are seen, and vectors towards where they are."""
        ray, seen, apart = self.world(state.rotation, state.position)
        towards = ray + state.inverse[self.point, None] * apart
        return towards / np.linalg.norm(towards, axis=1, keepdims=True) - seen, towards


@dataclass(frozen=True)
class Lengths:
    """Sums of distances that are to stay: weights ``(k, pairs)``, the logarithms wanted, pixels; pairs by number."""

    chosen: np.ndarray
    wanted: np.ndarray
    pixels: np.ndarray
    first: np.ndarray
    second: np.ndarray

    @staticmethod
    def of(edges: Sequence[Edge], given: Given, number: Mapping[int, int], position: np.ndarray) -> "Lengths":
        """Those that are given, else the sum of all; and weakly each as it is at these positions."""
        apart = [edge for edge in edges if not edge.estimate.have_same_position]
        first, second = (np.array([number[getattr(e, end)] for e in apart], int) for end in ("first", "second"))
        former = _distances(position[second] - position[first])
        kept = [k for k, edge in enumerate(apart) if (edge.first, edge.second) in given]
        rows = np.eye(len(apart))[kept] if kept else np.ones((min(1, len(apart)), len(apart)))
        sums = np.array([given[apart[k].first, apart[k].second] for k in kept]) if kept else rows @ former
        return Lengths(
            np.concatenate([rows, np.eye(len(apart))]), np.log(np.concatenate([sums, former])),
            np.repeat([GIVEN_LENGTH_PIXELS, FORMER_LENGTH_PIXELS], [len(rows), len(apart)]), first, second,
        )  # fmt: skip

    def residual(self, position: np.ndarray) -> Float[np.ndarray, " k"]:
        """Logarithms of the sums over those wanted, in pixels."""
        length = _distances(position[self.second] - position[self.first])
        return np.asarray(self.pixels * (np.log(self.chosen @ length) - self.wanted))

    def jacobian(self, position: np.ndarray) -> Float[np.ndarray, "k m"]:
        """Derivatives by the six numbers of each panorama."""
        step = position[self.second] - position[self.first]
        length = _distances(step)
        by_step = (self.chosen / (self.chosen @ length)[:, None])[:, :, None] * (step / length[:, None])
        by_panorama = np.zeros((len(self.chosen), len(position), 6))
        for sign, ends in ((-1.0, self.first), (1.0, self.second)):
            for k, end in enumerate(ends):
                by_panorama[:, end, 3:] += sign * by_step[:, k]
        return np.asarray(self.pixels[:, None] * by_panorama.reshape(len(self.chosen), 6 * len(position)))


@dataclass(frozen=True)
class _Star:
    """The points of one anchor and who sees them."""

    matches: slice  # which observations
    columns: np.ndarray  # ``(k,)`` of the numbers of the panoramas that see them, six for each
    # ``(m, 12)`` where in these the six numbers of the anchor and of the other panorama of each match are
    places: np.ndarray
    point: np.ndarray  # ``(m,)`` number of its point among those of the anchor
    by_pose: np.ndarray  # ``(m, 12)`` products of the derivatives by both panoramas and the residuals
    mixed: np.ndarray  # ``(p, k)`` products of the derivatives by points and by panoramas
    # ``(p,)`` squares of those by points, and their products with the residuals
    own: np.ndarray
    gradient: np.ndarray

    @staticmethod
    def of(matches: Observations, chosen: slice, by_pose: np.ndarray, by_point: np.ndarray,
           residual: np.ndarray) -> "_Star":  # fmt: skip
        """Of the observations of one anchor, with their derivatives ``(m, 3, 12)`` and ``(m, 3)``."""
        others, which = np.unique(matches.other[chosen], return_inverse=True)
        columns = (6 * np.append(matches.anchor[chosen.start], others)[:, None] + np.arange(6)).ravel()
        both = np.stack([np.zeros(len(which), int), which.ravel() + 1], axis=1)
        places = (6 * both[:, :, None] + np.arange(6)).reshape(-1, 12)
        point = matches.point[chosen] - matches.point[chosen].min()
        mixed = np.zeros((point.max() + 1, len(columns)))
        np.add.at(mixed, (point[:, None], places), np.einsum("mi,mic->mc", by_point[chosen], by_pose[chosen]))
        own = np.bincount(point, np.sum(by_point[chosen] ** 2, axis=1))
        gradient = np.bincount(point, np.sum(by_point[chosen] * residual[chosen], axis=1))
        products = np.einsum("mi,mic->mc", residual[chosen], by_pose[chosen])
        return _Star(chosen, columns, places, point, products, mixed, own, gradient)

    def damped(self, damping: float) -> Float[np.ndarray, " p"]:
        """The squares for a damped step; a point that nothing moves stays."""
        return self.own * (1.0 + damping) + 1e-9


@dataclass(frozen=True)
class Equations:
    """Least squares of weighted residuals about a state; the first panorama does not move."""

    # whose residuals they are
    matches: Observations
    lengths: Lengths
    weight: np.ndarray  # ``(m,)`` of each match, over the pixel
    # ``(m, 3, 12)``, ``(m, 3)`` derivatives by the anchor and the other one, and by the point
    by_pose: np.ndarray
    by_point: np.ndarray
    by_length: np.ndarray  # ``(k, 6n)`` those of the lengths
    residual: np.ndarray  # ``(m, 3)``
    stars: tuple[_Star, ...]  # of all anchors

    @staticmethod
    def of(matches: Observations, lengths: Lengths, state: State, spread: float) -> "Equations":
        """Linearised, with the weights of Geman and McClure."""
        residual, towards = matches.residual(state)
        ray, seen, apart = matches.world(state.rotation, state.position)
        off = np.linalg.norm(residual, axis=1) / matches.pixel
        weight = 1.0 / (1.0 + (off / spread) ** 2) / matches.pixel
        length = np.linalg.norm(towards, axis=1)[:, None, None]
        unit = towards / length[:, 0]
        across = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length
        by_position = across * (state.inverse[matches.point] * matches.parallax)[:, None, None]
        by_pose = weight[:, None, None] * np.concatenate(
            [-across @ cross_matrices(ray), by_position, cross_matrices(seen), -by_position], axis=2
        )
        by_point = weight[:, None] * np.einsum("nij,nj->ni", across, apart)
        residual = weight[:, None] * residual
        begins = np.flatnonzero(np.diff(matches.anchor, prepend=-1))
        slices = [slice(*ends) for ends in pairwise([*begins, len(weight)])]
        return Equations(
            matches, lengths, weight, by_pose, by_point, lengths.jacobian(state.position), residual,
            tuple(_Star.of(matches, chosen, by_pose, by_point, residual) for chosen in slices),
        )  # fmt: skip

    def cost(self, state: State) -> float:
        """Sum of squares at a state, with these weights."""
        residual = self.weight[:, None] * self.matches.residual(state)[0]
        return float(np.sum(residual**2) + np.sum(self.lengths.residual(state.position) ** 2))

    def step(self, state: State, damping: float) -> tuple[State, float]:
        """The state after a damped step, and the largest change of a pose."""
        gradient = self.by_length.T @ self.lengths.residual(state.position)
        for star in self.stars:
            np.add.at(gradient, star.columns[star.places], star.by_pose)
            gradient[star.columns] -= star.mixed.T @ (star.gradient / star.damped(damping))
        step = np.zeros(len(gradient))
        step[6:] = -np.linalg.solve(self._reduced(damping)[6:, 6:], gradient[6:])
        nearer = [-(star.gradient + star.mixed @ step[star.columns]) / star.damped(damping) for star in self.stars]
        turns, moves = step.reshape(-1, 2, 3).swapaxes(0, 1)
        inverse = np.maximum(state.inverse + np.concatenate(nearer), 0.0)  # no point goes beyond infinity
        moved = State(rotation_from_rotation_vector(turns) @ state.rotation, state.position + moves, inverse)
        return moved, float(np.abs(step).max())

    def covariance(self) -> Float[np.ndarray, "m m"]:
        """Of rotations and positions, where the matches of one cluster err together.

        A length that only its former value tells is known within a factor. Degrees of freedom make up for few clusters.
        """
        sizes = np.bincount(self.matches.cluster).astype(float)
        scores = np.zeros((len(sizes), self.by_length.shape[1]))
        for star in self.stars:
            cluster = self.matches.cluster[star.matches, None]
            along = np.sum(self.residual[star.matches] * self.by_point[star.matches], axis=1, keepdims=True)
            eliminated = (star.mixed / star.damped(0.0)[:, None])[star.point]
            np.add.at(scores, (cluster, star.columns[star.places]), star.by_pose)
            np.add.at(scores, (cluster, star.columns[None]), -along * eliminated)
        unknown = FORMER_LENGTH_PIXELS * self.by_length[self.lengths.pixels == FORMER_LENGTH_PIXELS][:, 6:]
        inverse = np.linalg.inv(self._reduced(0.0)[6:, 6:])
        clusters = sizes.sum() ** 2 / np.sum(sizes**2)  # as many of equal size are worth as much
        lost = clusters / max(clusters - len(inverse), 1.0)
        covariance = np.zeros((scores.shape[1], scores.shape[1]))
        covariance[6:, 6:] = inverse @ (lost * scores[:, 6:].T @ scores[:, 6:] + unknown.T @ unknown) @ inverse
        return covariance

    def _reduced(self, damping: float) -> Float[np.ndarray, "m m"]:
        """Hessian of the panoramas, from which points are eliminated."""
        hessian = self.by_length.T @ self.by_length + 1e-6 * np.eye(self.by_length.shape[1])  # all in one place
        for star in self.stars:
            by_pose = self.by_pose[star.matches]
            own = np.zeros((len(star.columns), len(star.columns)))
            for other in range(6, len(star.columns), 6):
                some, place = by_pose[star.places[:, 6] == other], star.places[star.places[:, 6] == other][0]
                own[np.ix_(place, place)] += np.einsum("mic,mid->cd", some, some)
            hessian[np.ix_(star.columns, star.columns)] += own
        hessian += damping * np.diag(np.diag(hessian))
        for star in self.stars:
            scaled = star.mixed / np.sqrt(star.damped(damping))[:, None]
            hessian[np.ix_(star.columns, star.columns)] -= np.einsum("pc,pd->cd", scaled, scaled)
        return np.asarray(hessian)


def _tracks(point: np.ndarray, counts: Sequence[int]) -> Int[np.ndarray, " m"]:
    """What each match is a view of, across matched anchors. They come by pair, ``counts`` from either end."""
    ends = np.cumsum(counts) * 2
    halves = [(range(end - 2 * n, end - n), range(end - n, end)) for end, n in zip(ends, counts, strict=True)]
    twin = np.concatenate([[*second, *first] for first, second in halves]).astype(int)
    former, lowest = np.zeros(0, int), np.arange(point.max() + 1)
    while not np.array_equal(former, lowest):
        former = lowest.copy()
        np.minimum.at(lowest, point, former[point[twin]])
    return np.asarray(lowest[point])


def _clusters(anchor: np.ndarray, ray: np.ndarray, track: np.ndarray) -> Int[np.ndarray, " m"]:
    """Cells of the sphere around one of the panoramas that see a track."""
    _, first, which = np.unique(track, return_index=True, return_inverse=True)
    places = ray[first] + 4.0 * anchor[first, None]  # apart for different panoramas
    return np.asarray(sphere_cells(places, JACKKNIFE_ANGLE)[0][which.ravel()])


def _most_shared(point: np.ndarray) -> Int[np.ndarray, " kept"]:
    """Which of the observations are used: at most :data:`MAX_OBSERVATIONS`, all of a point or none."""
    count = np.bincount(point)
    order = np.argsort(np.random.default_rng(0).random(len(count)) - count)
    is_kept = np.zeros(len(count), bool)
    is_kept[order] = np.cumsum(count[order]) <= MAX_OBSERVATIONS
    return np.flatnonzero(is_kept[point])


def _distances(steps: np.ndarray) -> Float[np.ndarray, " n"]:
    """Lengths, of which logarithms are taken."""
    return np.asarray(np.maximum(np.linalg.norm(steps, axis=-1), 1e-12))


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


def adjust(world: Mapping[int, Pose], edges: Sequence[Edge], given: Given | None = None) -> Adjustment:
    """The poses that explain all matches best; the first stays, and so do ``given`` distances, or else their sum."""
    number = {panorama: k for k, panorama in enumerate(world)}
    matches = Observations.of(edges, number)
    rotation = np.stack([pose.rotation for pose in world.values()])
    position = np.stack([pose.position for pose in world.values()])
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
