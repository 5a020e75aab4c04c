"""A frame sink in a thread of its own, so that rendering goes on while frames are encoded."""

from __future__ import annotations

import queue
import threading
from types import TracebackType

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.io.video import FrameSink

__all__ = ["BackgroundSink"]

FRAMES_IN_QUEUE = 2
"""More would only cost memory: whoever is slower decides the pace."""


class BackgroundSink:
    """Hands frames to another sink from a thread; frames must not be changed after they were written here.

    An error of the other sink is raised by the next call of :meth:`write` or by :meth:`finish`.
    """

    def __init__(self, sink: FrameSink) -> None:
        self._sink = sink
        self._frames: queue.Queue[np.ndarray | None] = queue.Queue(FRAMES_IN_QUEUE)
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
