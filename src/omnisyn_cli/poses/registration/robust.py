"""The relative pose of two panoramas from matches of which many are wrong.

Samples of few matches give hypotheses; those that most matches agree with are refined (:mod:`.least_squares`), and so
is a pose that is already known. Random numbers come from a fixed seed: equal matches give equal poses. A pose counts if
its support is unlikely enough by chance. Upright cameras leave fewer poses to choose from, so fewer matches are enough.
That the cameras stand in one place, so that the baseline has no direction, is recognised by a pure rotation explaining
as many matches.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.pose import Pose, nearest_rotation, rotation_taking
from omnisyn_cli.geometry.sphere import FORWARD, UP
from omnisyn_cli.poses.registration import least_squares, minimal_solvers
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.least_squares import Uncertainty, angle_between, epipolar_residual, refine_pose

MIN_MATCHES = 8  # Five determine a pose; three more have to agree with it
# Decimal logarithm of the number of poses that as many matches would agree with by chance, as closely. All of 43 real
# pairs that see each other are below.
MAX_LOG_FALSE_ALARMS = -8.0
CLEAR_LOG_FALSE_ALARMS = -40.0  # The same of a pose that ends the search
# What is added where a pose contradicts the vertical edges: two directions agree within 1° once in 10,000 times.
LOG_TESTS_WITHOUT_GRAVITY = 5.0
# Radians between the verticals of two panoramas up to which a pose agrees with them.
MAX_VERTICAL_ERROR = math.radians(2.0)
# Sine of the angle between the baseline and the horizon up to which both cameras stand at one height.
MAX_CLIMB_SINE = math.sin(math.radians(3.0))
# Matches that determine a pose, and how many poses they leave at most: of any two cameras, of two whose verticals are
# known, and of two that also stand at one height.
GENERAL_MOTION, UPRIGHT_MOTION, PLANAR_MOTION = (5, 10), (3, 4), (2, 2)
# Least probability that is assumed of a wrong match to agree; fewer samples than its inverse cannot tell it.
MIN_CHANCE = 1e-4
# Inlier thresholds within which agreement is counted: within the one that makes it least likely by chance, as right
# matches spread over a fifth of the widest, and wrong ones evenly.
SPREADS = (1.0, 0.5, 0.25)
CHANCE_SAMPLES = 150  # Matches whose directions are paired at random, each with each, to find that probability
# Matches whose directions are this near to others are no evidence of their own: they may be parts of one thing.
DISTINCT_ANGLE = math.radians(2.0)
# Side of the cells that matches are counted in; all cells weigh the same. A floor of equal tiles has hundreds of
# matches, all consistently wrong by some tiles, in a small part of the sphere.
CROWDED_ANGLE = math.radians(10.0)
MIN_TURN_INLIERS = 12  # Matches that have to agree with a turn on the spot at least; by chance one in 400,000 does
FORWARD_POSE = Pose(np.eye(3), FORWARD)
MIN_INLIER_SHARE = 0.08  # Share of all matches that have to agree with a pose at least
SAMPLES_PER_BATCH, MAX_BATCHES = 300, 12  # Samples that are drawn at once, and how many times at most
# Inlier thresholds within which a match speaks for an upright hypothesis: verticals are off by up to half a degree.
UPRIGHT_SCALE = 4.0
CONFIDENCE = 0.9999  # Probability that a sample without a wrong match was among those drawn
HYPOTHESES_PER_CHUNK = 256  # Hypotheses that are scored at once, which bounds memory
REFINED_HYPOTHESES = 6  # Hypotheses that are refined
# Radians of rotation or direction from which on another pose is a rival, and its logarithm over that of the best pose.
RIVAL_ANGLE, RIVAL_SHARE = math.radians(10.0), 0.6
# Share of the matches of a pose with parallax from which on they are one plane, and inlier thresholds around it in the
# rounds of least squares.
MIN_PLANE_SHARE, PLANE_WIDTHS = 0.92, np.geomspace(16.0, 2.0, 8)
# Share of the matches that agree with a known or an upright pose from which on no general one is looked for.
CLEAR_SHARE = 0.6
# Inliers of a pure rotation per inlier of the full pose from which on the cameras stand in one place.
MIN_ROTATION_ONLY_SHARE = 0.9
MAX_DIRECTION_STD = 0.2  # Radians; a baseline direction with a larger standard deviation counts as unknown


@dataclass(frozen=True)
class Estimate:
    """What the matches say about a pair."""

    first_from_second: Pose  # relative pose; its position has length 1, or is zero where ``have_same_position``
    inliers: Bool[np.ndarray, " n"]  # the matches that agree with it
    residual: float  # their median angle to the epipolar circles, or to the rotated directions if in place; radians
    uncertainty: Uncertainty  # of rotation and direction
    have_same_position: bool  # the panoramas were taken (nearly) from one place; there is no direction
    rival: Pose | None = None  # quite another pose that the other matches support nearly as well; None without one
    is_planar: bool = False  # nothing but one plane supports it


@dataclass(frozen=True)
class Verticals:
    """The direction of the zenith in each of two cameras."""

    # unit vectors
    first: Float[np.ndarray, " 3"]
    second: Float[np.ndarray, " 3"]
    are_certain: bool  # lines tell them; else the cameras are only tried as upright ones


def estimate_relative_pose(
    matches: Matches, known: Sequence[Pose] = (), verticals: Verticals | None = None
) -> Estimate | None:
    """The relative pose that most matches agree with, or None if so many might agree by chance.

    ``known`` are poses with a position of length 1 that compete with what is found. ``verticals`` guide the search and
    make a pose that agrees with them more credible. Source: Fischler and Bolles, Random sample consensus, 1981; Torr
    and Zisserman, MLESAC, 2000 (truncated squares).
    """
    if len(matches) < MIN_MATCHES:
        return None
    poses = _likely_poses(matches, known, verticals)
    needed = MIN_INLIER_SHARE * len(matches)
    supported = (each for each in poses if support_mask(each, matches).sum() >= needed)
    pose = next((each for each in supported if not _is_planar(each, matches, verticals)), poses[0])
    inliers = support_mask(pose, matches)
    rotation = best_rotation(matches)
    turned = rotation_residual(rotation, matches)
    count, in_place = int(inliers.sum()), int((turned < matches.tolerance).sum())
    is_turn = in_place >= max(MIN_TURN_INLIERS, needed)
    if count < needed or log_false_alarms(pose, matches, verticals) > MAX_LOG_FALSE_ALARMS:
        return _in_place(matches, rotation, turned) if is_turn else None
    agreed = matches.select(inliers)
    spread = least_squares.uncertainty(pose, agreed)
    if in_place >= MIN_ROTATION_ONLY_SHARE * count or spread.direction > MAX_DIRECTION_STD:
        return _in_place(matches, rotation, turned) if is_turn else None
    residual = float(np.median(np.abs(epipolar_residual(pose, agreed))))
    rival, is_planar = _rival(pose, poses, matches, verticals), _is_planar(pose, matches, verticals)
    return Estimate(pose, inliers, residual, spread, have_same_position=False, rival=rival, is_planar=is_planar)


def _rival(pose: Pose, others: Sequence[Pose], matches: Matches, verticals: Verticals | None) -> Pose | None:
    """Of ``others``, the likeliest first, one that matches of its own support nearly as well as a pose has its own."""
    # tiles and rows of windows are matched to their neighbours, so that a shift of the camera by one of them fits too
    for other in others:
        if max(least_squares.rotation_error(other, pose), least_squares.direction_error(other, pose)) > RIVAL_ANGLE:
            supporting = [support_mask(each, matches) for each in (pose, other)]
            own, its = (matches.select(~mask) for mask in supporting[::-1])
            limit = min(MAX_LOG_FALSE_ALARMS, RIVAL_SHARE * log_false_alarms(pose, own, verticals))
            if min(len(own), len(its)) > 0 and log_false_alarms(other, its, verticals) < limit:
                return other
    return None


def _is_planar(pose: Pose, matches: Matches, verticals: Verticals | None) -> bool:
    """Whether one plane is all that supports a pose: a floor or wall with a pattern that other places have as well."""
    # it leaves two poses: Longuet-Higgins, The reconstruction of a plane surface from two perspective projections, 1986
    scale = matches.tolerance
    turned = matches.second @ pose.rotation.T
    parallax = np.linalg.norm(np.cross(matches.first, turned), axis=1)
    is_near = support_mask(pose, matches) & (parallax > PLANE_WIDTHS[-1] * scale)
    weight = is_near.astype(float)
    rows = np.linalg.norm(np.cross(pose.position, turned), axis=1)[:, None] * matches.first
    for width in PLANE_WIDTHS * scale:
        root = np.sqrt(weight)
        off = (rows @ np.linalg.lstsq(rows * root[:, None], parallax * root, rcond=None)[0] - parallax) / width
        weight = is_near / (1.0 + off**2) ** 2
    is_on = is_near & (np.abs(off) < 1.0)
    if is_on.sum() <= MIN_PLANE_SHARE * is_near.sum():
        return False
    others = matches.select(~is_on)
    return len(others) < MIN_MATCHES or log_false_alarms(pose, others, verticals) > MAX_LOG_FALSE_ALARMS


def estimate_from_subset(
    matches: Matches, subset: Bool[np.ndarray, " n"], known: Sequence[Pose] = (), verticals: Verticals | None = None
) -> Estimate | None:
    """The same from some of the matches; its inliers are of all."""
    estimate = estimate_relative_pose(matches.select(subset), known, verticals)
    if estimate is None:
        return None
    inliers = np.zeros(len(matches), bool)
    inliers[np.flatnonzero(subset)[estimate.inliers]] = True
    return replace(estimate, inliers=inliers)


def support_mask(first_from_second: Pose, matches: Matches) -> Bool[np.ndarray, " n"]:
    """Matches near their epipolar circles with a point in front of both cameras."""
    is_near = np.abs(epipolar_residual(first_from_second, matches)) < matches.tolerance
    return np.asarray(is_near & least_squares.is_in_front(first_from_second, matches, matches.tolerance))


def _in_place(matches: Matches, rotation: np.ndarray, turned: np.ndarray) -> Estimate:
    inliers = turned < matches.tolerance
    residual = float(np.median(turned[inliers]))
    spread = Uncertainty(2.0 * residual / np.sqrt(_count_distinct(matches.select(inliers))), np.inf)
    return Estimate(Pose(rotation, np.zeros(3)), inliers, residual, spread, have_same_position=True)


def log_false_alarms(pose: Pose, matches: Matches, verticals: Verticals | None) -> float:
    """Decimal logarithm of the expected number of poses that as many of unrelated matches would agree with.

    Of matches within :data:`DISTINCT_ANGLE` of each other one counts. A wrong match agrees as often as directions that
    are paired at random: more often where features and baseline lie near the horizon. Source: Moisan and Stival, A
    probabilistic criterion to detect rigid point matches between two images and estimate the fundamental matrix, 2004.
    """
    sample, solutions = GENERAL_MOTION
    if verticals is not None and angle_between(verticals.first, pose.rotation @ verticals.second) <= MAX_VERTICAL_ERROR:
        # the kind of motion with the fewest matches that the pose may be
        sample, solutions = PLANAR_MOTION if abs(pose.position @ verticals.first) < MAX_CLIMB_SINE else UPRIGHT_MOTION
    residual = np.where(support_mask(pose, matches), np.abs(epipolar_residual(pose, matches)), math.inf)
    some = matches.select(np.arange(0, len(matches), max(1, len(matches) // CHANCE_SAMPLES)))
    first, second = np.nonzero(~np.eye(len(some), dtype=bool))
    unrelated = Matches(some.first[first], some.second[second], matches.pixel)
    chance = max(float(support_mask(pose, unrelated).mean()), MIN_CHANCE)
    count, logs = _count_distinct(matches), [math.inf]
    for share in SPREADS:
        agreed = _count_distinct(matches.select(residual < share * matches.tolerance))
        if agreed > sample:
            choices = _log_binomial(count, agreed) + _log_binomial(agreed, sample)
            logs.append(choices + (agreed - sample) * math.log10(share * chance))
    log_tests = math.log10(solutions * max(count - sample, 1) * len(SPREADS))
    is_contradiction = verticals is not None and verticals.are_certain and (sample, solutions) == GENERAL_MOTION
    return min(logs) + log_tests + LOG_TESTS_WITHOUT_GRAVITY * is_contradiction


def _count_distinct(matches: Matches) -> int:
    """Matches that are no repetition of others in either panorama."""
    return min(len(least_squares.sphere_cells(each, DISTINCT_ANGLE)[1]) for each in (matches.first, matches.second))


def _log_binomial(n: int, k: int) -> float:
    return (math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)) / math.log(10.0)


def _likely_poses(matches: Matches, known: Sequence[Pose], verticals: Verticals | None) -> list[Pose]:
    """The pose that is least likely by chance, and others that may be none."""
    poses: list[tuple[float, Pose]] = []
    # Floors of equal tiles mislead where all matches weigh the same, so crowds weigh less. But all that a corridor
    # shows is crowded around its two ends: if the first pose is not clear, others are looked for without weights.
    for weight in (_crowd_weight(matches), np.ones(len(matches))):
        found = _candidates(matches, () if poses else known, weight, verticals)
        poses += [(log_false_alarms(pose, matches, verticals), pose) for pose in found]
        poses.sort(key=itemgetter(0))
        if poses and poses[0][0] <= CLEAR_LOG_FALSE_ALARMS:
            break
    # one picture twice: all samples are degenerate
    likely = [pose for logs, pose in poses[1:] if logs <= MAX_LOG_FALSE_ALARMS]
    return [poses[0][1] if poses else refine_pose(FORWARD_POSE, matches, matches.tolerance), *likely]


def _candidates(matches: Matches, known: Sequence[Pose], weight: np.ndarray, verticals: Verticals | None) -> list[Pose]:
    """Refined poses: known ones, then those of samples that the verticals leave, then those of any samples."""
    starts, scale, wide = list(known), matches.tolerance, UPRIGHT_SCALE * matches.tolerance
    if verticals is not None:
        level = [rotation_taking(vertical, UP) for vertical in (verticals.first, verticals.second)]
        upright = Matches(matches.first @ level[0].T, matches.second @ level[1].T, matches.pixel)
        for size in (2, 3):
            found = _hypotheses(upright, weight, wide, minimal_solvers.upright_essential_candidates, size)
            starts += _in_front(level[0].T @ found @ level[1], matches, weight, wide)
    refined = [refine_pose(start, matches, scale) for start in starts]
    costs = [_pose_cost(pose, matches, weight, scale) for pose in refined]
    share = 1.0 - min(costs, default=np.inf) / len(matches)
    if share < CLEAR_SHARE:
        found = _hypotheses(matches, weight, scale, minimal_solvers.essential_candidates, 5, share)
        refined += [refine_pose(start, matches, scale) for start in _in_front(found, matches, weight, scale)]
    return refined


def _in_front(essentials: np.ndarray, matches: Matches, weight: np.ndarray, scale: float) -> list[Pose]:
    """Of the four poses of each essential matrix the one with most points in front of both cameras."""
    hypotheses = (minimal_solvers.poses_of_essential(essential) for essential in essentials)
    return [min(poses, key=lambda pose: _pose_cost(pose, matches, weight, scale)) for poses in hypotheses]


Solver = Callable[[np.ndarray, np.ndarray], Float[np.ndarray, "k 3 3"]]


def _hypotheses(
    matches: Matches, weight: np.ndarray, scale: float, solver: Solver, size: int, share: float = 0.0
) -> Float[np.ndarray, "k 3 3"]:
    """The best essential matrices of random samples, best first; a ``share`` of the matches agrees with some pose."""
    rng, drawn, cumulative = np.random.default_rng(0), 0, np.cumsum(weight)
    best, costs = np.zeros((0, 3, 3)), np.zeros(0)
    pairs = ((matches.first, matches.second), (matches.first, matches.first), (matches.second, matches.second))
    products = tuple(np.einsum("ni,nj->ijn", a, b).reshape(9, -1) for a, b in pairs)  # residuals are linear in them
    while drawn < min(_samples_needed(share, size) if drawn else np.inf, SAMPLES_PER_BATCH * MAX_BATCHES):
        sample = np.searchsorted(cumulative, rng.random((SAMPLES_PER_BATCH, size)) * cumulative[-1])
        drawn += SAMPLES_PER_BATCH
        found = solver(matches.first[sample], matches.second[sample])
        best, costs = np.concatenate([best, found]), np.concatenate([costs, _costs(found, products, weight, scale)])
        order = np.argsort(costs, kind="stable")[:REFINED_HYPOTHESES]
        best, costs = best[order], costs[order]
        share = max(share, 1.0 - costs[0] / len(matches)) if len(costs) else share
    return best


def _samples_needed(share: float, size: int) -> float:
    """Samples until one without a wrong match was drawn with :data:`CONFIDENCE` (Fischler and Bolles)."""
    return float(np.log(1.0 - CONFIDENCE) / np.log1p(-min(max(share, 1e-3) ** size, 1.0 - 1e-9)))


def _crowd_weight(matches: Matches) -> Float[np.ndarray, " n"]:
    """Weights that sum to the number of matches, smaller where many lie together in either panorama."""
    crowd = np.ones(len(matches))
    for directions in (matches.first, matches.second):
        cell, count = least_squares.sphere_cells(directions, CROWDED_ANGLE)
        crowd = np.maximum(crowd, count[cell])
    weight = 1.0 / crowd
    return np.asarray(weight * (len(matches) / weight.sum()))


def _costs(essential: np.ndarray, products: tuple[np.ndarray, ...], weight: np.ndarray, scale: float) -> np.ndarray:
    """Truncated squared residuals in units of ``scale``, summed by weight; 0 is best, n is worst."""
    first_second, first_first, second_second = products
    costs = []
    for begin in range(0, len(essential), HYPOTHESES_PER_CHUNK):
        e = essential[begin : begin + HYPOTHESES_PER_CHUNK]
        triple = e.reshape(-1, 9) @ first_second
        along_first = (e @ np.swapaxes(e, 1, 2)).reshape(-1, 9) @ first_first
        along_second = (np.swapaxes(e, 1, 2) @ e).reshape(-1, 9) @ second_second
        squared = triple**2 / np.maximum(0.5 * (along_first + along_second), 1e-12)
        costs.append(np.einsum("hn,n->h", np.minimum(squared / scale**2, 1.0), weight))
    return np.concatenate(costs) if costs else np.zeros(0)


def _pose_cost(pose: Pose, matches: Matches, weight: np.ndarray, scale: float) -> float:
    squared = np.minimum((epipolar_residual(pose, matches) / scale) ** 2, 1.0)
    return float((weight * np.where(least_squares.is_in_front(pose, matches, scale), squared, 1.0)).sum())


def best_rotation(matches: Matches) -> Float[np.ndarray, "3 3"]:
    """The rotation that takes most second directions to first ones, by samples of two matches."""
    scale = matches.tolerance
    sample = np.random.default_rng(1).integers(len(matches), size=(SAMPLES_PER_BATCH, 2))
    frames = [_frames(directions[sample]) for directions in (matches.first, matches.second)]
    candidates = np.concatenate([nearest_rotation(frames[0] @ np.swapaxes(frames[1], 1, 2)), np.eye(3)[None]])
    products = np.einsum("ni,nj->ijn", matches.first, matches.second).reshape(9, -1)
    squared_chords = 2.0 - 2.0 * candidates.reshape(-1, 9) @ products
    rotation = candidates[int(np.argmin(np.minimum(squared_chords / scale**2, 1.0).sum(axis=1)))]
    for _ in range(5):  # reweighted with the same kernel as `refine_pose`
        weight = 1.0 / (1.0 + (rotation_residual(rotation, matches) / scale) ** 2) ** 2
        rotation = nearest_rotation(np.einsum("n,ni,nj->ij", weight, matches.first, matches.second))
    return np.asarray(rotation)


def _frames(pairs: np.ndarray) -> np.ndarray:
    """``(batch, 3, 3)`` whose columns are two directions and what is orthogonal to both."""
    return np.stack([pairs[:, 0], pairs[:, 1], np.cross(pairs[:, 0], pairs[:, 1])], axis=2)


def rotation_residual(rotation: Float[np.ndarray, "3 3"], matches: Matches) -> Float[np.ndarray, " n"]:
    """Angle in radians between each first direction and the second one, turned."""
    return angle_between(matches.first, matches.second @ rotation.T)
