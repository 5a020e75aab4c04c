"""Two panoramas from one position behave alike everywhere, and so do two that are a nanometre apart."""

from dataclasses import replace

import numpy as np
import pytest

from omnisyn_cli.interpolation.api import estimate_depth, make_frames
from omnisyn_cli.pipeline.config import DepthSource, RunConfig
from omnisyn_cli.types import View
from synthesis_samples import hall_view, posed

MATCHING = RunConfig(DepthSource("matching", rows=64))


def views(distance: float) -> tuple[View, View]:
    """Two turned panoramas of the hall; their pictures are those of one position."""
    first, second = hall_view(posed((0.0, 0.0, 0.0))), hall_view(posed((0.0, 0.0, 0.0), 0.4))
    apart = replace(second.pose, position=np.array([0.0, 0.0, distance]))
    return replace(first, known_depth=None), replace(second, pose=apart, known_depth=None)


@pytest.mark.parametrize("distance", [0.0, 1e-9, 9e-7])
def test_there_is_no_depth_without_parallax(distance: float) -> None:
    for estimate in estimate_depth(*views(distance), MATCHING, threads=1):
        assert not estimate.inverse_depth.any()
        assert not estimate.confidence.any()


def test_frames_are_those_of_one_position() -> None:
    same, close = (
        list(make_frames(views(distance), 3, MATCHING, size=(32, 64), threads=1)) for distance in (0.0, 1e-9)
    )
    np.testing.assert_allclose(close, same, atol=1e-6)
