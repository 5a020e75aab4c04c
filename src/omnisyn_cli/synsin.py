"""SynSin on the sphere: the panoramas' points, blended as a waypoint sees them, made into a picture by a network.

What OmniSyn is compared with. Depth is found in each panorama alone, no surface is assumed and nothing is compared
between the two: one panorama (the nearer one) or both become one list of points. Pictures are made at the size that the
networks were trained at, upright, then turned and enlarged. Exposure is not matched.

Source: Wiles et al., SynSin (CVPR 2020); OmniSyn, section 4.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.turning import turned_directions
from omnisyn_cli.presets import SYNSIN_MODELS
from omnisyn_cli.render.soft_points import Cloud, splat
from omnisyn_cli.runtime.models import find_model
from omnisyn_cli.runtime.session import open_session
from omnisyn_cli.runtime.synsin import SynSinSessions, upright_image
from omnisyn_cli.segments import Stopwatch, SynthesisOptions
from omnisyn_cli.synthesis import Frame, photograph_at, turned_panorama
from omnisyn_cli.trajectory import Waypoint
from omnisyn_cli.types import View

__all__ = ["SynSin", "open_synsin"]

KEPT = 2
"""Panoramas whose points are held."""


def open_synsin(*, device: str = "auto", threads: int | None = None) -> SynSinSessions:
    """The networks that are installed.

    Args:
        device: where they run: ``auto``, ``cpu`` or ``cuda``.
        threads: at most this many; None is one per core.

    Raises:
        InputError: one is not there, is of another kind, or cannot be used on that device.
    """
    return SynSinSessions(*(open_session(find_model(model), device=device, threads=threads) for model in SYNSIN_MODELS))


class SynSin:
    """Frames from the points of one or two panoramas.

    Args:
        networks: from :func:`open_synsin`.
        views: the panoramas of the chain, in order.
        sources: panoramas that a frame is made of: 1 is the nearer one, 2 are both.
        options: size of the frames, and threads; the rest is not looked at.
        clock: collects seconds by stage.
    """

    def __init__(
        self, networks: SynSinSessions, views: Sequence[View], sources: int, options: SynthesisOptions,
        clock: Stopwatch | None = None,
    ) -> None:  # fmt: skip
        if sources not in (1, 2):
            raise InputError(f"expected 1 or 2 panoramas for a frame, got {sources}; choose one of these")
        self._networks, self._views, self._sources = networks, views, sources
        self._options, self._clock = options, clock or Stopwatch()
        self._cloud = lru_cache(maxsize=KEPT)(partial(_make_cloud, networks, views, self._clock))

    def frames(self, path: Sequence[Waypoint]) -> Iterator[Frame]:
        """A frame for every waypoint, in order; where a panorama was taken, the panorama itself."""
        for waypoint in path:
            photograph = photograph_at(self._views, waypoint, self._options, self._clock)
            yield photograph or Frame(self.picture(waypoint), waypoint, None)

    def picture(self, waypoint: Waypoint) -> Float32[np.ndarray, "height width 3"]:
        """What the networks show at a waypoint, RGB in [0, 1]."""
        near = waypoint.segment + int(waypoint.t >= 0.5)
        used = (waypoint.segment, waypoint.segment + 1) if self._sources == 2 else (near,)
        clouds = [self._seen_from(index, waypoint.pose.position) for index in used]
        networks, threads = self._networks, self._options.threads
        with self._clock("render"):
            points = splat(clouds, networks.size, radius=networks.radius, most=networks.points, threads=threads)
        with self._clock("fuse"):
            small = networks.picture(points)
            turn = Pose(waypoint.pose.rotation.T, np.zeros(3))
            return np.asarray(np.minimum(turned_panorama(small, turn, self._options.size, threads), np.float32(1.0)))

    def _seen_from(self, index: int, position: np.ndarray) -> Cloud:
        cloud = self._cloud(index)
        moved = cloud.target_from_source.position - position
        return Cloud(cloud.features, cloud.inverse_depth, Pose(np.eye(3), moved), cloud.mask)


def _make_cloud(networks: SynSinSessions, views: Sequence[View], clock: Stopwatch, index: int) -> Cloud:
    """The points of a panorama, upright, with its position in the world for a pose."""
    view, size = views[index], networks.size
    with clock("depth"):
        image = upright_image(view, size)
        inverse_depth = networks.estimator.inverse_depth(image)
        features = networks.features(image)
    mask = None
    if view.mask is not None:
        directions = turned_directions(size, view.pose.rotation, np.eye(3))
        mask = np.asarray(sample_nearest(view.mask.astype(np.float32), directions) > 0)
    return Cloud(features, inverse_depth, Pose(np.eye(3), view.pose.position), mask)
