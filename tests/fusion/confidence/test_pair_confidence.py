"""The score needs no truth and ranks like it; shares are those of the sphere."""

import numpy as np
import pytest

from confidence_samples import generated_views, judged
from omnisyn_cli.evaluation.metrics.depth import rank_correlation
from omnisyn_cli.fusion.confidence import MIN_PAIR_SCORE, assess_pair
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.types import Layer

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
    room, far = generated_views("room", 106, 0.4, (128, 256)), generated_views("room", 104, 2.0, (128, 256))
    street = generated_views("street", 103, 3.0, (128, 256))
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
