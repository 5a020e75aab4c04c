"""What a network expects of depth: a prior for matching, and filling.

Repeating tiles match a floor at the wrong height, and each panorama then agrees with the other one. A network that has
seen rooms knows better, though not exactly: its shapes are right, and off by a factor that changes slowly. So it is
asked first, and images are matched near what it expects. Where nothing matches, the factor comes from matches around.

Where it sees little parallax it guesses how large the place is. At the right scale, what it expects looks alike in both
images; and where most matches are wrong, pixels may lie on what it expects itself.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import filter_across_seam, rotated_directions, sample_bilinear
from omnisyn_cli.geometry.sphere import UP, solid_angles
from omnisyn_cli.geometry.sweep import forward_frame
from omnisyn_cli.stereo import rectify
from omnisyn_cli.stereo.descriptor_costs import likeness
from omnisyn_cli.stereo.disparity import DisparityMap, is_measurable
from omnisyn_cli.stereo.plane_fitting import PlanePoints, are_near, find_planes
from omnisyn_cli.stereo.plane_sweep import Directions, fit_plane
from omnisyn_cli.stereo.stereo_features import InvDepthWithConfidence, StereoFeatures
from omnisyn_cli.types import View

NETWORK_SIZE = (256, 512)  # height and width of the panoramas that the network sees
# The baseline that the network is told of: its answers end at one inverse depth in baselines, here at nearer surfaces.
# (The mean for 1.0 and 2.25 takes 0.8 s more; 23 generated walks gain 0.1 dB, nine real triples lose 0.1 dB.)
TOLD_BASELINE = 1.5
HALF_TURN_ABOUT_Y = np.diag([-1.0, 1.0, -1.0])  # the cameras exchange their places: what was behind is ahead
TOLERANCE_SHARE = 0.15  # error of √(inverse depth × baseline) that costs nothing, as a share of it
# Relative error of √(inverse depth) where depth is 10 % off. With its probability, the confidence, the scale of a
# Laplace distribution follows.
TEN_PERCENT = math.sqrt(1.1) - 1.0
# Matches that differ by more in the logarithm of inverse depth correct nothing: they may be wrong.
MAX_LOG_CORRECTION = 0.6
# Standard deviations as shares of the height: from the factor of half the sphere to that of the matches nearby.
CORRECTION_SCALES = (1 / 4, 1 / 8, 1 / 16, 1 / 32, 1 / 64)
COARSER_WEIGHT = 0.02  # weight of the coarser correction, against 1 for matches everywhere around
# Of the logarithm of inverse depth: a proposal that near to what is expected is preferred to it.
MAX_LOG_DIFFERENCE = 0.15
MIN_INVERSE_DEPTH = 1e-4  # in 1/baselines: all that is farther counts as that far
LOG_SCALES = 0.15 * np.arange(-7, 11)  # logarithms of the factors of inverse depth that are tried
# Likeness that a scale has to gain for each unit of its logarithm, and for each that panoramas differ by. (On 23
# generated walks scales are off by 12 % in the mean, and then by 5 %.)
UNCHANGED_SCALE_GAIN, COMMON_SCALE_GAIN = 0.03, 0.05


class PriorModel(Protocol):
    """A trained depth network that needs no matching, however it is run."""

    def __call__(
        self, first: Float32[np.ndarray, "3 height width"], second: Float32[np.ndarray, "3 height width"],
        towards: Float[np.ndarray, " 3"],
    ) -> InvDepthWithConfidence:  # fmt: skip
        """Inverse depth of the first panorama, and the probability that it is within 10 %.

        Both stand upright, and the second camera is ahead. Distances count in the unit of ``towards``, the way to it.
        """


Matches = tuple[DisparityMap, DisparityMap]  # what was matched in both directions of a pair
# Returns a pair with what is expected of both panoramas, given their views and matches: :func:`with_guided_priors`.
PairPrior = Callable[[rectify.RectifiedPair, View, View, Matches], rectify.RectifiedPair]


def with_guided_priors(
    pair: rectify.RectifiedPair, first: View, second: View, matches: Matches | None = None, *, model: PriorModel
) -> rectify.RectifiedPair:
    """The pair with what the network expects of both panoramas; it needs no matches.

    It is asked in one order of the two, whichever is the first one: exchanged panoramas get the same answers.
    """
    if pair.is_canonical_order:
        return replace(pair, priors=_priors(pair, first, second, model))
    return replace(pair, priors=_priors(pair.reversed(), second, first, model)[::-1])


def at_best_scale(pair: rectify.RectifiedPair, log_scales: np.ndarray = LOG_SCALES) -> rectify.RectifiedPair:
    """The pair whose priors have the scales at which descriptors of both images are most alike, as candidates.

    A network that sees little parallax guesses how large a room is. Matches do not tell: where few are right, many
    agree about a wrong scale. The pair as it is without priors or descriptors.
    """
    if pair.priors is None or pair.descriptors is None:
        return pair
    factors = np.exp(0.5 * log_scales).astype(np.float32)
    alike = np.array([[likeness(each, prior.scaled(f)) for f in factors] for each, prior in _both_sides(pair)])
    alike -= UNCHANGED_SCALE_GAIN * np.abs(log_scales)
    joint = alike[0][:, None] + alike[1] - COMMON_SCALE_GAIN * np.abs(log_scales[:, None] - log_scales)
    best = np.unravel_index(joint.argmax(), joint.shape)
    first, second = (prior.scaled(factors[k]) for prior, k in zip(pair.priors, best, strict=True))
    return replace(pair, priors=(first, second), are_priors_candidates=True)


def likeness_of_priors(pair: rectify.RectifiedPair) -> float:
    """How alike descriptors of both images are on the surfaces that priors expect, summed over both panoramas."""
    return sum(likeness(*side) for side in _both_sides(pair))


def _both_sides(pair: rectify.RectifiedPair) -> Iterable[tuple[rectify.RectifiedPair, rectify.DepthPrior]]:
    return zip((pair, pair.reversed()), pair.priors or (), strict=True)


def median_disagreement(pair: rectify.RectifiedPair, matches: Matches) -> float:
    """Of the logarithms of inverse depth that a prior expects and consistent matches say, but for a common factor.

    Infinite without a prior or matches: nothing tells then what the prior is worth.
    """
    if pair.priors is None:
        return math.inf
    medians = []
    for (each, prior), found in zip(_both_sides(pair), matches, strict=True):
        known = found.valid & is_measurable(each.grid, found.disparity)
        expected = log_inverse_depth(np.square(prior.sqrt_inv_depth))
        difference = log_inverse_depth(each.grid.inverse_depth(found.disparity)) - expected
        if not known.any():
            return math.inf
        medians.append(np.median(np.abs(difference[known] - np.median(difference[known]))))
    return float(np.mean(medians))


def _priors(
    pair: rectify.RectifiedPair, first: View, second: View, model: PriorModel
) -> tuple[rectify.DepthPrior, rectify.DepthPrior]:
    right = forward_frame(first.pose, second.pose)[0].rotation[:, 0]
    upright = np.stack([right, UP, np.cross(right, UP)], axis=1)  # the second camera ahead
    motion = upright.T @ (second.pose.position - first.pose.position)
    towards = motion / np.linalg.norm(motion)
    pictures = _turned(first, upright), _turned(second, upright)
    of_first = _prior(*pictures, towards, model)
    # Half a turn later the first camera is ahead. A panorama is turned by moving its columns.
    own, other = (np.roll(each, NETWORK_SIZE[1] // 2, axis=-1) for each in pictures[::-1])
    of_second = _prior(own, other, HALF_TURN_ABOUT_Y @ -towards, model)
    frame, size = pair.world_from_frame, pair.size
    return (
        in_frame(frame, size, upright, of_first),
        in_frame(frame @ rectify.HALF_TURN_ABOUT_Z, size, upright @ HALF_TURN_ABOUT_Y, of_second),
    )


def in_frame(
    world_from_frame: Float[np.ndarray, "3 3"], size: tuple[int, int], world_from_prior: Float[np.ndarray, "3 3"],
    prior: rectify.DepthPrior,
) -> rectify.DepthPrior:  # fmt: skip
    """A prior in a frame of another orientation and ``size``, given the orientation that it has."""
    directions = rotated_directions(size, world_from_prior, world_from_frame)
    return prior.remapped(RemapTable.for_directions(directions, NETWORK_SIZE))


def _prior(
    own: Float32[np.ndarray, "3 height width"], other: Float32[np.ndarray, "3 height width"],
    towards: Float[np.ndarray, " 3"], model: PriorModel,
) -> rectify.DepthPrior:  # fmt: skip
    """What the network expects of a panorama, as it sees it."""
    inverse_depth, confidence = model(own, other, towards * TOLD_BASELINE)
    sqrt_inv_depth = np.sqrt(inverse_depth * TOLD_BASELINE)
    spread = -TEN_PERCENT / np.log1p(-np.clip(confidence, rectify.MIN_CONFIDENCE, 0.999))
    tolerance = np.maximum(sqrt_inv_depth, rectify.MIN_SQRT_INV_DEPTH) * (TOLERANCE_SHARE + spread)
    return rectify.DepthPrior(*(np.asarray(each, np.float32) for each in (sqrt_inv_depth, tolerance, confidence)))


def _turned(view: View, frame: Float[np.ndarray, "3 3"]) -> Float32[np.ndarray, "3 height width"]:
    """The panorama as the network sees it; turned at twice the size, so that it stays sharp."""
    rows = 2 * NETWORK_SIZE[0]
    image = resize_area(view.image, (rows, 2 * rows)) if view.image.shape[0] > rows else view.image
    turned = sample_bilinear(image, rotated_directions((rows, 2 * rows), view.pose.rotation, frame))
    return np.ascontiguousarray(np.moveaxis(resize_area(turned, NETWORK_SIZE), -1, 0))


def fill_as_expected(features: StereoFeatures, completed: InvDepthWithConfidence) -> InvDepthWithConfidence:
    """Inverse depth and confidence, replaced where stereo is not valid; the same where nothing is expected."""
    if features.expected is None:
        return completed
    inverse_depth, confidence = completed
    measured = log_inverse_depth(inverse_depth)
    expected = log_inverse_depth(np.square(features.expected.sqrt_inv_depth))
    expected = expected + smooth_from_known(measured - expected, features.valid)
    best, least = expected, np.full(expected.shape, MAX_LOG_DIFFERENCE)
    for proposal in (log_inverse_depth(features.filled), log_inverse_depth(features.matched)):
        difference = np.abs(proposal - expected)
        best, least = np.where(difference < least, proposal, best), np.minimum(difference, least)
    is_confirmed = np.abs(measured - expected) < MAX_LOG_DIFFERENCE
    filled = np.where(features.valid | is_confirmed, inverse_depth, np.exp(best)).astype(np.float32)
    of_network = features.expected.confidence
    its_confidence = np.where(is_confirmed, np.maximum(confidence, of_network), of_network)
    return filled, np.where(features.valid, confidence, its_confidence)


def log_inverse_depth(inverse_depth: Float[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """Its logarithm; all that is very far counts as equally far."""
    return np.asarray(np.log(np.maximum(inverse_depth, MIN_INVERSE_DEPTH)))


def smooth_from_known(
    difference: Float[np.ndarray, "height width"], valid: Bool[np.ndarray, "height width"]
) -> Float32[np.ndarray, "height width"]:
    """A smooth map from the differences at valid pixels: normalised convolutions, each completed by the coarser one.

    Differences beyond :data:`MAX_LOG_CORRECTION` do not count.
    """
    height = len(difference)
    is_used = valid & (np.abs(difference) < MAX_LOG_CORRECTION)
    areas = solid_angles(*difference.shape)
    weight = (is_used * areas / areas.max()).astype(np.float32)
    total = max(float(weight.sum()), 1e-9)
    correction = np.full(difference.shape, (weight * difference).sum() / total, np.float32)
    for scale in CORRECTION_SCALES:
        sigma = scale * height
        blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=sigma, borderType=cv2.BORDER_REFLECT)
        around, sums = (filter_across_seam(blur, each, int(3 * sigma)) for each in (weight, weight * difference))
        correction = (sums + COARSER_WEIGHT * correction) / (around + COARSER_WEIGHT)
    return correction


EXPECTED_SIZE = (64, 128)  # rows and columns of the expected depth that planes are fitted to
MIN_PLANE_CONFIDENCE, MIN_PLANE_INVERSE_DEPTH = 0.4, 0.02  # of the pixels that take part; the second in 1/baselines
RELATIVE_TOLERANCE = 0.05  # of inverse depth, for pixels of a plane
# The number of planes, and the share of the pixels' solid angle that each has to explain.
MAX_PLANES, MIN_SUPPORT = 16, 0.004
# A fitted plane that turns by more than 14° or moves by more than a quarter has gone to another surface.
MIN_PARALLEL_COSINE, MAX_DISTANCE_FACTOR = 0.97, 1.25

# An expected floor or ceiling nearer to a swept one is that one, less exactly. On 31 wide walks 1.1 % more of what is
# below the horizon is within 5 % without such copies. Walls may stand that near each other: homes lose without them.
MAX_FLOOR_DISTANCE_FACTOR = 1.4


def expected_planes(
    pair: rectify.RectifiedPair, directions: tuple[Directions, Directions], swept: Float[np.ndarray, "swept 3"]
) -> Float[np.ndarray, "planes 3"]:
    """Planes of the expected depth, moved to where the images match best: normals in the frame of the pair, or none.

    A sweep finds a plane if enough windows match on it, wherever it is. Far apart, cameras see walls too differently
    for that. The network says where planes are to within some 10 %, and so near a plane a linear fit finds the rest.
    The best supported come first; what no texture can move stays. The sweep had these directions, and found ``swept``.
    """
    small = pair if pair.priors is None else pair.resized(EXPECTED_SIZE)
    if small.priors is None:
        return np.zeros((0, 3))
    points = _plane_points(small.grid, small.priors[0]), _plane_points(small.reversed().grid, small.priors[1])
    expected = find_planes(points, pair.grid.up, max_planes=MAX_PLANES, min_support=MIN_SUPPORT)
    fitted = [fit_plane(directions, normal) for normal in expected]
    planes = [
        after if are_near(before, after, MIN_PARALLEL_COSINE, MAX_DISTANCE_FACTOR) else before
        for before, after in zip(expected, fitted, strict=True)
    ]
    floors = [plane for plane in swept if abs(plane @ pair.grid.up) > MIN_PARALLEL_COSINE * np.linalg.norm(plane)]
    near_floor = partial(are_near, min_cosine=MIN_PARALLEL_COSINE, distance_factor=MAX_FLOOR_DISTANCE_FACTOR)
    return np.reshape([plane for plane in planes if not any(near_floor(floor, plane) for floor in floors)], (-1, 3))


def _plane_points(grid: rectify.EpipolarGrid, prior: rectify.DepthPrior) -> PlanePoints:
    """The pixels of a grid that the network is sure of."""
    inverse_depth = np.square(prior.sqrt_inv_depth, dtype=np.float64)
    row, col = np.nonzero((prior.confidence > MIN_PLANE_CONFIDENCE) & (inverse_depth > MIN_PLANE_INVERSE_DEPTH))
    found = inverse_depth[row, col]
    solid_angle = np.sin(grid.polar_angle[row, 0])
    return PlanePoints(grid.directions[row, col], found, RELATIVE_TOLERANCE * found, solid_angle, row, col)
