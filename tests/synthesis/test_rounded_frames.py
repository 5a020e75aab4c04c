"""Frames that are rounded while they are made are the frames, rounded."""

import numpy as np
import pytest

from omnisyn_cli.synthesis.fallback import CrossFade
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import KnownDepth, View
from synthesis_samples import as_bytes, hall_view, posed

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
