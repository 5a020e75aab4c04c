"""Depth of a pair by a trained network: turned into the network's frame, run both ways, checked, turned back."""

from typing import Any

import numpy as np

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.geometry.sampling import rotated_directions, rotated_image, sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import forward_frame, free_space_agreement, swap_cameras_in_forward_frame
from omnisyn_cli.geometry.tolerances import SAME_POINT_TOLERANCE
from omnisyn_cli.runtime.session import run_depth_network
from omnisyn_cli.types import DepthEstimate, View

FORWARD_DIRECTION = np.array([0.0, 0.0, -1.0])  # from the first camera to the second in the forward frame, in baselines


class LearnedDepthEstimator:
    """Inverse depth of both panoramas by a network; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Estimates have as many rows as the network's images, twice as many columns; without parallax 0 with confidence 0.
    The ``session`` wants panoramas held as :func:`omnisyn_cli.geometry.sweep.forward_frame` does, as its metadata
    ``frame`` says (``forward``). InputError: it is of another kind.
    """

    def __init__(self, session: Any) -> None:
        self.session = session
        shapes = [tuple(entry.shape) for entry in session.get_inputs()]
        if len(shapes) != 2 or shapes[0] != shapes[1] or not all(isinstance(side, int) for side in shapes[0][-2:]):
            raise InputError(
                f"expected a depth model of two images of one fixed size, got inputs {shapes}; name another"
            )
        self.size: tuple[int, int] = (shapes[0][-2], shapes[0][-1])
        frame = session.get_modelmeta().custom_metadata_map.get("frame")
        if frame != "forward":
            raise InputError(f"expected a depth model of the frame 'forward', got {frame!r}; name another")

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        for view in (first, second):
            view.check_shape()
        if at_same_position(first.pose, second.pose):
            nothing = np.zeros((4, self.size[0], 2 * self.size[0]), np.float32)
            return DepthEstimate(*nothing[:2]), DepthEstimate(*nothing[2:])
        frame, _, baseline = forward_frame(first.pose, second.pose)
        images = [
            np.asarray(rotated_image(view.image, view.pose.rotation, frame.rotation, self.size), np.float32)
            for view in (first, second)
        ]
        swapped = [swap_cameras_in_forward_frame(image) for image in reversed(images)]
        of_first, first_confidence = self._run(*images)
        of_second, second_confidence = (swap_cameras_in_forward_frame(x) for x in self._run(*swapped))
        first_agreement = free_space_agreement(of_first, of_second, Pose(np.eye(3), -FORWARD_DIRECTION))
        second_agreement = free_space_agreement(of_second, of_first, Pose(np.eye(3), FORWARD_DIRECTION))
        return (
            turned_estimate(first, frame, of_first / np.float32(baseline), first_confidence * first_agreement),
            turned_estimate(second, frame, of_second / np.float32(baseline), second_confidence * second_agreement),
        )

    def _run(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inverse depth × baseline and confidence of ``first``, both in the network's frame."""
        names = [entry.name for entry in self.session.get_inputs()]
        images = [np.ascontiguousarray(image.transpose(2, 0, 1)[None]) for image in (first, second)]
        return run_depth_network(self.session, dict(zip(names, images, strict=True)), self.size)


def turned_estimate(view: View, frame: Pose, inverse_depth: np.ndarray, confidence: np.ndarray) -> DepthEstimate:
    """Both maps, of a view held like ``frame``, as its camera was held; its mask takes confidence away.

    Depth is bilinear on surfaces, the nearest pixel's at edges: nothing is invented between things.
    """
    size = (len(inverse_depth), 2 * len(inverse_depth))
    directions = rotated_directions(size, frame.rotation, view.pose.rotation)
    confidence = np.clip(sample_bilinear(confidence, directions), 0.0, 1.0)
    if view.mask is not None:
        confidence = confidence * sample_nearest(view.mask.astype(np.float32), pixel_directions(*size))
    smooth, nearest = sample_bilinear(inverse_depth, directions), sample_nearest(inverse_depth, directions)
    inside = np.where(np.abs(smooth - nearest) > SAME_POINT_TOLERANCE * nearest, nearest, smooth)
    return DepthEstimate(np.asarray(inside, np.float32), confidence.astype(np.float32))
