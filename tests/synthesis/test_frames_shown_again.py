"""Work that is not done because nobody would see it: frames shown again, and flat surfaces simplified."""

from pathlib import Path

import numpy as np
import pytest

from interpolation_samples import job_of
from omnisyn_cli.fusion.photometry import ExposureMatcher
from omnisyn_cli.interpolation.plan import plan_interpolation, with_preset
from omnisyn_cli.synthesis import frame
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import Frame, synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import KnownDepth, Layer
from synthesis_samples import hall_view, posed, write_hall

SIZE = (64, 128)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The places on the way that renderings are fused for, in order."""
    found: list[float] = []

    class Counted(ExposureMatcher):
        def __call__(self, first: Layer, second: Layer, t: float) -> tuple[Layer, Layer]:
            found.append(t)
            return super().__call__(first, second, t)

    monkeypatch.setattr(frame, "ExposureMatcher", Counted)
    return found


def frames(shares: list[float], *, turn: float = 0.0, mask: np.ndarray | None = None, **options: object) -> list[Frame]:
    """Of a way of one metre in a hall of four."""
    views = [hall_view(posed([0.0, 0.0, z]), SIZE, mask) for z in (0.5, -0.5)]
    path = [Waypoint(0, t, posed([0.0, 0.0, 0.5 - t], k * turn)) for k, t in enumerate(shares)]
    return list(synthesize(views, path, SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1, **options))))


def test_a_step_of_less_than_a_quarter_of_a_pixel_is_not_rendered(made: list[float]) -> None:
    """The nearest wall is 3.5 m away: a quarter of a pixel, 0.0123 rad, is 4 cm; 1 mm is much less, 10 cm is more."""
    shown = frames([0.5, 0.501, 0.6])
    assert made == [0.5, 0.6]
    assert [frame.waypoint.t for frame in shown] == [0.5, 0.501, 0.6]
    assert [frame.is_shown_again for frame in shown] == [False, True, False]


def test_small_steps_add_up(made: list[float]) -> None:
    """Each is compared with the frame that was rendered, not with the one before."""
    frames([0.5 + 0.001 * k for k in range(6)])
    assert len(made) == 3  # 1/512 of the way is passed after every second step


def test_a_turn_of_more_than_a_quarter_of_a_pixel_is_rendered(made: list[float]) -> None:
    frames([0.5, 0.5], turn=0.0002)
    assert len(made) == 1
    frames([0.5, 0.5], turn=0.02)
    assert len(made) == 1 + 2


def test_triangles_are_counted_and_the_switch_draws_them_all() -> None:
    views = [hall_view(posed([0.0, 0.0, z]), SIZE) for z in (0.5, -0.5)]
    counts = {}
    for adaptive in (False, True):
        method = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1, adaptive=adaptive))
        counts[adaptive] = method.prepare(0, views).prepared.triangles
    assert counts[False][0] == counts[False][1] == counts[True][1] > counts[True][0]


def test_fewer_triangles_are_looked_for_where_frames_pay_for_it(tmp_path: Path) -> None:
    """Unless the user says otherwise,."""
    images = write_hall(tmp_path, [posed([0.0, 0.0, z]) for z in (0.5, 0.0, -0.5)])
    usual = {frames: plan_interpolation(job_of(tmp_path, images, frames=frames)) for frames in (64, 65)}
    assert [plan.config.adaptive for plan in usual.values()] == [False, True]
    for adaptive in (True, False):
        asked = plan_interpolation(job_of(tmp_path, images, frames=64, adaptive=adaptive))
        assert asked.config.adaptive == with_preset(asked, "fast").config.adaptive == adaptive
