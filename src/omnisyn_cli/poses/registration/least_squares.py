"""The relative pose that fits all matches best, from one that fits roughly.

Iteratively reweighted least squares on the angles to the epipolar circles, over rotations and unit directions: five
numbers, each step in the tangent space, damped as by Levenberg and Marquardt. Weights are those of Geman and McClure,
so that wrong matches lose their influence; the scale shrinks from step to step down to the noise that is found.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from omnisyn_cli.geometry.pose import Pose, rotation_angle, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import normalize
from omnisyn_cli.poses.registration.features import Matches

MIN_SQUARED_SINE = 1e-12  # Squared sine of the angle below which two directions span no plane


def relative_pose(first: Pose, second: Pose) -> Pose:
    """``first_from_second`` with a unit vector between the cameras, or zero where they stand in one place."""
    pose = first.inverse() @ second
    return Pose(pose.rotation, np.asarray(normalize(pose.position)))


def epipolar_residual(first_from_second: Pose, matches: Matches) -> Float[np.ndarray, " n"]:
    """Signed angle in radians between each direction and the great circle that the other one gives it.

    The sine of the angle is taken as the quadratic mean of both sides, which is √2 times the first-order (Sampson)
    distance to the nearest pair of directions that fits; it stays bounded at the epipoles.
    """
    turned = matches.second @ first_from_second.rotation.T
    across = cross_matrices(first_from_second.position).T
    plane_of_second, plane_of_first = turned @ across, matches.first @ across
    triple = np.einsum("ni,ni->n", matches.first, plane_of_second)
    squared = 0.5 * (np.sum(plane_of_second**2, axis=1) + np.sum(plane_of_first**2, axis=1))
    sine = triple / np.sqrt(np.where(squared > MIN_SQUARED_SINE, squared, 1.0))
    return np.asarray(np.arcsin(sine.clip(-1.0, 1.0)))


def is_in_front(first_from_second: Pose, matches: Matches, slack: float = 0.0) -> Bool[np.ndarray, " n"]:
    """Whether both cameras see each point where it is, not behind their backs (cheirality).

    With θ₁ and θ₂ the angles that the two directions make with t, a point in front has θ₂ > θ₁. Points that moved by
    less than ``slack`` radians are far away and count as in front.
    """
    turned = matches.second @ first_from_second.rotation.T
    cosine = np.einsum("ni,ni->n", matches.first, turned)
    cosine_first, cosine_second = matches.first @ first_from_second.position, turned @ first_from_second.position
    is_far = (1.0 - cosine**2 <= math.sin(slack) ** 2) & (cosine > 0)
    return np.asarray(((cosine_first > cosine_second * cosine) & (cosine_first * cosine > cosine_second)) | is_far)


def angle_between(a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle in radians between vectors of any length; exact for small ones."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def cross_matrices(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """``[v]`` with ``[v]·w = v × w``."""
    matrices = np.zeros((*vectors.shape, 3))
    for k in range(3):
        matrices[..., k, k - 2] = -vectors[..., k - 1]
        matrices[..., k, k - 1] = vectors[..., k - 2]
    return matrices


def sphere_cells(
    directions: Float[np.ndarray, "n 3"], side: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " cells"]]:
    """The cell that each direction lies in, and how many lie in each; cells have a ``side`` in radians."""
    _, cell, count = np.unique(np.floor(directions / side), axis=0, return_inverse=True, return_counts=True)
    return cell.ravel(), count


def rotation_error(pose: Pose, truth: Pose) -> float:
    """Radians between the rotations of two relative poses."""
    return float(rotation_angle(truth.rotation.T @ pose.rotation))


def direction_error(pose: Pose, truth: Pose) -> float:
    """Radians between the directions to the second camera of two relative poses."""
    return float(angle_between(pose.position, truth.position))


MAX_ITERATIONS = 20  # Of Levenberg and Marquardt; the search usually ends earlier by :data:`MIN_STEP`
MIN_STEP = 1e-8  # Radians: smaller steps end the search
MAD_TO_STD = 1.4826  # Standard deviation of a normal distribution over its median absolute value
MIN_NOISE = 1e-7  # Radians; no residual is weighted as if it were better than this

# Side of the cells that are left out. Over 47 generated pairs the errors are 1.1 times the stated deviations in their
# quadratic mean; with 5° it is 1.5, and if all matches err independently 4.
JACKKNIFE_ANGLE = math.radians(20.0)


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of the whole error: the root of the mean square of its angle, in radians."""

    rotation: float
    direction: float


def refine_pose(start: Pose, matches: Matches, scale: float) -> Pose:
    """Refine ``first_from_second`` with a position of length 1; matches are wrong beyond ``scale`` radians."""
    pose, damping = start, 1e-4
    spread = 3.0 * scale  # wide at first, so that a rough start still sees the right matches
    residual = epipolar_residual(pose, matches)
    weight = _weights(pose, matches, residual, spread)
    for _ in range(MAX_ITERATIONS):
        jacobian = _jacobian(pose, matches)
        # sums in a fixed order: a matrix product would depend on the number of threads in its last digits
        hessian = np.einsum("ni,n,nj->ij", jacobian, weight, jacobian)
        gradient = np.einsum("ni,n,n->i", jacobian, weight, residual)
        hessian += damping * np.diag(np.diag(hessian) + 1e-12)
        try:
            step = -np.linalg.solve(hessian, gradient)
        except np.linalg.LinAlgError:  # no match is near enough to say anything
            break
        tried = retract(pose, step)
        residual_there = epipolar_residual(tried, matches)
        better = np.sum(weight * residual_there**2) <= np.sum(weight * residual**2)
        damping = damping * 0.1 if better else damping * 10.0
        if better:
            pose, residual = tried, residual_there
            # graduated non-convexity: the kernel narrows by at most 0.6 a step, down to the noise
            spread = max(0.6 * spread, min(scale, _kernel_width(residual, scale)))
            weight = _weights(pose, matches, residual, spread)
        if np.linalg.norm(step) < MIN_STEP:
            break
    return pose


def retract(pose: Pose, step: Float[np.ndarray, " 5"]) -> Pose:
    """The pose turned by a rotation vector (three numbers, radians) and its direction moved by two angles."""
    across = _tangent(pose.position) @ step[3:]
    position = pose.position + across
    return Pose(rotation_from_rotation_vector(step[:3]) @ pose.rotation, position / np.linalg.norm(position))


def noise_std(pose: Pose, matches: Matches) -> float:
    """Standard deviation of the residuals in radians, robustly; for matches that fit."""
    return max(MAD_TO_STD * float(np.median(np.abs(epipolar_residual(pose, matches)))), MIN_NOISE)


def robust_chi_squared(pose: Pose, matches: Matches, noise: float) -> float:
    """Sum of squared residuals in units of ``noise``; a match counts 9 at most (Geman and McClure)."""
    squared = (epipolar_residual(pose, matches) / (3.0 * noise)) ** 2
    return float(9.0 * np.sum(squared / (1.0 + squared)))


def uncertainty(pose: Pose, matches: Matches) -> Uncertainty:
    """How well matches that fit determine rotation and direction; infinite where they do not.

    The matches of one thing err together, so whole cells of the sphere are left out in turn (a jackknife), those of the
    panorama that makes it less certain. Source: Cameron, Gelbach and Miller, Bootstrap-based improvements for inference
    with clustered errors, 2008.
    """
    jacobian, residual = _jacobian(pose, matches), epipolar_residual(pose, matches)
    variances = [
        _jackknife_variances(jacobian, residual, sphere_cells(directions, JACKKNIFE_ANGLE)[0])
        for directions in (matches.first, matches.second)
    ]
    return Uncertainty(*np.sqrt(np.max(variances, axis=0)).tolist())


def _jackknife_variances(jacobian: np.ndarray, residual: np.ndarray, cell: np.ndarray) -> tuple[float, float]:
    """Summed variances of the three numbers of the rotation and the two of the direction."""
    counts = int(cell.max(initial=0)) + 1
    hessians, gradients = np.zeros((counts, 5, 5)), np.zeros((counts, 5))
    np.add.at(hessians, cell, jacobian[:, :, None] * jacobian[:, None, :])
    np.add.at(gradients, cell, jacobian * residual[:, None])
    without = hessians.sum(axis=0) - hessians
    if counts < 2 or np.linalg.cond(without).max() > 1e14:  # singular in float64
        return math.inf, math.inf
    moved = np.linalg.solve(without, gradients[..., None])[..., 0]
    variances = (counts - 1) / counts * np.sum(moved**2, axis=0)
    return float(variances[:3].sum()), float(variances[3:].sum())


def _tangent(direction: np.ndarray) -> np.ndarray:
    """Two orthogonal unit vectors across a direction, as columns (Duff et al., Building an orthonormal basis, 2017)."""
    x, y, z = direction.tolist()
    sign = math.copysign(1.0, z)
    share = 1.0 / (sign + z)
    mixed = -x * y * share
    return np.array([[1.0 - sign * x * x * share, mixed], [sign * mixed, sign - y * y * share], [-sign * x, -y]])


def _jacobian(pose: Pose, matches: Matches) -> np.ndarray:
    """Derivatives ``(n, 5)`` of the residuals by the step of :func:`retract`.

    With q = R·d₂ and s the quadratic mean of |t × q| and |d₁ × t|, the sine of a residual is d₁ · (t × q) / s. Changes
    of s are left out: they are weighted with the residual itself, which is small.
    """
    t, turned = pose.position, matches.second @ pose.rotation.T
    across = cross_matrices(t).T
    squared = 0.5 * (np.sum((matches.first @ across) ** 2, axis=1) + np.sum((turned @ across) ** 2, axis=1))
    cosine = np.einsum("ni,ni->n", matches.first, turned)
    by_rotation = matches.first * (turned @ t)[:, None] - t * cosine[:, None]
    by_direction = [np.einsum("ni,ni->n", turned @ cross_matrices(each).T, matches.first) for each in _tangent(t).T]
    derivative: np.ndarray = np.column_stack([by_rotation, *by_direction])
    return np.asarray(derivative / np.sqrt(np.maximum(squared, MIN_NOISE))[:, None])


def _kernel_width(residual: np.ndarray, scale: float) -> float:
    """Width of the robust kernel: three standard deviations of the matches that fit within ``scale``."""
    near = np.abs(residual)[np.abs(residual) < scale]
    return scale if near.size < 8 else max(3.0 * MAD_TO_STD * float(np.median(near)), 0.2 * scale)


def _weights(pose: Pose, matches: Matches, residual: np.ndarray, spread: float) -> np.ndarray:
    return np.asarray(is_in_front(pose, matches, spread) / (1.0 + (residual / spread) ** 2) ** 2)
