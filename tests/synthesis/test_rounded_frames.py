"""Frames that are shown again, rounded while they are made, or of simplified surfaces: nobody sees what is saved."""

from pathlib import Path

import numpy as np
import pytest

from interpolation_samples import job_of
from omnisyn_cli.fusion.photometry import ExposureMatcher
from omnisyn_cli.interpolation.plan import plan_interpolation, with_preset
from omnisyn_cli.synthesis import frame
from omnisyn_cli.synthesis.fallback import CrossFade
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import Frame, synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint, plan_path
from omnisyn_cli.types import KnownDepth, Layer, View
from synthesis_samples import as_bytes, hall_view, posed, write_hall

SIZE = (1024, 2048)
POSES = [posed((0, 0, 0.5)), posed((0.3, 0.1, -0.4), 0.2)]


def views(*, as_samples: bool) -> list[View]:
    """A hall painted in steps of 1/255; the second view is half a stop darker than the first."""
    made = []
    for index, pose in enumerate(POSES):
        view = hall_view(pose, (128, 256))
        samples = as_bytes(view.image * (1.0, 0.85)[index])
        image = np.float32(samples / np.float32(255))
        made.append(View(image, pose, None, view.known_depth, image_uint8=samples if as_samples else None))
    return made


def frames(shown: list[View], ring: list[np.ndarray] | None) -> list[np.ndarray]:
    memory = None if ring is None else iter(ring).__next__
    path, options = plan_path(POSES, 4, heading="first"), SynthesisOptions(SIZE, threads=2)
    return [each.image.copy() for each in synthesize(shown, path, SurfaceMethod(KnownDepth(), options), memory)]


@pytest.mark.parametrize("as_samples", [False, True])
def test_rounding_early_changes_a_sample_by_one_at_most(as_samples: bool) -> None:
    """Photographs turned and enlarged, and frames between, of numbers as of samples."""
    ring = [np.empty((*SIZE, 3), np.uint8) for _ in range(4)]
    rounded, exact = frames(views(as_samples=as_samples), ring), frames(views(as_samples=False), None)
    assert [frame.dtype for frame in rounded] == [np.uint8] * 4
    for found, numbers in zip(rounded, exact, strict=True):
        difference = np.abs(found.astype(int) - as_bytes(numbers))
        assert difference.max() <= 1
        assert (difference > 0).mean() < 0.02


def test_photographs_are_cross_faded_into_samples_as_into_numbers() -> None:
    """Where confidence is low, gradually around there, and nowhere else."""
    rng, size = np.random.default_rng(0), (64, 128)
    fade = CrossFade([rng.random((32, 64, 3), np.float32) for _ in POSES], POSES, size, threads=2)
    samples, confidence = rng.integers(0, 256, (*size, 3), np.uint8), np.ones(size, np.float32)
    confidence[20:45, 100:] = 0.0
    numbers, before = np.float32(samples / 255), samples.copy()
    for image in (samples, numbers):
        fade(image, confidence, POSES[0], 0.3)
    np.testing.assert_array_equal(samples, as_bytes(numbers))
    changed = (samples != before).any(axis=-1)
    assert changed[25:40, 106:122].mean() > 0.9
    assert not changed[:, 30:80].any()


SMALL = (64, 128)


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


def hall_frames(
    shares: list[float], *, turn: float = 0.0, mask: np.ndarray | None = None, **options: object
) -> list[Frame]:
    """Of a way of one metre in a hall of four."""
    views = [hall_view(posed([0.0, 0.0, z]), SMALL, mask) for z in (0.5, -0.5)]
    path = [Waypoint(0, t, posed([0.0, 0.0, 0.5 - t], k * turn)) for k, t in enumerate(shares)]
    return list(synthesize(views, path, SurfaceMethod(KnownDepth(), SynthesisOptions(SMALL, threads=1, **options))))


def test_a_step_of_less_than_a_quarter_of_a_pixel_is_not_rendered(made: list[float]) -> None:
    """The nearest wall is 3.5 m away: a quarter of a pixel, 0.0123 rad, is 4 cm; 1 mm is much less, 10 cm is more."""
    shown = hall_frames([0.5, 0.501, 0.6])
    assert made == [0.5, 0.6]
    assert [frame.waypoint.t for frame in shown] == [0.5, 0.501, 0.6]
    assert [frame.is_shown_again for frame in shown] == [False, True, False]


def test_small_steps_add_up(made: list[float]) -> None:
    """Each is compared with the frame that was rendered, not with the one before."""
    hall_frames([0.5 + 0.001 * k for k in range(6)])
    assert len(made) == 3  # 1/512 of the way is passed after every second step


def test_a_turn_of_more_than_a_quarter_of_a_pixel_is_rendered(made: list[float]) -> None:
    hall_frames([0.5, 0.5], turn=0.0002)
    assert len(made) == 1
    hall_frames([0.5, 0.5], turn=0.02)
    assert len(made) == 1 + 2


def test_triangles_are_counted_and_the_switch_draws_them_all() -> None:
    views = [hall_view(posed([0.0, 0.0, z]), SMALL) for z in (0.5, -0.5)]
    counts = {}
    for adaptive in (False, True):
        method = SurfaceMethod(KnownDepth(), SynthesisOptions(SMALL, threads=1, adaptive=adaptive))
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
