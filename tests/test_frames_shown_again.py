"""Work that is not done because nobody would see it: frames shown again, and views that would not count."""

import numpy as np
import pytest

from omnisyn_cli import synthesis
from omnisyn_cli.segments import Segment, SynthesisOptions
from omnisyn_cli.synthesis import Frame, synthesize
from omnisyn_cli.trajectory import Waypoint
from omnisyn_cli.types import KnownDepth
from synthesis_samples import hall_view, posed

SIZE = (64, 128)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The views that are rendered for frames, in order: 0 is the first."""
    made: list[int] = []
    original = synthesis._rendering

    def counted(segment: Segment, waypoint: Waypoint, which: int) -> object:
        made.append(which)
        return original(segment, waypoint, which)

    monkeypatch.setattr(synthesis, "_rendering", counted)
    return made


def frames(shares: list[float], *, turn: float = 0.0, mask: np.ndarray | None = None, **options: object) -> list[Frame]:
    """Of a way of one metre in a hall of four."""
    views = [hall_view(posed([0.0, 0.0, z]), SIZE, mask) for z in (0.5, -0.5)]
    path = [Waypoint(0, t, posed([0.0, 0.0, 0.5 - t], k * turn)) for k, t in enumerate(shares)]
    made = synthesize(views, path, KnownDepth(), SynthesisOptions(SIZE, threads=1, **options))
    return [frame for frame in made if isinstance(frame, Frame)]


def test_a_step_of_less_than_a_quarter_of_a_pixel_is_not_rendered(calls: list[int]) -> None:
    """The nearest wall is 3.5 m away: a quarter of a pixel, 0.0123 rad, is 4 cm; 1 mm is much less, 10 cm is more."""
    shown = frames([0.5, 0.501, 0.6])
    assert len(calls) == 4
    assert [frame.waypoint.t for frame in shown] == [0.5, 0.501, 0.6]


def test_small_steps_add_up(calls: list[int]) -> None:
    """Each is compared with the frame that was rendered, not with the one before."""
    frames([0.5 + 0.001 * k for k in range(6)])
    assert len(calls) == 2 * 3  # 1/512 of the way is passed after every second step


def test_a_turn_of_more_than_a_quarter_of_a_pixel_is_rendered(calls: list[int]) -> None:
    frames([0.5, 0.5], turn=0.0002)
    assert len(calls) == 2
    frames([0.5, 0.5], turn=0.02)
    assert len(calls) == 2 + 4


def test_at_an_end_the_other_view_is_rendered_only_where_the_own_one_has_holes(calls: list[int]) -> None:
    usable = np.ones(SIZE, bool)
    usable[0, 0] = False  # so that the end is no photograph
    frames([0.001])
    assert calls == [0]
    frames([0.999])
    assert calls == [0, 1]
    usable[20:40, 30:60] = False
    frames([0.0], mask=usable)
    assert sorted(calls[2:]) == [0, 1]
    frames([0.001], confidence=True)
    assert sorted(calls[4:]) == [0, 1]


def test_at_an_end_one_view_looks_as_both_do(monkeypatch: pytest.MonkeyPatch) -> None:
    one = frames([0.001])[0].image.copy()
    monkeypatch.setattr(synthesis, "LEAST_SHARE", 0.0)
    both = frames([0.001])[0].image
    assert np.abs(one - both).max() < 1 / 510


def test_triangles_are_counted_and_the_switch_draws_them_all() -> None:
    views = [hall_view(posed([0.0, 0.0, z]), SIZE) for z in (0.5, -0.5)]
    path = [Waypoint(0, 0.5, posed([0.0, 0.0, 0.0]))]
    counts = {}
    for adaptive in (False, True):
        made = synthesize(views, path, KnownDepth(), SynthesisOptions(SIZE, threads=1, adaptive=adaptive))
        counts[adaptive] = next(item.triangles for item in made if isinstance(item, Segment))
    assert counts[False][0] == counts[False][1] == counts[True][1] > counts[True][0]
