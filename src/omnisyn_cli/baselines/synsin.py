"""SynSin on the sphere: the panoramas' points, blended as a waypoint sees them, made into a picture by a network.

Depth is found in each panorama alone, no surface is assumed and exposure is not matched. Pictures are made at the size
that the networks were trained at, upright, then turned and enlarged.

Source: Wiles et al., SynSin (CVPR 2020); OmniSyn, section 4.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.baselines.cross_fade import PairWithoutGeometry
from omnisyn_cli.baselines.learned_depth import turned_estimate
from omnisyn_cli.baselines.soft_points import Cloud, splat
from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import rotated_directions, rotated_image, sample_nearest
from omnisyn_cli.runtime.session import run_network
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import Frame, FrameAllocator, turned_panorama
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View

# World from camera of a panorama as the networks want it held: up is up, and it looks along the world's −z.
WORLD_ROTATION = np.eye(3)


def upright_image(view: View, size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
    """A panorama as the networks are shown it; ImageError for one that is not 2:1."""
    view.check_shape()
    return np.asarray(rotated_image(view.image, view.pose.rotation, WORLD_ROTATION, size), np.float32)


class MonocularDepthEstimator:
    """Inverse depth of each panorama by itself; a :class:`~omnisyn_cli.types.DepthEstimator`.

    It knows metres from what it was trained on, and not how far it can be trusted: its confidence is 1 wherever a
    panorama may be used. InputError: the session is of no monocular depth model.
    """

    def __init__(self, session: Any) -> None:
        self._session = session
        self.size = _size_of(session, "image", "inverse_depth")

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        return self._estimate(first), self._estimate(second)

    def inverse_depth(self, image: Float32[np.ndarray, "height width 3"]) -> Float32[np.ndarray, "height width"]:
        """1/metre of an upright panorama of :attr:`size`; InputError if the model is broken."""
        found: np.ndarray = _run(self._session, image, (1, *self.size))[..., 0]
        if not (found >= 0).all():
            raise InputError("expected a model whose inverse depths are not negative, got others; name another")
        return found

    def _estimate(self, view: View) -> DepthEstimate:
        """Inverse depth as the camera was held."""
        found = self.inverse_depth(upright_image(view, self.size))
        return turned_estimate(view, Pose.identity(), found, np.ones_like(found))


class SynSinSessions:
    """Sessions of depth, features and picture; the decoder says radius and points. InputError: not of one kind."""

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
        return _run(self._encoder, image, (self._channels, *self.size))

    def picture(self, points: Float32[np.ndarray, "height width channels"]) -> Float32[np.ndarray, "height width 3"]:
        """RGB in [0, 1] of blended features and, last, their opacity."""
        return np.asarray(np.clip(_run(self._decoder, points, (3, *self.size)), 0.0, 1.0))


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
    """The only output of a model, of this shape with channels first, for its only input; channels last."""
    (entry,) = session.get_inputs()
    planes = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32)
    return np.ascontiguousarray(run_network(session, {entry.name: planes}, [(1, *shape)])[0][0].transpose(1, 2, 0))


class SynSin:
    """A :class:`~omnisyn_cli.synthesis.methods.Method`: frames from the points of the nearer panorama or both."""

    def __init__(
        self, networks: SynSinSessions, sources: int, options: SynthesisOptions, clock: Stopwatch | None = None
    ) -> None:
        self.networks, self.sources, self.options, self.clock = networks, sources, options, clock or Stopwatch()
        self._clouds: dict[int, Cloud] = {}

    def prepare(self, index: int, views: Sequence[View]) -> "SynSinPair":
        """Nothing is computed yet: of one source, half of the frames may do with one panorama."""
        self._clouds = {known: cloud for known, cloud in self._clouds.items() if known == index}
        return SynSinPair(self, index, (views[index], views[index + 1]))

    def cloud(self, index: int, view: View) -> Cloud:
        """The points of a panorama, upright, with its position in the world for a pose; found once for both pairs."""
        if index not in self._clouds:
            self._clouds[index] = self._found(view)
        return self._clouds[index]

    def _found(self, view: View) -> Cloud:
        size = self.networks.size
        with self.clock("depth"):
            image = upright_image(view, size)
            inverse_depth = self.networks.estimator.inverse_depth(image)
            features = self.networks.features(image)
        mask = None
        if view.mask is not None:
            directions = rotated_directions(size, view.pose.rotation, WORLD_ROTATION)
            mask = np.asarray(sample_nearest(view.mask.astype(np.float32), directions) > 0)
        return Cloud(features, inverse_depth, Pose(np.eye(3), view.pose.position), mask)


class SynSinPair(PairWithoutGeometry):
    """A :class:`~omnisyn_cli.synthesis.methods.Pair` whose frames have no depth: what is painted lies nowhere."""

    def __init__(self, method: SynSin, index: int, views: tuple[View, View]) -> None:
        self._method, self._index, self._views = method, index, views

    @cached_property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate]:
        """Each panorama's depth as its network sees it, looked for when it is asked for."""
        return self._method.networks.estimator(*self._views)

    def frame(self, waypoint: Waypoint, out: FrameAllocator | None = None) -> Frame:
        """What the networks show at a waypoint, as numbers in [0, 1]."""
        method, near = self._method, int(waypoint.t >= 0.5)
        clouds = [self._seen_from(k, waypoint.pose.position) for k in ((0, 1) if method.sources == 2 else (near,))]
        networks, options = method.networks, method.options
        with method.clock("render"):
            points = splat(clouds, networks.size, radius=networks.radius, most=networks.points, threads=options.threads)
        with method.clock("fuse"):
            small = networks.picture(points)
            turn = Pose(waypoint.pose.rotation.T, np.zeros(3))
            picture = turned_panorama(small, turn, options.size, options.threads)
            return Frame(np.asarray(np.minimum(picture, np.float32(1.0))), waypoint, None)

    def _seen_from(self, which: int, position: np.ndarray) -> Cloud:
        cloud = self._method.cloud(self._index + which, self._views[which])
        moved = cloud.target_from_source.position - position
        return Cloud(cloud.features, cloud.inverse_depth, Pose(np.eye(3), moved), cloud.mask)
