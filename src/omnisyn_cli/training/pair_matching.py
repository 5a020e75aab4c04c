"""What matching says of the pairs of a walk, for the guidance of the guided depth network.

Pairs are matched once, when their walk is made, at half of the walk's size. They are matched as photographs would be:
with other colours, noise and small errors of the pose. So the network learns from the mistakes that matching makes.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, Shaped

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.stereo_features import StereoFeatures, sqrt_inv_depth
from omnisyn_cli.training.data import Augmentation, vary_colours
from omnisyn_cli.types import View

# √(inverse depth × baseline) of the best match, share that is left-right consistent, share that is sky, and the root of
# the filled map.
MATCHING_CHANNELS = 4
MATCHED_PAIRS = 3  # Of a walk: its ends, and two others
MATCHED_RATIOS = (0.02, 2.6)  # Baseline over median depth of pairs that are matched
# Share of the pairs with pose errors, and the standard deviations of the rotation and of the direction, radians.
POSE_ERROR_SHARE, TURN_ERROR, DIRECTION_ERROR = 0.4, 0.003, 0.008
CELL = 2  # Rows of matching that make one of the guidance


def views_to_match(ratios: Float[np.ndarray, "views views"], rng: np.random.Generator) -> list[tuple[int, int]]:
    """Pairs of views, the smaller index first, by ratios of baseline to the median depth of the first of two."""
    least, most = MATCHED_RATIOS
    is_usable = (ratios >= least) & (ratios <= most)
    rows, cols = np.nonzero(np.triu(is_usable | is_usable.T, 1))
    found = sorted(zip(rows.tolist(), cols.tolist(), strict=True), key=lambda pair: -ratios[pair])
    return found[:1] + [found[1:][k] for k in rng.permutation(len(found[1:]))[: MATCHED_PAIRS - 1]]


def draw_pose_error(rng: np.random.Generator) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """A second camera's error: a rotation, and what its direction is off by; mostly the identity and zeros."""
    if rng.random() >= POSE_ERROR_SHARE:
        return np.eye(3), np.zeros(3)
    return rotation_from_rotation_vector(rng.normal(0.0, TURN_ERROR, 3)), rng.normal(0.0, DIRECTION_ERROR, 3)


def match_views(
    images: Shaped[np.ndarray, "2 height width 3"], motion: Float[np.ndarray, " 3"], rng: np.random.Generator | None
) -> Float32[np.ndarray, "2 4 rows cols"]:
    """What matching says of both views of a pair, each turned so that the other one is ahead; a quarter of the size.

    Images are upright, eight bits, with one heading; ``motion`` to the second is in metres; no ``rng`` leaves all
    exact.
    """
    baseline = float(np.linalg.norm(motion))
    turned, ahead = facing_the_other(images, motion / baseline)
    colours, rotation = turned.astype(np.float32) / np.float32(255.0), np.eye(3)
    if rng is not None:
        colours = vary_colours(colours, rng, Augmentation())
        rotation, offset = draw_pose_error(rng)
        ahead = ahead + offset
    position = ahead * (baseline / np.linalg.norm(ahead))
    first, second = (
        View(np.ascontiguousarray(image), pose)
        for image, pose in zip(colours, (Pose(np.eye(3), np.zeros(3)), Pose(rotation, position)), strict=True)
    )
    options = replace(MatchingOptions(), size=images.shape[1:3])
    of_first, of_second = MatchingDepthEstimator(options, threads=1).features(first, second)
    half_turn = images.shape[2] // (4 * CELL)
    return np.stack([_cells(of_first), np.roll(_cells(of_second), half_turn, axis=-1)])


def _cells(features: StereoFeatures) -> Float32[np.ndarray, "4 rows cols"]:
    consistent, sky = (each.astype(np.float32) for each in (features.left_right_consistent, features.sky))
    maps = np.stack([sqrt_inv_depth(features.matched), consistent, sky, sqrt_inv_depth(features.filled)])
    return reduced_matching(maps.astype(np.float32), CELL)


def reduced_matching(matching: Float32[np.ndarray, "4 height width"], cell: int) -> Float32[np.ndarray, "4 rows cols"]:
    """Means over cells; of the best match over what is consistent in a cell, if anything is."""
    channels, height, width = matching.shape
    cells = matching.reshape(channels, height // cell, cell, width // cell, cell)
    means = cells.mean(axis=(2, 4))
    of_consistent = (cells[0] * cells[1]).mean(axis=(1, 3)) / np.maximum(means[1], 1e-6)
    means[0] = np.where(means[1] > 0, of_consistent, means[0])
    return np.asarray(means, np.float32)


def facing_the_other(
    images: Shaped[np.ndarray, "views height width *rest"], towards: Float[np.ndarray, " 3"]
) -> tuple[np.ndarray, Float[np.ndarray, " 3"]]:
    """Rolled by whole columns so that the other camera is ahead, and the direction to it in that frame."""
    width = images.shape[2]
    columns = round(math.atan2(towards[0], -towards[2]) / (2.0 * math.pi) * width)
    turn = columns / width * 2.0 * math.pi
    cosine, sine = math.cos(turn), math.sin(turn)
    ahead = np.array([cosine * towards[0] + sine * towards[2], towards[1], cosine * towards[2] - sine * towards[0]])
    return np.roll(images, -columns, axis=2), ahead
