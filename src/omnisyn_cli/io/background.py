"""A frame sink in a thread of its own, so that rendering goes on while frames are encoded."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.io.video import FrameSink

FRAMES_IN_QUEUE = 2
"""More would only cost memory: the slower side, rendering or encoding, decides the pace."""

LARGE_FRAME_PIXELS = 2**25
"""Pixels (8192×4096) from which on one frame in the queue is enough: each takes long, and much memory."""


def frames_in_queue(size: tuple[int, int]) -> int:
    """How many frames of a size wait for a sink at most."""
    return FRAMES_IN_QUEUE if size[0] * size[1] < LARGE_FRAME_PIXELS else 1


class FrameRing:
    """Memory for frames on their way to sinks, used again when they have arrived.

    There is room for a frame of ``size`` (height, width) that is written, one that is made, and ``waiting`` between.
    """

    def __init__(self, size: tuple[int, int], waiting: int) -> None:
        self._frames = deque(np.empty((*size, 3), np.uint8) for _ in range(waiting + 2))

    def __call__(self) -> UInt8[np.ndarray, "height width 3"]:
        """Memory for the next frame; it is given to all sinks before the one after it is asked for."""
        self._frames.rotate()
        return self._frames[0]


class BackgroundSink:
    """Hands frames to another sink from a thread; frames must not be changed before they have arrived.

    An error of the other sink is raised by the next call of :meth:`write` or by :meth:`finish`; frames that still wait
    when the context ends with an error are dropped.

    At most ``waiting`` frames wait for it while one is being written.
    """

    def __init__(self, sink: FrameSink, waiting: int = FRAMES_IN_QUEUE) -> None:
        self._sink, self._waiting = sink, waiting
        self._pending: deque[Future[None]] = deque()
        self._worker = ThreadPoolExecutor(1, "omnisyn-frames")

    def write(self, frame: Shaped[np.ndarray, "height width 3"]) -> None:
        """Take one more frame; waits while as many are waiting as may."""
        while self._pending and (len(self._pending) > self._waiting or self._pending[0].done()):
            self._pending.popleft().result()
        self._pending.append(self._worker.submit(self._sink.write, frame))

    def finish(self) -> None:
        """Wait until every frame has been handed over."""
        while self._pending:
            self._pending.popleft().result()

    def __enter__(self) -> BackgroundSink:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self._worker.shutdown(cancel_futures=True)
