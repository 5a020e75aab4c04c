"""Planes found by a sweep: the second image is warped onto each plane of a family and compared with the first one.

Windows that face the camera do not match on the ground between two distant cameras, where each image foreshortens it
differently. Windows that lie on the swept plane do. Gravity is known, so horizontal planes need one parameter only.

A plane counts if both panoramas find it. Planes are found one after the other: what one explains proposes no other.

Source: Gallup et al., Real-time plane-sweeping stereo with multiple sweeping directions, CVPR 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt64

from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.stereo.costs import CENSUS_RADIUS, census_transform, luminance_of, surface_cost
from omnisyn_cli.stereo.rectify import HALF_TURN_ABOUT_Z, RectifiedPair

__all__ = ["SweepDirection", "plane_from_second", "sweep_planes"]

SWEEP_ROWS = 128
"""Rows of the images that are swept. At twice as many the same planes are found in four times the time."""

NEAREST_PLANE_BASELINES, FARTHEST_PLANE_BASELINES = 0.08, 4.0
"""Of swept planes from the first camera, in baselines. Farther ones are matched well enough by upright windows."""

SWEEP_STEPS = 64
"""Planes between these distances: each is 6 % farther than the one before."""

MIN_INCIDENCE_SINE = 0.14
"""Sine of the angle (8°) between a ray and a plane: rays that graze it more closely are not compared."""

MIN_TEXTURE_VARIANCE = 1e-4
"""Variance of the luminance in a window, which is (2.5/255)²: less texture decides nothing."""

GOOD_COST = 0.28
"""A pixel speaks for a plane by what its cost is below this. Unrelated windows have a cost of about 1."""

EXPLAINED_COST = 0.2
"""A pixel with a lower cost is explained by the plane and speaks for no other one."""

SWEEP_COLOUR_WEIGHT, SWEEP_COLOUR_TRUNCATION = 0.3, 0.1
"""As ``colour_weight`` and ``colour_truncation`` of matching; less of the first, because exposures may differ."""

MIN_INVERSE_DISTANCE, MIN_SECOND_DISTANCE = 1e-6, 1e-3
"""In 1/baselines and in baselines: farther planes are infinity, and nearer ones pass through the second camera."""

MAX_SWEPT_PLANES = 4
"""Per pair; the next ones explained less than a hundredth of the sphere on generated scenes."""

PEAK_HALF_WIDTH = 4
"""Steps of the sweep to either side of a plane that propose no other one: its own flank, 26 % nearer or farther."""

MIN_PEAK_RATIO = 2.0
"""Least score of a plane over the median of all distances of its direction, in both panoramas."""

MIN_PEAK_EXCESS = 0.002
"""Least score of a plane above that median, as a share of the textured sphere that it explains perfectly."""

REFINE_ROUNDS = 12
"""Of the pattern search in the swept images; its steps halve whenever none of them is better."""

FINE_ROUNDS = 6
"""Of the search in the pair, which begins near the best plane."""

REFINE_DISTANCE_STEP, REFINE_TILT_STEP = 0.02, math.radians(1.0)
"""First steps of the search in the swept images: share of the distance, and radians. In the pair they are a quarter."""


@dataclass(frozen=True)
class SweepDirection:
    """One image of a pair that planes are compared in, with the other one that is warped onto them."""

    pair: RectifiedPair

    @cached_property
    def census(self) -> UInt64[np.ndarray, "height width"]:
        """Signatures of the first image."""
        return census_transform(luminance_of(self.pair.first))

    @cached_property
    def weight(self) -> Float32[np.ndarray, "height width"]:
        """Share of each textured pixel in their total solid angle; 0 without texture and where a mask is."""
        weight = np.sin(self.pair.grid.polar_angle) * (is_textured(self.pair.first) & self.pair.first_usable)
        return np.asarray(weight / max(float(weight.sum()), 1e-9), np.float32)

    def cost(self, normal: Float[np.ndarray, " 3"]) -> Float32[np.ndarray, "height width"]:
        """Matching cost of a plane where rays meet it and there is texture; 1 elsewhere."""
        inverse_depth = self.pair.grid.directions @ normal
        compared = (inverse_depth > MIN_INCIDENCE_SINE * np.linalg.norm(normal)) & (self.weight > 0)
        disparity = np.where(compared, self.pair.grid.disparity(inverse_depth), np.float32(-1.0))
        cost = surface_cost(
            self.pair.first, self.census, self.pair.second, self.pair.second_usable, disparity.astype(np.float32),
            SWEEP_COLOUR_WEIGHT, SWEEP_COLOUR_TRUNCATION,
        )  # fmt: skip
        return np.where(compared, cost, np.float32(1.0))

    def score(self, normal: Float[np.ndarray, " 3"]) -> float:
        """How much of the textured sphere a plane explains, in [0, 1]."""
        return float((np.maximum(1.0 - self.cost(normal) / GOOD_COST, 0.0) * self.weight).sum())


Directions = tuple[SweepDirection, SweepDirection]


def is_textured(image: Float[np.ndarray, "height width 3"]) -> Bool[np.ndarray, "height width"]:
    """Where the luminance varies within a window of the census."""
    luminance = luminance_of(image)
    side = 2 * CENSUS_RADIUS + 1
    blur = partial(cv2.blur, ksize=(side, side))
    mean = filter_across_seam(blur, luminance, CENSUS_RADIUS)
    square = filter_across_seam(blur, luminance * luminance, CENSUS_RADIUS)
    return np.asarray(square - mean * mean > MIN_TEXTURE_VARIANCE)


def plane_from_second(normal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"] | None:
    """The plane as the second camera sees it, in the frame of the reversed pair.

    None if it is behind that camera, passes through it or is infinitely far. The second camera is one baseline along
    +y. The rule is its own inverse.
    """
    inverse_distance = float(np.linalg.norm(normal))
    if inverse_distance < MIN_INVERSE_DISTANCE:
        return None
    unit = normal / inverse_distance
    distance = 1.0 / inverse_distance - unit[1]
    return HALF_TURN_ABOUT_Z @ unit / distance if distance > MIN_SECOND_DISTANCE else None


def sweep_planes(pair: RectifiedPair, reverse: RectifiedPair) -> list[Float[np.ndarray, " 3"]]:
    """Horizontal planes below and above the cameras that both panoramas see, best supported first.

    Each is a normal in the frame of the pair, as long as the inverse distance of its plane from the first camera
    (1/baselines).

    Args:
        pair: of any size.
        reverse: the same, reversed.
    """
    rows = min(SWEEP_ROWS, pair.size[0])
    small = pair.resized((rows, 2 * rows))
    coarse = SweepDirection(small), SweepDirection(small.reversed())
    fine = SweepDirection(pair), SweepDirection(reverse)
    found = _greedy_planes(coarse, (-pair.grid.up, pair.grid.up))
    return [_refine(fine, _refine(coarse, normal, REFINE_ROUNDS, 1.0), FINE_ROUNDS, 0.25) for normal in found]


def _greedy_planes(directions: Directions, units: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """The planes that explain most, one after the other, each of what those before it leave unexplained."""
    distances = np.geomspace(NEAREST_PLANE_BASELINES, FARTHEST_PLANE_BASELINES, SWEEP_STEPS)
    volumes = [_score_volume(directions, unit, distances) for unit in units]
    weights = [direction.weight.ravel().copy() for direction in directions]
    found: list[np.ndarray] = []
    while len(found) < MAX_SWEPT_PLANES:
        peaks = [_peak(volume, weights) for volume in volumes]
        excess, at, sweep = max((*peak, k) for k, peak in enumerate(peaks))
        if excess < MIN_PEAK_EXCESS:
            break
        found.append(units[sweep] / distances[at])
        for weight, scores in zip(weights, volumes[sweep], strict=True):
            weight[scores[at - 1 : at + 2].max(axis=0) > 255 * (1.0 - EXPLAINED_COST / GOOD_COST)] = 0.0
        volumes[sweep][:, max(at - PEAK_HALF_WIDTH, 0) : at + PEAK_HALF_WIDTH + 1] = 0
    return found


def _score_volume(
    directions: Directions, unit: np.ndarray, distances: np.ndarray
) -> UInt8[np.ndarray, "2 distances pixels"]:
    """For both panoramas, each plane and pixel: how well it fits, of 255."""
    volume = np.zeros((2, len(distances), directions[0].weight.size), np.uint8)
    for k, distance in enumerate(distances):
        normals = unit / distance, plane_from_second(unit / distance)
        for direction, normal, scores in zip(directions, normals, volume[:, k], strict=True):
            if normal is not None:
                scores[:] = (np.maximum(1.0 - direction.cost(normal) / GOOD_COST, 0.0) * 255.0).ravel()
    return volume


def _peak(volume: np.ndarray, weights: list[np.ndarray]) -> tuple[float, int]:
    """Excess over the median and index of the best distance; an excess of 0 if there is no peak.

    Of both panoramas the worse one counts. A maximum at either end of the sweep is none.
    """
    # einsum sums in one order, whatever the number of threads; a matrix product does not
    scores = np.stack(
        [np.einsum("dp,p->d", each, weight) / 255.0 for each, weight in zip(volume, weights, strict=True)]
    )
    median = np.median(scores, axis=1, keepdims=True)
    excess, ratio = (scores - median).min(axis=0), (scores / np.maximum(median, 1e-4)).min(axis=0)
    at = int(excess.argmax())
    if at in (0, len(excess) - 1) or ratio[at] < MIN_PEAK_RATIO:
        return 0.0, at
    return float(excess[at]), at


def _refine(
    directions: Directions, normal: Float[np.ndarray, " 3"], rounds: int, step: float
) -> Float[np.ndarray, " 3"]:
    """Pattern search over distance and tilt for the plane that explains most in both panoramas."""
    step_distance, step_tilt = step * REFINE_DISTANCE_STEP, step * REFINE_TILT_STEP
    best = _score_in_both(directions, normal)
    for _ in range(rounds):
        improved = False
        for trial in _neighbours(normal, step_distance, step_tilt):
            score = _score_in_both(directions, trial)
            if score > best:
                best, normal, improved = score, trial, True
        if not improved:
            step_distance, step_tilt = step_distance / 2.0, step_tilt / 2.0
    return normal


def _score_in_both(directions: Directions, normal: np.ndarray) -> float:
    from_second = plane_from_second(normal)
    return directions[0].score(normal) + (directions[1].score(from_second) if from_second is not None else 0.0)


def _neighbours(normal: np.ndarray, step_distance: float, step_tilt: float) -> list[np.ndarray]:
    """The plane nearer and farther, and tilted four ways."""
    inverse_distance = float(np.linalg.norm(normal))
    unit = normal / inverse_distance
    side = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    side /= np.linalg.norm(side)
    tilted = [unit + sign * step_tilt * axis for axis in (side, np.cross(unit, side)) for sign in (1.0, -1.0)]
    return [
        normal * (1.0 + step_distance),
        normal / (1.0 + step_distance),
        *(inverse_distance * each / np.linalg.norm(each) for each in tilted),
    ]
