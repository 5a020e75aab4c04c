"""Both panoramas of a pair turned until epipolar lines are meridians, and estimates turned back.

Everything between is dimensionless: distances count in baselines, so inverse depth is ``ρ · baseline``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.compute.threads import both
from omnisyn_cli.geometry.lookup import Lookup
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear, turned_directions
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.geometry.sweep import epipole_frame, exchanged_in_epipole_frame
from omnisyn_cli.types import View

HALF_TURN = np.diag([-1.0, -1.0, 1.0])
"""Seen from the second panorama the first one lies at the zenith once the frame is turned upside down about z."""


@dataclass(frozen=True)
class RectifiedPair:
    """Two images of one orientation; the second camera lies at the zenith (+y) of the first.

    Attributes:
        first, second: ``(height, width, 3)`` float32 RGB in [0, 1].
        first_usable, second_usable: ``(height, width)``; False where a mask forbids it.
        world_from_frame: ``(3, 3)`` orientation of both.
        baseline: metres.
    """

    first: Float[np.ndarray, "height width 3"]
    second: Float[np.ndarray, "height width 3"]
    first_usable: Bool[np.ndarray, "height width"]
    second_usable: Bool[np.ndarray, "height width"]
    world_from_frame: Float[np.ndarray, "3 3"]
    baseline: float

    @property
    def size(self) -> tuple[int, int]:
        """``(height, width)`` of the images."""
        return self.first.shape[0], self.first.shape[1]

    @property
    def up(self) -> Float[np.ndarray, " 3"]:
        """The world's up in the frame of the pair."""
        return np.asarray(self.world_from_frame.T @ UP)

    def reversed(self) -> RectifiedPair:
        """The same pair seen from the second panorama."""
        return RectifiedPair(
            first=exchanged_in_epipole_frame(self.second),
            second=exchanged_in_epipole_frame(self.first),
            first_usable=exchanged_in_epipole_frame(self.second_usable),
            second_usable=exchanged_in_epipole_frame(self.first_usable),
            world_from_frame=self.world_from_frame @ HALF_TURN,
            baseline=self.baseline,
        )

    def from_camera(self, pose: Pose, size: tuple[int, int]) -> Lookup:
        """Where images of the first panorama in this frame show what its camera, held as it was, has in each pixel."""
        return Lookup.along(turned_directions(size, self.world_from_frame, pose.rotation), self.size)


def rectify(first: View, second: View, size: tuple[int, int]) -> RectifiedPair:
    """The pair at ``size = (height, width)``; raises ValueError for equal positions."""
    frame, _, baseline = epipole_frame(first.pose, second.pose)
    images = both(*(partial(_turned, view, frame, size) for view in (first, second)))
    usable = [_turn_mask(v, frame, size) for v in (first, second)]
    return RectifiedPair(images[0], images[1], usable[0], usable[1], frame.rotation, baseline)


def _turned(view: View, frame: Pose, size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
    """The picture of a view at another size and in another frame."""
    return _turn(resize_area(view.image, size), view.pose, frame, size)


def resize_area(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Averages over the area that a new pixel covers; growing by a whole factor repeats pixels.

    No new pixel covers anything beyond the border, so seam and poles need no care.
    """
    if image.shape[:2] == size:
        return np.asarray(image, np.float32)
    return np.asarray(cv2.resize(np.ascontiguousarray(image, np.float32), size[::-1], interpolation=cv2.INTER_AREA))


def _turn(image: np.ndarray, pose: Pose, frame: Pose, size: tuple[int, int]) -> np.ndarray:
    """Exactly: matching would tell the steps of 1/32 of a pixel that a :class:`Lookup` takes."""
    return np.asarray(sample_bilinear(image, turned_directions(size, pose.rotation, frame.rotation)), np.float32)


def usable_pixels(view: View, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """The mask of a view at another size: True where no forbidden pixel contributes."""
    if view.mask is None:
        return np.ones(size, bool)
    return np.asarray(resize_area(view.mask.astype(np.float32), size) > 0.99)


def _turn_mask(view: View, frame: Pose, size: tuple[int, int]) -> np.ndarray:
    if view.mask is None:
        return np.ones(size, bool)
    return np.asarray(_turn(usable_pixels(view, size).astype(np.float32), view.pose, frame, size) > 0.99)
