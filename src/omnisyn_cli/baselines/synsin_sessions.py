"""SynSin's networks in ONNX Runtime: depth of one panorama, features of its pixels, a picture of blended points."""

from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.baselines.learned_depth import sample_between_edges
from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.sampling import rotated_directions, rotated_image, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.runtime.session import run_network
from omnisyn_cli.types import DepthEstimate, View

WORLD_ROTATION = np.eye(3)
"""World from camera of a panorama as the networks want it held: up is up, and it looks along the world's −z."""


def upright_image(view: View, size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
    """A panorama as the networks are shown it; ImageError for one that is not 2:1."""
    view.check_shape()
    return np.asarray(rotated_image(view.image, view.pose.rotation, WORLD_ROTATION, size), np.float32)


class MonocularDepthEstimator:
    """Inverse depth of each panorama by itself; a :class:`~omnisyn_cli.types.DepthEstimator`.

    It knows metres from what it was trained on, whatever the distance of the two panoramas, and says nothing about how
    far it can be trusted: its confidence is 1 wherever a panorama may be used.

    Args:
        session: of a monocular depth model, from :func:`omnisyn_cli.runtime.session.open_session`.

    Raises InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        self._session = session
        self.size = _size_of(session, "image", "inverse_depth")

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        return self._estimate(first), self._estimate(second)

    def inverse_depth(self, image: Float32[np.ndarray, "height width 3"]) -> Float32[np.ndarray, "height width"]:
        """1/metre of an upright panorama of :attr:`size`; InputError if the model is broken."""
        found: np.ndarray = _run(self._session, image, (1, *self.size))[0]
        if not (found >= 0).all():
            raise InputError("expected a model whose inverse depths are not negative, got others; name another")
        return found

    def _estimate(self, view: View) -> DepthEstimate:
        """Inverse depth as the camera was held."""
        found = self.inverse_depth(upright_image(view, self.size))
        directions = rotated_directions(self.size, WORLD_ROTATION, view.pose.rotation)
        confidence = np.ones(self.size, np.float32)
        if view.mask is not None:
            confidence = sample_nearest(view.mask.astype(np.float32), pixel_directions(*self.size))
        return DepthEstimate(sample_between_edges(found, directions).astype(np.float32), confidence)


class SynSinSessions:
    """The three networks together.

    Args:
        depth: session of the monocular depth model.
        encoder: of the model that makes features of a panorama.
        decoder: of the model that makes a picture of blended features; its metadata say how wide points are, in rows,
            and how many a pixel is made of.

    Raises InputError: one is of another kind, or they do not belong together.
    """

    def __init__(self, depth: Any, encoder: Any, decoder: Any) -> None:
        self.estimator = MonocularDepthEstimator(depth)
        self.size = self.estimator.size
        sizes = {self.size, _size_of(encoder, "image", "features"), _size_of(decoder, "points", "colour")}
        self._channels = int(encoder.get_outputs()[0].shape[1])
        if len(sizes) > 1 or decoder.get_inputs()[0].shape[1] != self._channels + 1:
            raise InputError("expected three SynSin models that were exported together, got others; reinstall them")
        self._encoder, self._decoder = encoder, decoder
        settings = decoder.get_modelmeta().custom_metadata_map
        try:
            self.radius, self.points = float(settings["radius"]), int(settings["points"])
        except (KeyError, ValueError) as error:
            raise InputError("expected a SynSin decoder that says how wide its points are, got none") from error

    def features(self, image: Float32[np.ndarray, "height width 3"]) -> Float32[np.ndarray, "height width channels"]:
        """Of an upright panorama of :attr:`size`."""
        return _channels_last(_run(self._encoder, image, (self._channels, *self.size)))

    def picture(self, points: Float32[np.ndarray, "height width channels"]) -> Float32[np.ndarray, "height width 3"]:
        """RGB in [0, 1] of blended features and, last, their opacity."""
        return np.asarray(np.clip(_channels_last(_run(self._decoder, points, (3, *self.size))), 0.0, 1.0))


def _size_of(session: Any, taken: str, given: str) -> tuple[int, int]:
    """Height and width that a model is made for."""
    names = [[entry.name for entry in entries] for entries in (session.get_inputs(), session.get_outputs())]
    shape = session.get_inputs()[0].shape
    if names != [[taken], [given]] or not all(isinstance(side, int) for side in shape[-2:]):
        raise InputError(
            f"expected a SynSin model of one size with the input {taken!r} and the output {given!r}, "
            f"got {names[0]} and {names[1]}; name another"
        )
    return shape[-2], shape[-1]


def _run(session: Any, image: Float[np.ndarray, "height width channels"], shape: tuple[int, ...]) -> np.ndarray:
    """The only output of a model, of this shape, for its only input."""
    (entry,) = session.get_inputs()
    planes = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32)
    return np.asarray(run_network(session, {entry.name: planes}, [(1, *shape)])[0][0])


def _channels_last(planes: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(planes.transpose(1, 2, 0))
