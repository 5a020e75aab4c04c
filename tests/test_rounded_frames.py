"""Frames that are rounded while they are made are the frames, rounded."""

import numpy as np
import pytest

from omnisyn_cli.segments import SynthesisOptions
from omnisyn_cli.synthesis import Frame, synthesize
from omnisyn_cli.trajectory import plan_path
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
        made.append(View(image, pose, None, view.known_depth, samples if as_samples else None))
    return made


def frames(shown: list[View], ring: list[np.ndarray] | None) -> list[np.ndarray]:
    memory = None if ring is None else iter(ring).__next__
    path, options = plan_path(POSES, 4, heading="first"), SynthesisOptions(SIZE, threads=2)
    made = synthesize(shown, path, KnownDepth(), options, samples=memory)
    return [each.image.copy() for each in made if isinstance(each, Frame)]


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
