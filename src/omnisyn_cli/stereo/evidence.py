"""What matching found out about a panorama, and how a network that knows rooms and streets is told about it.

Everything is dimensionless: distances count in baselines, and inverse depth enters the network as its square root,
even steps of which are nearly even steps of parallax.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.geometry.lookup import Lookup
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import seen_from_second

__all__ = ["GREATEST_ROOT", "Answer", "Evidence", "PlanesNetwork", "evidence_planes", "root_of"]

Answer = tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]
"""Inverse depth in 1/baselines, and confidence."""

GREATEST_ROOT = 2.0
"""Roots are clipped here: a quarter of a baseline away."""

PLANES = 19
"""Channels of :func:`evidence_planes`."""


class PlanesNetwork(Protocol):
    """A trained network that is shown planes of a panorama of a pair, however it is run."""

    def __call__(self, planes: Float32[np.ndarray, "planes height width"]) -> Answer:
        """Inverse depth × baseline, and the probability that it is within 10 %."""
        ...


@dataclass(frozen=True)
class Evidence:
    """One panorama of a pair as matching sees it, in the frame of its own camera; inverse depths in 1/baselines.

    Attributes:
        image: ``(height, width, 3)`` RGB in [0, 1].
        matched: ``(height, width)`` the best match of every pixel, right or wrong.
        agreed: ``(height, width)`` where both directions found the same.
        sky: ``(height, width)`` infinitely far.
        filled: ``(height, width)`` what agreed or is sky, carried on into the rest.
        usable: ``(height, width)`` False where a mask forbids the image.
        second_from_first: takes points of this camera's frame to the other one's, in baselines.
        up: ``(3,)`` the world's up in this camera's frame.
    """

    image: Float32[np.ndarray, "height width 3"]
    matched: Float[np.ndarray, "height width"]
    agreed: Bool[np.ndarray, "height width"]
    sky: Bool[np.ndarray, "height width"]
    filled: Float[np.ndarray, "height width"]
    usable: Bool[np.ndarray, "height width"]
    second_from_first: Pose
    up: Float[np.ndarray, " 3"]

    @property
    def sure(self) -> Bool[np.ndarray, "height width"]:
        """Where matching answers for itself: what agreed, and the sky."""
        return np.asarray(self.agreed | self.sky)


def evidence_planes(evidence: Evidence, other: Evidence) -> Float32[np.ndarray, "planes height width"]:
    """The input of a completion network for one panorama, given the evidence of both.

    In order: the image (3); roots of the filled and of the matched map; agreed, sky, usable; the other image where the
    filled (3) and where the matched map (3) says that it shows the same point; how much farther (roots) the other
    panorama's own map is at the former place than expected, and whether it is sure there; cosine to the direction of
    the other camera; sine of the elevation; root of the matched map where both directions agreed.
    """
    directions = pixel_directions(*evidence.filled.shape)
    (moved, expected), (moved_matched, _) = (
        seen_from_second(directions, each, evidence.second_from_first) for each in (evidence.filled, evidence.matched)
    )
    filled_at, matched_at = (Lookup.along(each, other.filled.shape) for each in (moved, moved_matched))
    towards = evidence.second_from_first.inverse().position
    matched = root_of(evidence.matched)
    planes = [
        *np.moveaxis(evidence.image, -1, 0),
        root_of(evidence.filled),
        matched,
        evidence.agreed,
        evidence.sky,
        evidence.usable,
        *np.moveaxis(filled_at.bilinear(other.image), -1, 0),
        *np.moveaxis(matched_at.bilinear(other.image), -1, 0),
        root_of(expected) - root_of(filled_at.nearest(other.filled)),
        filled_at.nearest(other.sure),
        directions @ (towards / np.linalg.norm(towards)),
        directions @ evidence.up,
        matched * evidence.agreed,
    ]
    return np.stack(planes).astype(np.float32)


def root_of(inverse_depth: Float[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """What networks see of inverse depth in 1/baselines."""
    return np.asarray(np.sqrt(np.clip(inverse_depth, 0.0, GREATEST_ROOT**2)))
