"""SynSin on the sphere: the panoramas' points, blended as a waypoint sees them, made into a picture by a network.

What OmniSyn is compared with. Depth is found in each panorama alone, no surface is assumed and nothing is compared
between the two: one panorama (the nearer one) or both become one list of points. Pictures are made at the size that the
networks were trained at, upright, then turned and enlarged. Exposure is not matched.

Source: Wiles et al., SynSin (CVPR 2020); OmniSyn, section 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from omnisyn_cli.baselines.soft_points import Cloud, splat
from omnisyn_cli.baselines.synsin_sessions import SynSinSessions, upright_image
from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import rotated_directions, sample_nearest
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import Frame, FrameAllocator, turned_panorama
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View


class SynSin:
    """Frames from the points of one or two panoramas; a :class:`~omnisyn_cli.synthesis.methods.Method`.

    Args:
        networks: from :func:`omnisyn_cli.pipeline.methods.open_synsin`.
        sources: panoramas that a frame is made of: 1 is the nearer one, 2 are both.
        options: size of the frames, and threads; the rest is not looked at.
        clock: collects seconds by stage.
    """

    def __init__(
        self, networks: SynSinSessions, sources: int, options: SynthesisOptions, clock: Stopwatch | None = None
    ) -> None:
        if sources not in (1, 2):
            raise InputError(f"expected 1 or 2 panoramas for a frame, got {sources}; choose one of these")
        self.networks, self.sources, self.options, self.clock = networks, sources, options, clock or Stopwatch()
        self._clouds: dict[int, Cloud] = {}

    def prepare(self, index: int, views: Sequence[View]) -> SynSinPair:
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
            directions = rotated_directions(size, view.pose.rotation, np.eye(3))
            mask = np.asarray(sample_nearest(view.mask.astype(np.float32), directions) > 0)
        return Cloud(features, inverse_depth, Pose(np.eye(3), view.pose.position), mask)


class SynSinPair:
    """Frames between two panoramas; a :class:`~omnisyn_cli.synthesis.methods.Pair`.

    Frames have no depth: what a network paints lies nowhere.
    """

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

    def inverse_depth(self, waypoint: Waypoint) -> None:
        """None."""

    def renderings(self, waypoint: Waypoint) -> None:
        """None."""

    def _seen_from(self, which: int, position: np.ndarray) -> Cloud:
        cloud = self._method.cloud(self._index + which, self._views[which])
        moved = cloud.target_from_source.position - position
        return Cloud(cloud.features, cloud.inverse_depth, Pose(np.eye(3), moved), cloud.mask)
