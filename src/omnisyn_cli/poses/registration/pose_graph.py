"""Poses of a set of panoramas from the relative poses of pairs.

Rotations are averaged over all pairs. Pictures do not tell the length of a baseline, but points that two pairs of one
panorama share tell the ratio of theirs. Then positions follow from directions and lengths by linear least squares.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from omnisyn_cli.geometry.pose import Pose, nearest_rotation, rotation_angle
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.robust import Estimate, support_mask

# Pixels of parallax of a point from which on its distance is used: it is known within about a tenth then.
MIN_PARALLAX_PIXELS = 6.0
# Points that have to agree about a ratio of two baselines, half of those that both pairs see, and within which range of
# its logarithm. A facade of equal bays adds points that say anything.
MIN_SHARED_POINTS, SHARED_RANGE = 3, 0.4
MAX_SHARED_WEIGHT = 100  # Shared points beyond this make a ratio no more credible

# Weight, in shared points, of baselines being equal: it decides only where nothing else does.
EQUAL_LENGTH_WEIGHT = 0.01
GIVEN_LENGTH_WEIGHT = 1e4  # Weight, in shared points, of a baseline that is given
UNTOLD_WEIGHT = 1e-4  # Factor of the weight of scales being equal: it decides only where directions do not
AVERAGING_ROUNDS = 50  # Of rotation averaging, each over all panoramas; a chain needs none

# Radians off the mean at which a pair has a quarter of its weight and from which on it contradicts the others. Right
# pairs are off by tenths of a degree.
CONTRADICTION_ANGLE = math.radians(3.0)
# The same of directions, of which weak pairs along a corridor are off by up to 4°.
CONTRADICTION_DIRECTION = math.radians(5.0)

# Of the distance of a pair in the set to what its points say. Right pairs of generated chains are off by 2 %.
CONTRADICTION_RATIO = 1.25
MAX_IN_PLACE_SHARE = 0.1  # Of the median distance of pairs: farther apart, two panoramas are not in one place

# Of matches that contradict a pair: fewer agree with another pose by chance. At most 11 did with random directions.
MIN_OTHER_MATCHES = 15

Ratios = Mapping[tuple[int, int, int, int], tuple[float, int]]
"""Logarithm of the length of one pair over that of another, and how many points tell it, by their panoramas."""

Given = Mapping[tuple[int, int], float]
"""Distances that a user gave, by pairs of panoramas."""


@dataclass(frozen=True)
class Edge:
    """Two panoramas of a set whose relative pose is known."""

    # their indices
    first: int
    second: int
    estimate: Estimate  # the relative pose
    matches: Matches  # those that agree with it
    others: Matches | None = None  # those that do not, if they are kept

    @property
    def weight(self) -> int:
        """Number of matches."""
        return len(self.matches)

    def seen_from(self, panorama: int) -> tuple[Pose, np.ndarray, np.ndarray]:
        """Relative pose and matched directions with that panorama as the first one."""
        pose = self.estimate.first_from_second
        if panorama == self.first:
            return pose, self.matches.first, self.matches.second
        return pose.inverse(), self.matches.second, self.matches.first


def placed_panoramas(edges: Sequence[Edge], count: int) -> list[int]:
    """The largest set of panoramas that are connected with each other; that of the first one among equals."""
    group = connected_with(edges, count)
    largest = max(group, key=lambda label: (group.count(label), -label))
    return [panorama for panorama in range(count) if group[panorama] == largest]


def connected_with(edges: Sequence[Edge], count: int) -> list[int]:
    """The lowest of the panoramas that each one is connected with."""
    group = list(range(count))
    for edge in edges:
        old, new = sorted((group[edge.first], group[edge.second]), reverse=True)
        group = [new if label == old else label for label in group]
    return group


def is_worthwhile(pair: tuple[int, int], edges: Sequence[Edge], count: int) -> bool:
    """Whether comparing a pair may connect panoramas, or tell the ratio of two baselines that share no points."""
    placed, ends = placed_panoramas(edges, count), [{edge.first, edge.second} for edge in edges]
    sides = [(edges[a], edges[b]) for a, b in combinations(range(len(edges)), 2) if ends[a] ^ ends[b] == set(pair)]
    does_connect = (pair[0] in placed) != (pair[1] in placed)
    return set(pair) not in ends and (does_connect or any(_log_length_ratio(*both) is None for both in sides))


def average_rotations(edges: Sequence[Edge], placed: Sequence[int]) -> dict[int, Float[np.ndarray, "3 3"]]:
    """World-from-camera rotations, the identity first: along the strongest pairs, then the mean of all neighbours.

    Pairs that contradict the others lose their weight. Source: Hartley et al., Rotation averaging, 2013 (chordal mean).
    """
    rotations = {placed[0]: np.eye(3)}
    edges = [edge for edge in edges if edge.first in placed]
    while len(rotations) < len(placed):
        leading = [e for e in edges if (e.first in rotations) != (e.second in rotations)]
        edge = max(leading, key=lambda e: e.weight)
        known, new = (edge.first, edge.second) if edge.first in rotations else (edge.second, edge.first)
        rotations[new] = rotations[known] @ edge.seen_from(known)[0].rotation
    for _ in range(AVERAGING_ROUNDS if len(edges) >= len(placed) else 0):
        for panorama in placed[1:]:
            own = [edge for edge in edges if panorama in (edge.first, edge.second)]
            others = [edge.second if edge.first == panorama else edge.first for edge in own]
            said = np.stack([rotations[k] @ e.seen_from(k)[0].rotation for e, k in zip(own, others, strict=True)])
            off = rotation_angle(np.swapaxes(said, 1, 2) @ rotations[panorama])
            weight = np.array([edge.weight for edge in own]) / (1.0 + (off / CONTRADICTION_ANGLE) ** 2) ** 2
            rotations[panorama] = nearest_rotation(np.einsum("n,nij->ij", weight, said))
    return rotations


def consistent_edges(edges: Sequence[Edge], rotations: Mapping[int, np.ndarray]) -> list[Edge]:
    """Those between panoramas with averaged rotations that agree with them: a room may look alike from two sides."""
    known = [edge for edge in edges if edge.first in rotations]
    off = [rotations[e.first].T @ rotations[e.second] @ e.estimate.first_from_second.rotation.T for e in known]
    limits = [max(CONTRADICTION_ANGLE, 3.0 * edge.estimate.uncertainty.rotation) for edge in known]
    return [edge for edge, turn, limit in zip(known, off, limits, strict=True) if rotation_angle(turn) < limit]


def agreeing_edges(edges: Sequence[Edge], rotations: Mapping[int, np.ndarray], *, is_ordered: bool) -> list[Edge]:
    """Those whose directions and ratios of lengths fit one set of positions, given averaged rotations.

    Repeated tiles shift a camera without turning it. While pairs contradict, the one without which fewest do is left
    out. Of equal ones neighbours in an order stay: distant pairs are misled more easily. Then it is the one whose other
    matches agree best with the pose that the rest implies, or the longest one. Edges connect all that have rotations.
    """
    edges, ratios = list(edges), length_ratios(edges)
    _, contradicts = _positions_and_contradictions(edges, rotations, ratios)
    while contradicts.any():
        disputed = {end for k in np.flatnonzero(contradicts) for end in (edges[k].first, edges[k].second)}
        options = []
        for edge in edges:
            rest = [other for other in edges if other is not edge]
            group = connected_with(rest, max(rotations) + 1)
            if {edge.first, edge.second} & disputed and len({group[k] for k in rotations}) == 1:
                positions, left = _positions_and_contradictions(rest, rotations, ratios)
                step = rotations[edge.first].T @ (positions[edge.second] - positions[edge.first])
                implied = Pose(rotations[edge.first].T @ rotations[edge.second], step)
                is_neighbour = is_ordered and edge.second - edge.first == 1
                preference = is_neighbour, -_support_of_others(edge, implied), -float(np.linalg.norm(step))
                options.append((int(left.sum()), *preference, rest, left))
        if not options:
            break
        *_, edges, contradicts = min(options, key=lambda option: option[:4])
    return edges


def _support_of_others(edge: Edge, implied: Pose) -> int:
    """How many of the matches that contradict a pair agree with another pose; 0 if they may do so by chance."""
    length = float(np.linalg.norm(implied.position))
    if edge.others is None or length == 0.0:
        return 0
    pose = Pose(implied.rotation, implied.position / length)
    count = int(support_mask(pose, edge.others).sum())
    return count if count >= MIN_OTHER_MATCHES else 0


def _positions_and_contradictions(
    edges: Sequence[Edge], rotations: Mapping[int, np.ndarray], ratios: Ratios
) -> tuple[dict[int, Float[np.ndarray, " 3"]], Bool[np.ndarray, " edges"]]:
    """Positions, and the pairs that do not fit them by direction or, if that is told, by length."""
    lengths, scale_of = baseline_lengths(edges, {}, ratios)
    positions = positions_of(edges, lengths, scale_of, rotations)
    steps = np.stack([rotations[edge.first].T @ (positions[edge.second] - positions[edge.first]) for edge in edges])
    ways = np.stack([edge.estimate.first_from_second.position for edge in edges])
    along, across = np.einsum("ni,ni->n", steps, ways), np.linalg.norm(np.cross(steps, ways), axis=1)
    tolerance = [max(CONTRADICTION_DIRECTION, 3.0 * edge.estimate.uncertainty.direction) for edge in edges]
    distance = np.maximum(np.linalg.norm(steps, axis=1), 1e-9)
    logs = np.log(distance / np.maximum(lengths, 1e-9))
    logs -= [np.median(logs[scale_of == scale]) for scale in scale_of]
    is_off = (np.arctan2(across, along) > tolerance) | (np.abs(logs) > math.log(CONTRADICTION_RATIO))
    is_apart = distance > MAX_IN_PLACE_SHARE * np.median(lengths[lengths > 0.0]) if lengths.any() else is_off
    return positions, np.where(lengths > 0.0, is_off, is_apart)


def length_ratios(edges: Sequence[Edge]) -> Ratios:
    """What points that two pairs share tell of the ratio of their baselines."""
    ratios = {}
    for a, b in combinations(edges, 2):
        if (ratio := _log_length_ratio(a, b)) is not None:
            ratios[a.first, a.second, b.first, b.second] = ratio
    return ratios


def baseline_lengths(
    edges: Sequence[Edge], given: Given, ratios: Ratios | None = None
) -> tuple[Float[np.ndarray, " edges"], Int[np.ndarray, " edges"]]:
    """The length of every pair's baseline, 0 where both stand in one place, and the scale that it is told in.

    Logarithms by least squares over all ratios, ``given`` ones, and 1. Scales are numbered by their first pair.
    """
    ratios = length_ratios(edges) if ratios is None else ratios
    has_length = [not edge.estimate.have_same_position for edge in edges]
    unit, scale_of = np.eye(len(edges)), np.arange(len(edges))
    equations = [(row, 0.0, EQUAL_LENGTH_WEIGHT) for row in unit]
    known = [k for k, edge in enumerate(edges) if (edge.first, edge.second) in given]
    scale_of[known] = known[0] if known else 0
    equations += [(unit[k], math.log(given[edges[k].first, edges[k].second]), GIVEN_LENGTH_WEIGHT) for k in known]
    for (a, one), (b, other) in combinations(enumerate(edges), 2):
        ratio = ratios.get((one.first, one.second, other.first, other.second))
        if has_length[a] and has_length[b] and ratio is not None:
            equations.append((unit[a] - unit[b], ratio[0], min(ratio[1], MAX_SHARED_WEIGHT)))
            scale_of[scale_of == max(scale_of[a], scale_of[b])] = min(scale_of[a], scale_of[b])
    rows, logs_told, weights = (np.array(each, float) for each in zip(*equations, strict=True))
    weight = np.sqrt(weights)
    logs = np.linalg.lstsq(rows * weight[:, None], logs_told * weight, rcond=None)[0]
    return np.where(has_length, np.exp(logs), 0.0), scale_of


def positions_of(
    edges: Sequence[Edge], lengths: Float[np.ndarray, " edges"], scale_of: Int[np.ndarray, " edges"],
    rotations: Mapping[int, np.ndarray],
) -> dict[int, Float[np.ndarray, " 3"]]:  # fmt: skip
    """Positions from directions and lengths; the first panorama stands at the origin.

    Pairs weigh by their matches, and less the longer they are: errors of a direction grow with the length. Directions
    tell the ratios of scales as well; where they do not, all scales are equal.
    """
    column = {panorama: 3 * k for k, panorama in enumerate(sorted(rotations))}
    scales, which = np.unique(scale_of, return_inverse=True)
    counts, scale_column = np.bincount(which), 3 * len(column) + which
    system = np.zeros((3 * len(edges) + len(scales) + 3, 3 * len(column) + len(scales)))
    shortest = float(np.min(lengths[lengths > 0], initial=1.0))
    for k, (edge, length) in enumerate(zip(edges, lengths, strict=True)):
        rows, weight = slice(3 * k, 3 * k + 3), math.sqrt(edge.weight) / max(float(length), shortest)
        for panorama, sign in ((edge.second, weight), (edge.first, -weight)):
            system[rows, column[panorama] : column[panorama] + 3] = sign * np.eye(3)
        step = length * (rotations[edge.first] @ edge.estimate.first_from_second.position)
        system[rows, scale_column[k]] = -weight * step
    largest, told = np.abs(system).max(initial=1.0), np.zeros(len(system))
    weights = np.where(np.arange(len(scales)) == counts.argmax(), largest, UNTOLD_WEIGHT * largest)
    system[3 * len(edges) : -3, 3 * len(column) :], told[3 * len(edges) : -3] = np.diag(weights), weights
    system[-3:, :3] = largest * np.eye(3)
    found = np.linalg.lstsq(system, told, rcond=None)[0]
    return {panorama: found[k : k + 3] - found[:3] for panorama, k in column.items()}


def shortest_path(positions: Mapping[int, np.ndarray], edges: Sequence[Edge]) -> list[int]:
    """All panoramas in a short order that prefers matching pairs: the nearest next, from the best start; two-opt."""
    names = sorted(positions)
    places = np.stack([positions[name] for name in names])
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    matched = {frozenset((edge.first, edge.second)) for edge in edges}
    unmatched = [[frozenset((a, b)) not in matched for b in names] for a in names]
    cost = distance * np.where(unmatched, 3.0, 1.0)
    ways = [_nearest_next(cost, start) for start in range(len(names))]
    best = _improved(min(ways, key=lambda way: _way_length(way, cost)), cost)
    return [names[k] for k in (best if best[0] <= best[-1] else best[::-1])]


def _nearest_next(cost: np.ndarray, start: int) -> list[int]:
    way, left = [start], set(range(len(cost))) - {start}
    while left:
        way.append(min(left, key=lambda k: (cost[way[-1], k], k)))
        left.remove(way[-1])
    return way


def _improved(way: list[int], cost: np.ndarray) -> list[int]:
    """Two-opt: the way with stretches turned round."""
    is_shorter = True
    while is_shorter:
        is_shorter = False
        for begin, end in combinations(range(len(way) + 1), 2):
            turned = way[:begin] + way[begin:end][::-1] + way[end:]
            if _way_length(turned, cost) < _way_length(way, cost) - 1e-9:
                way, is_shorter = turned, True
    return way


def _way_length(way: list[int], cost: np.ndarray) -> float:
    return float(cost[way[:-1], way[1:]].sum())


def _log_length_ratio(a: Edge, b: Edge) -> tuple[float, int] | None:
    """Logarithm of the length of a over that of b from points that both see, and how many agree about it."""
    shared = {a.first, a.second} & {b.first, b.second}
    if len(shared) != 1:
        return None
    distances = []
    for edge in (a, b):
        pose, own, other = edge.seen_from(next(iter(shared)))
        distances.append(_distances(pose, own, other, edge.matches.pixel))
    # one distance in two units: it counts more units of the shorter baseline
    logs = np.sort([math.log(distances[1][key] / distances[0][key]) for key in distances[0].keys() & distances[1]])
    counts = np.searchsorted(logs, logs + SHARED_RANGE, "right") - np.arange(len(logs))
    count = int(counts.max(initial=0))
    if count < max(MIN_SHARED_POINTS, len(logs) / 2):
        return None
    begin = int(counts.argmax())
    return float(np.median(logs[begin : begin + count])), count


def _distances(pose: Pose, first: np.ndarray, second: np.ndarray, pixel: float) -> dict[bytes, float]:
    """Distances of points from the first camera in baselines, by their direction there."""
    turned = second @ pose.rotation.T
    parallax = np.linalg.norm(np.cross(first, turned), axis=1)
    side = np.linalg.norm(np.cross(pose.position, turned), axis=1)
    chosen = np.flatnonzero((parallax > math.sin(MIN_PARALLAX_PIXELS * pixel)) & (side > 0))
    return {first[k].tobytes(): float(side[k] / parallax[k]) for k in chosen}
