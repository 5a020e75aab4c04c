"""A pair's own test finds its exposure and tells right poses from wrong ones, whatever the sizes and masks."""

from dataclasses import replace

import numpy as np
import pytest

from confidence_samples import disturbed
from omnisyn_cli.fusion.photometry import rough_exposure_curve
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.synthesis.consistency import cross_check, equalize_exposure, subsample_depth
from omnisyn_cli.types import DepthEstimate, View
from photometry_samples import exposed, in_eight_bits
from synthesis_samples import hall_view, posed

SIZE = (64, 128)


def hall_pair(size: tuple[int, int] = SIZE, stop: float = 0.0) -> tuple[View, View]:
    first, second = hall_view(posed((0, 0, 0)), size), hall_view(posed((0.6, 0.1, 0), heading=0.7), size)
    return first, replace(second, image=in_eight_bits(exposed(second.image, stop)))


def depths(pair: tuple[View, View]) -> tuple[DepthEstimate, DepthEstimate]:
    assert pair[0].known_depth is not None
    assert pair[1].known_depth is not None
    return pair[0].known_depth, pair[1].known_depth


@pytest.mark.parametrize("stop", [1.0, -1.0, 0.5])
def test_the_exposure_is_found_through_parallax_and_turning(stop: float) -> None:
    pair = hall_pair(stop=stop)
    check = cross_check(pair, depths(pair), Cut(), 1)
    np.testing.assert_allclose(check.curve.gain[:, 3], stop, atol=0.1)
    assert check.confidence.score > 0.4
    alike = hall_pair()
    assert cross_check(alike, depths(alike), Cut(), 1).curve.is_identity


def test_wrong_poses_score_less_and_less() -> None:
    first, second = hall_pair()
    scores = [
        cross_check((first, disturbed(second, angle, 0.0)), depths((first, second)), Cut(), 1).confidence.expected
        for angle in (0.0, 0.1, 0.3, 0.9)
    ]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > scores[-1] + 6


@pytest.mark.parametrize("factor", [2, 3, 4, 8])
def test_depth_made_smaller_stays_where_it_was(factor: int) -> None:
    """A ramp keeps its place to half a pixel of the larger map; an edge keeps both of its values."""
    rows, cols = 8 * factor, 16 * factor
    ramp = np.broadcast_to(np.arange(rows, dtype=np.float32)[:, None], (rows, cols))
    found = subsample_depth(DepthEstimate(ramp, 0.5 * ramp), (8, 16))
    centres = (np.arange(8) + 0.5) * factor - 0.5
    assert np.abs(found.inverse_depth - centres[:, None]).max() <= 0.5
    np.testing.assert_array_equal(found.confidence, 0.5 * found.inverse_depth)
    edge = np.where(np.arange(cols) < cols // 2 + 1, np.float32(1.0), np.float32(0.25)) + np.zeros(
        (rows, 1), np.float32
    )
    assert set(np.unique(subsample_depth(DepthEstimate(edge, edge), (8, 16)).inverse_depth)) == {0.25, 1.0}


@pytest.mark.parametrize("size", [(16, 32), (64, 128), (300, 600)])
@pytest.mark.parametrize("depth_rows", [32, 320])
def test_picture_and_depth_may_have_any_size(size: tuple[int, int], depth_rows: int) -> None:
    pair = hall_pair(size)
    estimates = depths(hall_pair((depth_rows, 2 * depth_rows)))
    assert cross_check(pair, estimates, Cut(), 1).confidence.score > 0.5


@pytest.mark.parametrize("size", [(16, 32), (300, 600)])
def test_both_pictures_need_not_have_one_size(size: tuple[int, int]) -> None:
    first, second = hall_pair()[0], hall_pair(size)[1]
    for pair in ((first, second), (second, first)):
        assert cross_check(pair, depths(pair), Cut(), 1).confidence.score > 0.5


def test_masked_pixels_are_not_compared() -> None:
    first, second = hall_pair()
    hole = np.zeros(SIZE, bool)
    hole[20:40, 30:60] = True
    image = first.image.copy()
    image[hole] = (1.0, 0.0, 1.0)
    painted = replace(first, image=image, mask=~hole)
    masked = cross_check((painted, second), depths((first, second)), Cut(), 1)
    assert masked.curve.is_identity
    assert masked.confidence.score == 1.0
    unmasked = cross_check((replace(first, image=image), second), depths((first, second)), Cut(), 1)
    assert unmasked.confidence.expected < masked.confidence.expected - 3.0


@pytest.fixture(scope="module")
def uneven() -> tuple[View, View]:
    """Two places of one scene, exposed alike; around one of them it is a third of a stop brighter."""
    scene = generate_scene("home", 2000012)
    ends = sample_path(scene, 2000012, 5)[::4]
    seen = (render_panorama(scene, pose, (128, 256), supersample=1, threads=1)[0] for pose in ends)
    first, second = (View(in_eight_bits(image), pose) for image, pose in zip(seen, ends, strict=True))
    return first, second


def test_a_brighter_place_is_not_taken_for_another_exposure(uneven: tuple[View, View]) -> None:
    assert np.abs(rough_exposure_curve(*uneven).gain.mean()) > 0.25
    assert all(a is b for a, b in zip(equalize_exposure(*uneven, 1), uneven, strict=True))


@pytest.mark.parametrize("stop", [1.0, -1.0])
def test_another_exposure_is_found_where_places_differ_as_well(uneven: tuple[View, View], stop: float) -> None:
    first, second = uneven
    changed = replace(second, image=in_eight_bits(exposed(second.image, stop)))
    alike = equalize_exposure(first, changed, 1)
    kept, dark = (0, 1) if stop > 0 else (1, 0)
    assert alike[kept] is (first, changed)[kept]
    expected = second.image if stop > 0 else exposed(first.image, stop)
    assert np.abs(np.median(alike[dark].image - expected)) < 0.03
