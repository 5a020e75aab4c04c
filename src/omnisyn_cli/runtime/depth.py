"""Depth of a pair by a trained network: turned into the network's frame, run both ways, checked, turned back."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry import sweep
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest, turned_directions, turned_image
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.runtime.session import run_depth_network
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["LearnedDepthEstimator"]

EDGE = 0.05
"""Where interpolation differs from the nearest pixel by more than this share, the nearest pixel is taken."""


class LearnedDepthEstimator:
    """Inverse depth of both panoramas by a network; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Estimates have as many rows as the network's images, and twice as many columns, whatever the size of the panoramas.
    Panoramas from one position have no parallax: everything is then 0 with confidence 0.

    Args:
        session: of a depth model, from :func:`omnisyn_cli.runtime.session.open_session`. Its metadata ``frame`` says
            how it wants panoramas held: ``epipole`` (also where it says nothing) or ``forward``, see
            :mod:`omnisyn_cli.geometry.sweep`.

    Raises:
        InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        self.session = session
        shapes = [tuple(entry.shape) for entry in session.get_inputs()]
        if len(shapes) != 2 or shapes[0] != shapes[1] or not all(isinstance(side, int) for side in shapes[0][-2:]):
            raise InputError(
                f"expected a depth model of two images of one fixed size, got inputs {shapes}; name another"
            )
        self.size: tuple[int, int] = (shapes[0][-2], shapes[0][-1])
        self._estimate_size = (self.size[0], 2 * self.size[0])
        name = session.get_modelmeta().custom_metadata_map.get("frame", "epipole")
        if name not in FRAMES:
            raise InputError(f"expected a depth model of the frame {' or '.join(FRAMES)}, got {name!r}; update omnisyn")
        self._frame = FRAMES[name]

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        for view in (first, second):
            view.check_shape()
        if np.array_equal(first.pose.position, second.pose.position):
            return self._nothing(), self._nothing()
        frame, _, baseline = self._frame.hold(first.pose, second.pose)
        exchange, onwards = self._frame.exchange, np.array(self._frame.onwards)
        images = [self._rectified(view, frame) for view in (first, second)]
        there, trust_there = self._run(images[0], images[1])
        back, trust_back = (exchange(x) for x in self._run(exchange(images[1]), exchange(images[0])))
        trust_there = trust_there * sweep.free_space_agreement(there, back, Pose(np.eye(3), -onwards))
        trust_back = trust_back * sweep.free_space_agreement(back, there, Pose(np.eye(3), onwards))
        return (
            self._estimate(first, frame, there / np.float32(baseline), trust_there),
            self._estimate(second, frame, back / np.float32(baseline), trust_back),
        )

    def _rectified(self, view: View, frame: Pose) -> Float[np.ndarray, "height width 3"]:
        """The panorama as a camera held like ``frame`` would have taken it, at the network's size."""
        return np.asarray(turned_image(view.image, view.pose.rotation, frame.rotation, self.size), np.float32)

    def _run(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inverse depth × baseline and confidence of ``first``, both in the network's frame."""
        names = [entry.name for entry in self.session.get_inputs()]
        images = [np.ascontiguousarray(image.transpose(2, 0, 1)[None]) for image in (first, second)]
        return run_depth_network(self.session, dict(zip(names, images, strict=True)), self.size)

    def _estimate(self, view: View, frame: Pose, inverse_depth: np.ndarray, trust: np.ndarray) -> DepthEstimate:
        """Both maps as the camera was held."""
        directions = turned_directions(self._estimate_size, frame.rotation, view.pose.rotation)
        confidence = np.clip(sample_bilinear(trust, directions), 0.0, 1.0)
        if view.mask is not None:
            own = pixel_directions(*self._estimate_size)
            confidence = confidence * sample_nearest(view.mask.astype(np.float32), own)
        inside = sample_between_edges(inverse_depth, directions)
        return DepthEstimate(inside.astype(np.float32), confidence.astype(np.float32))

    def _nothing(self) -> DepthEstimate:
        return DepthEstimate(np.zeros(self._estimate_size, np.float32), np.zeros(self._estimate_size, np.float32))


@dataclass(frozen=True)
class _Frame:
    """How a network wants panoramas held.

    Attributes:
        hold: turns both poses, see :func:`omnisyn_cli.geometry.sweep.epipole_frame`.
        exchange: an image as it looks when the roles of both cameras are exchanged; its own inverse.
        onwards: unit vector from the first camera to the second, in this frame.
    """

    hold: Callable[[Pose, Pose], tuple[Pose, Pose, float]]
    exchange: Callable[[np.ndarray], np.ndarray]
    onwards: tuple[float, float, float]


FRAMES: Mapping[str, _Frame] = {
    "epipole": _Frame(sweep.epipole_frame, sweep.exchanged_in_epipole_frame, (0.0, 1.0, 0.0)),
    "forward": _Frame(sweep.forward_frame, sweep.exchanged_in_forward_frame, (0.0, 0.0, -1.0)),
}
"""By the name in a model's metadata."""


def sample_between_edges(values: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Bilinear on surfaces, the nearest pixel at edges: nothing is invented between a thing and what is behind it."""
    smooth, nearest = sample_bilinear(values, directions), sample_nearest(values, directions)
    return np.asarray(np.where(np.abs(smooth - nearest) > EDGE * nearest, nearest, smooth))
