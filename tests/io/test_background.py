"""Frames written in another thread arrive in order, and its errors come back."""

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from omnisyn_cli.errors import EncodingError
from omnisyn_cli.io.video import FRAMES_IN_QUEUE, BackgroundSink, FrameRing, frames_in_queue

FRAMES = [np.full((2, 4, 3), level, np.uint8) for level in range(12)]


class Sink:
    """Remembers what it was given, after doing something with the number of the frame."""

    def __init__(self, before: Callable[[int], object] = lambda index: None) -> None:
        self.frame_count, self.levels, self._before = 0, [], before

    def write(self, frame: np.ndarray) -> None:
        self._before(self.frame_count)
        self.levels.append(int(frame[0, 0, 0]))
        self.frame_count += 1


def fail_at(wanted: int) -> Callable[[int], None]:
    def fail(index: int) -> None:
        if index == wanted:
            raise EncodingError("the encoder stopped")

    return fail


def write_all(sink: Sink) -> None:
    with BackgroundSink(sink) as background:
        for frame in FRAMES:
            background.write(frame)


def threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("omnisyn-frames")]


def test_all_frames_arrive_in_order():
    sink = Sink()
    write_all(sink)
    assert sink.levels == list(range(12))
    assert not threads()


def test_finishing_waits_and_may_be_repeated():
    sink = Sink(lambda index: time.sleep(0.01))
    with BackgroundSink(sink) as background:
        for frame in FRAMES[:5]:
            background.write(frame)
        background.finish()
        assert sink.frame_count == 5
        background.finish()


@pytest.mark.parametrize("where", [0, 5, 11])
def test_an_error_of_the_sink_is_raised_where_frames_are_written(where):
    sink = Sink(fail_at(where))
    with pytest.raises(EncodingError, match="the encoder stopped"):
        write_all(sink)
    assert sink.levels == list(range(where))
    assert not threads()


def test_after_an_error_no_frame_waits_for_ever():
    sink = Sink(fail_at(0))
    for _ in range(20):
        with pytest.raises(EncodingError):
            write_all(sink)
        sink.frame_count = 0


def open_when_dropped(background: BackgroundSink, gate: threading.Event) -> None:
    """Let the frame that is being written arrive once those that wait for it are dropped."""
    waiting = background._pending[-1]
    while not waiting.cancelled():
        time.sleep(0.01)
    gate.set()


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_error_of_the_writer_drops_what_waits_and_ends_the_thread(error):
    gate = threading.Event()
    sink = Sink(lambda index: gate.wait(300))

    def write_and_fail() -> None:
        with BackgroundSink(sink) as background:
            for frame in FRAMES[: FRAMES_IN_QUEUE + 1]:
                background.write(frame)
            threading.Thread(target=open_when_dropped, args=(background, gate)).start()
            raise error

    with pytest.raises(error):
        write_and_fail()
    assert sink.frame_count <= 1
    assert not threads()


def test_memory_is_bounded_by_the_queue():
    gate = threading.Event()
    with BackgroundSink(Sink(lambda index: gate.wait(300))) as background:
        written = 0

        def write() -> None:
            nonlocal written
            for frame in FRAMES:
                background.write(frame)
                written += 1

        writer = threading.Thread(target=write)
        writer.start()
        time.sleep(0.2)
        assert written <= FRAMES_IN_QUEUE + 1
        gate.set()
        writer.join()
    assert written == len(FRAMES)


@pytest.mark.parametrize("waiting", [1, 2])
def test_a_frame_keeps_its_place_in_the_ring_until_it_has_arrived(waiting):
    """However slow the sink is: memory is given out again only when its frame cannot be needed any more."""
    sink, ring = Sink(lambda index: time.sleep(0.002 * (index % 3))), FrameRing((2, 4), waiting)
    with BackgroundSink(sink, waiting) as background:
        for level in range(20):
            frame = ring()
            frame[:] = level
            background.write(frame)
    assert sink.levels == list(range(20))
    assert len({ring().ctypes.data for _ in range(20)}) == waiting + 2


def test_large_frames_wait_one_at_a_time():
    assert frames_in_queue((2048, 4096)) == FRAMES_IN_QUEUE
    assert frames_in_queue((4096, 8192)) == 1
