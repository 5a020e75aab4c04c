"""A frame sink in a thread of its own, so that rendering goes on while frames are encoded."""

from __future__ import annotations

import queue
import threading
from collections import deque
from types import TracebackType

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.io.video import FrameSink

__all__ = ["BackgroundSink", "FrameRing", "frames_in_queue"]

FRAMES_IN_QUEUE = 2
"""More would only cost memory: whoever is slower decides the pace."""

LARGE = 2**25
"""Pixels from which on a frame takes so long that one in the queue does."""


def frames_in_queue(size: tuple[int, int]) -> int:
    """How many frames of a size wait for a sink at most."""
    return FRAMES_IN_QUEUE if size[0] * size[1] < LARGE else 1


class FrameRing:
    """Memory for frames on their way to sinks, used again when they have arrived.

    Args:
        size: height and width of a frame.
        waiting: frames in the queue of each sink at most. Besides them one is being written and one being made.
    """

    def __init__(self, size: tuple[int, int], waiting: int) -> None:
        self._frames = deque(np.empty((*size, 3), np.uint8) for _ in range(waiting + 2))

    def __call__(self) -> UInt8[np.ndarray, "height width 3"]:
        """Memory for the next frame; it is given to all sinks before the one after it is asked for."""
        self._frames.rotate()
        return self._frames[0]


class BackgroundSink:
    """Hands frames to another sink from a thread; frames must not be changed before they have arrived.

    An error of the other sink is raised by the next call of :meth:`write` or by :meth:`finish`.

    Args:
        sink: where frames go.
        waiting: this many wait for it at most.
    """

    def __init__(self, sink: FrameSink, waiting: int = FRAMES_IN_QUEUE) -> None:
        self._sink = sink
        self._frames: queue.Queue[np.ndarray | None] = queue.Queue(waiting)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="omnisyn-frames", daemon=True)
        self._thread.start()

    def write(self, frame: Shaped[np.ndarray, "height width 3"]) -> None:
        """Take one more frame; waits while the queue is full."""
        self._raise_error()
        self._frames.put(frame)

    def finish(self) -> None:
        """Wait until every frame has been handed over."""
        if self._thread.is_alive():
            self._frames.put(None)
            self._thread.join()
        self._raise_error()

    def __enter__(self) -> BackgroundSink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
            return
        self._error = self._error or error  # from here on frames are dropped
        self._frames.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (frame := self._frames.get()) is not None:
            if self._error is None:
                try:
                    self._sink.write(frame)
                except BaseException as error:  # noqa: BLE001  raised again in the thread that writes
                    self._error = error

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error
