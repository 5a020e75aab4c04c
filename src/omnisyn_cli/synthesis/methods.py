"""What makes frames: a :class:`Method` is made ready for a pair of views, the :class:`Pair` shows what lies between.

The paper's method, the one of this program, is :class:`SurfaceMethod`; others to compare it with are
:mod:`omnisyn_cli.baselines.synsin` and :mod:`omnisyn_cli.baselines.cross_fade`.
"""

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace
from functools import cached_property, partial
from itertools import cycle
from typing import TYPE_CHECKING, Protocol

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.compute.threads import allowed_threads, frames_at_once, in_lane
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.render.renderer import MeshRenderer
from omnisyn_cli.synthesis.chain_depth import ChainDepth
from omnisyn_cli.synthesis.frame import (
    MAX_REUSE_T_STEP,
    Frame,
    FrameAllocator,
    FrameMaker,
    FusedFrame,
    fuse_frame,
)
from omnisyn_cli.synthesis.prepared_pair import PreparedPair, SynthesisOptions, prepare_pair
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, DepthEstimator, Fuser, Layer, View

if TYPE_CHECKING:
    from omnisyn_cli.synthesis.device.frames import DeviceFrames


class Pair(Protocol):
    """Two neighbouring views between which frames are made; not shared between threads."""

    @property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate] | None:
        """What is known about the distances in both; None for methods without geometry."""
        ...

    def frame(self, waypoint: Waypoint, out: FrameAllocator | None = None) -> Frame:
        """What is seen at a waypoint between the two.

        ``out`` gives memory for frames that are wanted rounded to 8 bits; frames may be numbers all the same.
        """
        ...

    def inverse_depth(self, waypoint: Waypoint) -> Float32[np.ndarray, "height width"] | None:
        """1/metre of what is seen there, negative where that is unknown; None for pictures without geometry."""
        ...

    def renderings(self, waypoint: Waypoint) -> tuple[Layer, Layer] | None:
        """What both views show there, in buffers that whatever is asked for next overwrites; None without geometry."""
        ...


class Method(Protocol):
    """A way to make frames of one size; the clock collects seconds by stage."""

    options: SynthesisOptions
    clock: Stopwatch

    def prepare(self, index: int, views: Sequence[View]) -> Pair:
        """Make ready for the frames between the views ``index`` and ``index + 1`` of a chain."""
        ...


class SurfaceMethod:
    """Depth → mesh → render both → fuse, by default geometrically; a :class:`Method`."""

    def __init__(
        self, estimator: DepthEstimator, options: SynthesisOptions, fuser: Fuser | None = None,
        clock: Stopwatch | None = None, device: "DeviceFrames | None" = None,
    ) -> None:  # fmt: skip
        self.estimator, self.options, self.clock = estimator, options, clock or Stopwatch()
        self._fuser = fuser or GeometricFuser(options.size, threads=options.threads)
        self.device = device  # makes frames in place of the processor
        self._chain: ChainDepth | None = None

    @property
    def frames_at_once(self) -> int:
        """How many frames are made at once, at most."""
        count = frames_at_once(self.options.size, self.options.threads)
        return count if self.device is None else max(count, self.device.frames_at_once)

    def depths_of(self, views: Sequence[View]) -> ChainDepth:
        """The depth of a chain, which remembers what the next pair needs as long as no other chain is asked for."""
        if self._chain is None or self._chain.views is not views:
            self._chain = ChainDepth(views, self.estimator, self.clock, self.options.threads)
        return self._chain

    def prepare(self, index: int, views: Sequence[View]) -> "SurfacePair":
        """Find the depth of both and make their surfaces."""
        prepared = prepare_pair(index, self.depths_of(views), self.options, self.clock)
        return SurfacePair(prepared, self._fuser, self.options, self.clock, self.device)


class SurfacePair:
    """Frames of two surfaces; a :class:`Pair`.

    A frame in which nothing would be seen aside of where it was in the one before is that one, shown again.
    """

    def __init__(
        self, prepared: PreparedPair, fuser: Fuser, options: SynthesisOptions, clock: Stopwatch,
        device: "DeviceFrames | None" = None,
    ) -> None:  # fmt: skip
        self.prepared, self._fuser, self._options, self._clock, self._device = prepared, fuser, options, clock, device
        self._last: FusedFrame | None = None

    @property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate]:
        """See :class:`Pair`."""
        return self.prepared.depths

    def frame(self, waypoint: Waypoint, out: FrameAllocator | None = None) -> Frame:
        """See :class:`Pair`."""
        if self._last is not None and self._last.looks_the_same_from(waypoint):
            return self._last.again(waypoint, out)
        samples = None if out is None else out()
        on_device = self._device is not None and self._makers
        maker = self._makers[0] if on_device else self._maker(self.prepared, self._fuser)
        self._last = maker(waypoint, samples, self._clock)
        return self._last.frame

    def frames(self, waypoints: Iterable[Waypoint], out: FrameAllocator | None = None) -> Iterator[Frame]:
        """:meth:`frame` of several waypoints in their order; where there are cores for it, some are made at once."""
        makers = self._makers
        if len(makers) < 2:
            yield from (self.frame(waypoint, out) for waypoint in waypoints)
            return
        made: deque[Future[FusedFrame]] = deque()
        clock, t = self._clock.of_one_of(len(makers)), math.inf if self._last is None else self._last.frame.waypoint.t
        with ThreadPoolExecutor(len(makers), "omnisyn-frame") as pool:
            for waypoint, (lane, maker) in zip(waypoints, cycle(enumerate(makers, start=1))):
                if abs(waypoint.t - t) <= MAX_REUSE_T_STEP:  # perhaps the one before, which has to be there then
                    while made:
                        yield self._taken(made)
                    yield self.frame(waypoint, out)
                else:
                    if len(made) == len(makers):
                        yield self._taken(made)  # whose maker is the next in turn
                    samples = None if out is None else out()
                    make = partial(maker, waypoint, samples, clock)
                    made.append(pool.submit(copy_context().run, in_lane, lane, make))
                t = waypoint.t
            while made:
                yield self._taken(made)

    def _taken(self, made: deque[Future[FusedFrame]]) -> Frame:
        """The first of those that are being made, when it is there."""
        self._last = made.popleft().result()
        return self._last.frame

    def _maker(self, prepared: PreparedPair, fuser: Fuser) -> FrameMaker:
        """What makes frames on the processor."""
        return lambda waypoint, samples, clock: fuse_frame(prepared, waypoint, fuser, self._options, clock, samples)

    @cached_property
    def _makers(self) -> list[FrameMaker]:
        """A maker for each frame that is made at once; none where frames are made one after the other."""
        fuser, options = self._fuser, self._options
        twins = [renderer.twin for renderer in self.prepared.renderers if isinstance(renderer, MeshRenderer)]
        count, threads = frames_at_once(options.size, options.threads), options.threads or allowed_threads()
        if not isinstance(fuser, GeometricFuser) or len(twins) < 2 or (count < 2 and self._device is None):
            return []

        def twin(threads: int) -> FrameMaker:
            renderers = twins[0](threads), twins[1](threads)
            return self._maker(replace(self.prepared, renderers=renderers), fuser.twin(threads))

        if self._device is not None:
            return self._device.of_pair(self.prepared, twin(threads))
        return [twin(threads // count) for _ in range(count)]

    def inverse_depth(self, waypoint: Waypoint, views: Sequence[int] = (0, 1)) -> Float32[np.ndarray, "height width"]:
        """See :class:`Pair`: the nearer surface, of one view (0 or 1) if only that is shown."""
        seen = [self._rendering(waypoint, k).inverse_depth.copy() for k in views]
        return np.asarray(np.maximum(seen[0], seen[-1]))

    def renderings(self, waypoint: Waypoint) -> tuple[Layer, Layer]:
        """See :class:`Pair`."""
        return self._rendering(waypoint, 0), self._rendering(waypoint, 1)

    def _rendering(self, waypoint: Waypoint, view: int) -> Layer:
        return self.prepared.renderers[view](waypoint.pose.inverse() @ self.prepared.poses[view])


def frames_of(pair: Pair, waypoints: Iterable[Waypoint], out: FrameAllocator | None = None) -> Iterator[Frame]:
    """What is seen at waypoints between the two views of a pair, in their order; surfaces show some at once."""
    if isinstance(pair, SurfacePair):
        return pair.frames(waypoints, out)
    return (pair.frame(waypoint, out) for waypoint in waypoints)
