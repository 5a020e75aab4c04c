"""Confidence by pixel against its definition, and regions that are given up."""

import numpy as np
import pytest

from confidence_samples import generated_views
from omnisyn_cli.fusion.confidence import confidence_step, low_confidence_regions
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import KnownDepth, Layer

SIZE = (16, 32)


def random_rendering(seed: int) -> Layer:
    rng = np.random.default_rng(seed)
    colour = rng.random((*SIZE, 4), np.float32)
    colour[..., :3] = 0.5 + 0.1 * colour[..., :3]
    rho = (0.2 + 0.05 * rng.random(SIZE)).astype(np.float32)
    hole = rng.random(SIZE) < 0.3
    colour[hole], rho[hole] = 0, -1
    return Layer.from_arrays(rho, colour, Pose(np.eye(3), np.zeros(3)))


def confidence_of(first: Layer, second: Layer) -> np.ndarray:
    """From two bands."""
    out = np.full(SIZE, np.nan, np.float32)
    judge = confidence_step(first.inverse_depth, second.inverse_depth, out)
    for rows in (slice(0, 5), slice(5, SIZE[0])):
        judge(first.colour[rows], second.colour[rows], rows.start)
    return out


def test_it_is_what_it_says() -> None:
    first, second = random_rendering(1), random_rendering(2)
    a, b = first.colour.astype(float), second.colour.astype(float)
    gap = np.abs(first.inverse_depth - second.inverse_depth) / np.maximum(first.inverse_depth, second.inverse_depth)
    differs = ((a - b)[..., :3] ** 2).mean(-1) / 0.15**2
    seen = (a[..., 3] > 1e-4).astype(int) + (b[..., 3] > 1e-4)
    agree = np.exp(-((gap / 0.1) ** 2) - differs)
    believed = np.minimum(1, 4 * np.maximum(a[..., 3], b[..., 3]))
    expected = believed * np.where(seen == 2, agree, np.where(seen == 1, 0.6, 0.0))
    found = confidence_of(first, second)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_array_equal(found, confidence_of(second, first))


def test_pixels_of_low_confidence_are_worse_than_those_of_high_confidence() -> None:
    views = generated_views("room", 104, 1.0, (128, 256))
    method = SurfaceMethod(KnownDepth(), SynthesisOptions((128, 256), threads=2, confidence=True))
    (frame,) = synthesize([views[0], views[2]], [Waypoint(0, 0.5, views[1].pose)], method)
    assert frame.confidence is not None
    error = ((frame.image - views[1].image) ** 2).mean(-1)
    low, high = (frame.confidence < 0.4), (frame.confidence > 0.8)
    assert min(low.mean(), high.mean()) > 0.01
    assert error[low].mean() > 3 * error[high].mean()


@pytest.mark.parametrize("size", [(16, 32), (64, 128), (100, 200), (256, 512)])
def test_regions_are_smooth_and_cover_what_is_low(size: tuple[int, int]) -> None:
    confidence = np.ones(size, np.float32)
    np.testing.assert_array_equal(low_confidence_regions(confidence), 0)
    np.testing.assert_array_equal(low_confidence_regions(0 * confidence), 1)
    half = size[1] // 2
    confidence[:, :half] = 0
    doubt = low_confidence_regions(confidence)
    assert (doubt[:, half // 2] == 1).all()
    assert (doubt[:, half + half // 2] == 0).all()
    assert ((doubt >= 0) & (doubt <= 1)).all()


def test_regions_turn_with_the_panorama_across_the_seam() -> None:
    confidence = np.ones((64, 128), np.float32)
    confidence[20:40, 60:90] = 0.1
    rolled = low_confidence_regions(np.roll(confidence, 48, axis=1))
    np.testing.assert_allclose(rolled, np.roll(low_confidence_regions(confidence), 48, axis=1), atol=1e-5)


def test_a_speck_is_no_region() -> None:
    confidence = np.ones((256, 512), np.float32)
    confidence[100:104, 200:204] = 0
    np.testing.assert_array_equal(low_confidence_regions(confidence), 0)
