"""The score of a pair needs no truth and ranks like it; confidence by pixel, and regions that are given up."""

import numpy as np
import pytest

from confidence_samples import generated_views, judged
from omnisyn_cli.evaluation.metrics.depth import rank_correlation
from omnisyn_cli.fusion.confidence import assess_pair, confidence_step, low_confidence_regions
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.pipeline.config import MIN_PAIR_SCORE
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import KnownDepth, Layer

SIZE = (32, 64)


def rendering(
    value: float | np.ndarray = 0.5, rho: float | np.ndarray = 0.2, weight: float | np.ndarray = 1.0
) -> Layer:
    colour = np.empty((*SIZE, 4), np.float32)
    colour[..., :3] = np.broadcast_to(np.asarray(value), SIZE)[..., None]
    colour[..., 3] = weight
    return Layer.from_arrays(np.full(SIZE, rho, np.float32), colour, Pose(np.eye(3), np.zeros(3)))


def test_scores_rank_pairs_like_their_true_frames_do() -> None:
    """Rooms and a street, near and far, true poses and wrong ones; the larger version is a benchmark."""
    room, far = generated_views("room", 106, 0.4, (64, 128)), generated_views("room", 104, 2.0, (64, 128))
    street = generated_views("street", 103, 3.0, (64, 128))
    cases = [(room, 0, 0), (room, 1, 0.02), (room, 4, 0.1), (far, 0, 0), (far, 2, 0.1), (far, 8, 0.4),
             (street, 0, 0), (street, 1, 0.05), (street, 6, 0.5)]  # fmt: skip
    found = [judged(str(k), *case) for k, case in enumerate(cases)]
    scores, true = (np.array([getattr(each, name) for each in found]) for name in ("score", "true"))
    assert rank_correlation(scores, true, np.ones(len(found))) > 0.7
    assert found[0].score > 0.6
    assert found[5].score < MIN_PAIR_SCORE


@pytest.mark.parametrize(("difference", "score"), [(0.0, 1.0), (10**-1.2, 0.5), (10**-0.5, 0.0)])
def test_the_score_is_linear_in_decibels(difference: float, score: float) -> None:
    """24 dB lies half way between 12 and 36."""
    one, other = rendering(0.2), rendering(0.2 + difference)
    assert assess_pair([(one, other), (other, one)], (one, other)).score == pytest.approx(score, abs=1e-3)


def test_half_of_it_is_what_happens_half_way() -> None:
    same, other = rendering(0.2), rendering(0.4)
    found = assess_pair([(same, same), (same, same)], (same, other))
    assert found.expected == pytest.approx(-10 * np.log10(0.5 * 0.2**2), abs=1e-3)
    found = assess_pair([(same, other), (same, same)], (same, same))
    assert found.expected == pytest.approx(-10 * np.log10(0.25 * 0.2**2), abs=1e-3)


def test_shares_are_counted_by_solid_angle() -> None:
    row = np.arange(SIZE[0])[:, None] * np.ones(SIZE)
    weight = solid_angles(*SIZE) / (4 * np.pi)
    first = rendering(0.5, np.where(row < 4, -1.0, 0.2), np.where(row < 4, 0.0, 1.0))
    seen = row >= 8
    rho = np.where(seen, np.where(row < 16, 0.3, 0.2), -1.0)
    second = rendering(np.where(row >= 28, 0.9, 0.5), rho, np.where(seen, 1.0, 0.0))
    found = assess_pair([(first, first), (second, second)], (first, second))
    assert found.unseen == pytest.approx(weight[row < 4].sum(), abs=1e-6)
    assert found.depth_disagreement == pytest.approx(weight[(row >= 8) & (row < 16)].sum(), abs=1e-6)
    assert found.inconsistency == pytest.approx(weight[row >= 28].sum(), abs=1e-6)


def test_doubled_contours_lower_the_score_and_areas_without_contrast_do_not_count() -> None:
    """Stripes beside stripes, against stripes that are brighter by as much as those differ."""
    stripes = 0.5 + 0.1 * np.sign(np.sin(np.arange(SIZE[1]) * (2 * np.pi / 8) + 0.3)) + np.zeros(SIZE)
    same, beside, brighter = rendering(stripes), rendering(1.0 - stripes), rendering(stripes + 0.2)
    doubled, plain = (assess_pair([(same, same)] * 2, (same, other)) for other in (beside, brighter))
    assert doubled.expected == pytest.approx(plain.expected, abs=1e-3)
    assert doubled.doubling > 0.99
    assert plain.doubling == 0.0
    assert doubled.score < plain.score - 0.1
    upper = np.arange(SIZE[0])[:, None] < SIZE[0] // 2
    one, other = (rendering(np.where(upper, values, 0.5)) for values in (stripes, 1.0 - stripes))
    assert assess_pair([(same, same)] * 2, (one, other)).doubling > 0.9


def test_nothing_in_common_is_the_worst() -> None:
    nothing = rendering(0.0, -1.0, 0.0)
    found = assess_pair([(rendering(), nothing)] * 2, (nothing, nothing))
    assert found.score == 0
    assert found.unseen == pytest.approx(1.0)
    assert set(found.describe()) == {"score", "expected_db", "unseen", "disagreement", "inconsistency", "doubling"}


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.3, 1.0)])
def test_the_weakest_direction_is_where_colours_differ(direction: tuple[float, float, float]) -> None:
    """At a side, at a pole and at the seam; one small error elsewhere is not mistaken for it."""
    where = pixel_directions(*SIZE) @ (np.array(direction) / np.linalg.norm(direction)) > np.cos(0.4)
    error = np.where(where, 0.3, 0.0)
    error[SIZE[0] // 2, SIZE[1] // 2] = 0.4
    same, other = rendering(0.2), rendering(0.2 + error)
    found = np.array(assess_pair([(same, same), (same, same)], (same, other)).weakest)
    assert found @ direction / np.linalg.norm(direction) > np.cos(np.radians(20.0))


SMALL = (16, 32)


def random_rendering(seed: int) -> Layer:
    rng = np.random.default_rng(seed)
    colour = rng.random((*SMALL, 4), np.float32)
    colour[..., :3] = 0.5 + 0.1 * colour[..., :3]
    rho = (0.2 + 0.05 * rng.random(SMALL)).astype(np.float32)
    hole = rng.random(SMALL) < 0.3
    colour[hole], rho[hole] = 0, -1
    return Layer.from_arrays(rho, colour, Pose(np.eye(3), np.zeros(3)))


def confidence_of(first: Layer, second: Layer) -> np.ndarray:
    """From two bands."""
    out = np.full(SMALL, np.nan, np.float32)
    judge = confidence_step(first.inverse_depth, second.inverse_depth, out)
    for rows in (slice(0, 5), slice(5, SMALL[0])):
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
