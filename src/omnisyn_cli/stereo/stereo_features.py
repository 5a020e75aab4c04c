"""What stereo knows about a panorama, and how the completion network is told.

Everything is dimensionless: distances count in baselines. Inverse depth enters the network as its square root, because
even steps of that are nearly even steps of parallax.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import reproject_to_second
from omnisyn_cli.geometry.tolerances import MAX_SQRT_INV_DEPTH
from omnisyn_cli.stereo.rectify import DepthPrior

# Inverse depth in 1/baselines, and confidence in [0, 1].
InvDepthWithConfidence = tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]
COMPLETION_CHANNEL_COUNT = 19  # channels of :func:`completion_channels`


class CompletionModel(Protocol):
    """A trained completion network, however it is run."""

    def __call__(self, channels: Float32[np.ndarray, "channels height width"]) -> InvDepthWithConfidence:
        """Inverse depth × baseline, and the probability that it is within 10 %."""
        ...


@dataclass(frozen=True)
class StereoFeatures:
    """One panorama of a pair as stereo sees it, in the frame of its own camera; inverse depths in 1/baselines."""

    image: Float32[np.ndarray, "height width 3"]  # RGB in [0, 1]
    matched: Float[np.ndarray, "height width"]  # inverse depth of the best match of every pixel, right or wrong
    left_right_consistent: Bool[np.ndarray, "height width"]  # where both directions found the same
    sky: Bool[np.ndarray, "height width"]  # infinitely far
    filled: Float[np.ndarray, "height width"]  # valid inverse depth, with planes extrapolated into the rest
    usable: Bool[np.ndarray, "height width"]  # False where a mask forbids the image
    second_from_first: Pose  # takes points of this camera's frame to the other one's, in baselines
    up: Float[np.ndarray, " 3"]  # the world's up in this camera's frame
    expected: DepthPrior | None = None  # what a network expects of the depth; None if none was asked

    @property
    def valid(self) -> Bool[np.ndarray, "height width"]:
        """Where stereo measured the depth: left-right consistent matches, and the sky."""
        return np.asarray(self.left_right_consistent | self.sky)


def completion_channels(
    features: StereoFeatures, other: StereoFeatures
) -> Float32[np.ndarray, "channels height width"]:
    """The input of a completion network for one panorama, given the features of both.

    In order, with √ for the square root of inverse depth:

    * 0 to 2: the image;
    * 3, 4: √ of the filled and of the matched map;
    * 5 to 7: left-right consistent, sky, usable;
    * 8 to 10: the other image, warped by the filled map; 11 to 13: the same by the matched map;
    * 14: how much farther (√) the other panorama's own map is there than the filled map expects; 15: whether it is
      valid there;
    * 16: cosine of the angle to the other camera; 17: sine of the elevation;
    * 18: √ of the matched map where it is left-right consistent.
    """
    directions = pixel_directions(*features.filled.shape)
    motion = features.second_from_first
    moved, expected = reproject_to_second(directions, features.filled, motion)
    moved_by_match, _ = reproject_to_second(directions, features.matched, motion)
    at_filled, at_matched = (RemapTable.for_directions(each, other.filled.shape) for each in (moved, moved_by_match))
    towards_other = motion.inverse().position
    matched = sqrt_inv_depth(features.matched)
    channels = [
        *np.moveaxis(features.image, -1, 0),
        sqrt_inv_depth(features.filled),
        matched,
        features.left_right_consistent,
        features.sky,
        features.usable,
        *np.moveaxis(at_filled.bilinear(other.image), -1, 0),
        *np.moveaxis(at_matched.bilinear(other.image), -1, 0),
        sqrt_inv_depth(expected) - sqrt_inv_depth(at_filled.nearest(other.filled)),
        at_filled.nearest(other.valid),
        directions @ (towards_other / np.linalg.norm(towards_other)),
        directions @ features.up,
        matched * features.left_right_consistent,
    ]
    return np.stack(channels).astype(np.float32)


def sqrt_inv_depth(inverse_depth: Float[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """The square root of inverse depth in 1/baselines, clipped: what networks are shown and answer with."""
    return np.asarray(np.sqrt(np.clip(inverse_depth, 0.0, MAX_SQRT_INV_DEPTH**2)))
