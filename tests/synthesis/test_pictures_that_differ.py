"""Exposure, masks, confidence and fallback, from panoramas to frames; a pair's own test of exposure and poses."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from confidence_samples import disturbed, generated_views
from interpolation_samples import edit_poses
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.fusion.photometry import rough_exposure_curve
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.synthesis.consistency import cross_check, equalize_exposure, subsample_depth
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, DepthEstimator, KnownDepth, View
from photometry_samples import exposed, in_eight_bits
from synthesis_samples import as_bytes, hall_view, posed, write_hall

SIZE = (128, 256)
ESTIMATORS: dict[str, DepthEstimator] = {
    "file": KnownDepth(),
    "matching": MatchingDepthEstimator(MatchingOptions(size=SIZE), threads=2),
}


@pytest.fixture(scope="module")
def room() -> tuple[View, ...]:
    return generated_views("room", 104, 1.0, SIZE)


def half_way(first: View, middle: View, last: View, estimator: DepthEstimator, **options: bool) -> np.ndarray:
    pair = SurfaceMethod(estimator, SynthesisOptions(SIZE, threads=2, **options)).prepare(0, [first, last])
    return np.clip(pair.frame(Waypoint(0, 0.5, middle.pose)).image, 0, 1)


@pytest.mark.parametrize(
    ("method", "stops"), [*product(ESTIMATORS, (1.0, -1.0)), pytest.param("file", (0.4, 0.0, -0.4), id="white balance")]
)
def test_a_stop_between_the_pictures_costs_less_than_a_decibel(room, method, stops) -> None:
    """Against what the frame of equally exposed pictures would be, given the exposure half way: 2^(stop/2) in light."""
    first, middle, last = room
    stops = np.array(stops)
    other = replace(last, image=in_eight_bits(exposed(last.image, stops)))
    truth = exposed(middle.image, stops / 2)
    best = ws_psnr(exposed(half_way(first, middle, last, ESTIMATORS[method]), stops / 2), truth)
    assert ws_psnr(half_way(first, middle, other, ESTIMATORS[method]), truth) > best - 1.0


def test_pictures_exposed_alike_are_not_changed_at_all(room: tuple[View, ...]) -> None:
    pair = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE)).prepare(0, [room[0], room[2]])
    assert pair.prepared.cross_check.curve.is_identity


def test_with_wrong_poses_a_cross_fade_is_shown_where_nothing_fits(room: tuple[View, ...]) -> None:
    """It is the mean of both photographs there, and closer to the truth than what the wrong poses make."""
    first, middle, last = room
    wrong = disturbed(last, 8.0, 0.4)
    plain, faded = (half_way(first, middle, wrong, KnownDepth(), faded_below=db) for db in (0.0, 19.2))
    assert ws_psnr(faded, middle.image) > ws_psnr(plain, middle.image)
    good = [half_way(first, middle, last, KnownDepth(), faded_below=db) for db in (0.0, 19.2)]
    np.testing.assert_array_equal(good[0], good[1])


def hall_job(folder: Path, baseline: float = 0.5, **options: object) -> InterpolationJob:
    images = write_hall(folder, [posed((0, 0, 0)), posed((baseline, 0, 0))])
    return InterpolationJob(tuple(images), folder / "poses.json", folder / "frames", frames=3, threads=1, **options)


def read_frames(folder: Path) -> list[np.ndarray]:
    return [read_panorama(path).image for path in sorted(folder.iterdir())]


def test_what_is_near_the_nadir_comes_from_the_other_panorama(tmp_path: Path) -> None:
    """A tripod painted into the first panorama shows, unless its cap is left out."""
    job = hall_job(tmp_path, baseline=2.0)
    clean = read_panorama(job.images[0]).image
    image = clean.copy()
    image[60:] = (1, 0, 1)
    write_image(job.images[0], as_bytes(image))
    run_interpolation(plan_interpolation(replace(job, nadir=np.radians(13.0), nadir_fill=True)))
    found = read_frames(job.output)
    assert np.abs(found[0][60:] - clean[60:]).mean() < 0.03
    np.testing.assert_allclose(found[0][:58], clean[:58], atol=0.02)


def test_the_ends_are_the_photographs_whatever_is_masked_and_it_fades(tmp_path: Path) -> None:
    """A cap shows in the first frame, half of it in the next, and none of it then."""
    job = replace(hall_job(tmp_path), frames=81, nadir=np.radians(13.0))
    images = [read_panorama(path).image.copy() for path in job.images]
    for path, image in zip(job.images, images, strict=True):
        image[60:] = (1, 0, 1)
        write_image(path, as_bytes(image))
    run_interpolation(plan_interpolation(job))
    found = read_frames(job.output)
    for frame, image in ((found[0], images[0]), (found[-1], images[1])):
        np.testing.assert_array_equal(as_bytes(frame), as_bytes(image))
    purple = [float((frame[62:] @ (0.5, -1.0, 0.5)).mean()) for frame in found]
    assert purple[0] > 0.99
    assert purple[0] > purple[1] > purple[2] > purple[3] > purple[4] + 0.05
    assert max(purple[4:-4]) < 0.3
    assert purple[-1] > purple[-2] > purple[-3] > purple[-4]


def test_a_mask_from_the_command_line_counts_like_one_of_the_pose_file(tmp_path: Path) -> None:
    job = hall_job(tmp_path)
    image = read_panorama(job.images[0]).image.copy()
    clean = image.copy()
    image[20:30, 40:60] = (1, 0, 1)
    write_image(job.images[0], as_bytes(image))
    masks = [np.ones((64, 128, 3), np.float32) for _ in range(2)]
    masks[0][20:30, 40:60] = 0
    for name, mask in zip(("m0.png", "m1.png"), masks, strict=True):
        write_image(tmp_path / name, as_bytes(mask))
    run_interpolation(
        plan_interpolation(replace(job, masks=(tmp_path / "m0.png", tmp_path / "m1.png"), nadir_fill=True))
    )
    assert np.abs(read_frames(job.output)[0][20:30, 40:60] - clean[20:30, 40:60]).mean() < 0.05


def test_the_summary_says_how_far_the_clip_can_be_relied_on(tmp_path: Path) -> None:
    job = hall_job(tmp_path, save_confidence=tmp_path / "confidence")
    summary = run_interpolation(plan_interpolation(job))
    described = json.loads(json.dumps(summary.describe()))["confidence"]
    assert 0.5 < described["score"] <= 1.0
    assert described["pairs"][0]["first"] == 0
    assert summary.warnings() == []
    sure = read_frames(tmp_path / "confidence")
    assert len(sure) == 3
    assert (sure[0] == 1).all()
    assert sure[1].mean() > 0.9


def test_wrong_poses_are_warned_about_or_refused(tmp_path: Path) -> None:
    job = hall_job(tmp_path)
    edit_poses(tmp_path, lambda panoramas: panoramas["p1.png"].update(rotation=[0.8, 0.0, 0.6, 0.0]))
    summary = run_interpolation(plan_interpolation(job))
    (warning,) = summary.warnings()
    assert "p0.png and p1.png" in warning
    refused = replace(job, output=tmp_path / "other", fallback="fail")
    with pytest.raises(InputError, match="expected a confidence of at least"):
        run_interpolation(plan_interpolation(refused))
    assert not refused.output.exists()


@pytest.mark.parametrize("is_doubtful", [True, False])
def test_a_doubtful_pair_is_cross_faded_and_keeps_its_photographs_at_the_ends(is_doubtful, tmp_path: Path) -> None:
    job = hall_job(tmp_path)
    if is_doubtful:
        edit_poses(tmp_path, lambda panoramas: panoramas["p1.png"].update(rotation=[0.8, 0.0, 0.6, 0.0]))
    shown = {}
    for fallback in ("auto", "none"):
        one = replace(job, output=tmp_path / fallback, fallback=fallback)
        summary = run_interpolation(plan_interpolation(one))
        assert bool(summary.warnings()) == is_doubtful
        is_faded = is_doubtful and fallback == "auto"
        assert any("), cross-faded, weakest" in line for line in summary.lines()) == is_faded
        assert any("; cross-faded: " in line for line in summary.warnings()) == is_faded
        assert any("--fallback crossfade" in line for line in summary.warnings()) == (is_doubtful and not is_faded)
        assert [pair["is_faded"] for pair in summary.describe()["confidence"]["pairs"]] == [is_faded]
        shown[fallback] = read_frames(one.output)
    for end in (0, 2):
        np.testing.assert_array_equal(shown["auto"][end], shown["none"][end])
    assert np.array_equal(shown["auto"][1], shown["none"][1]) == (not is_doubtful)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"masks": (Path("m0.png"),)}, "one mask for each of 2"), ({"nadir": 1.6}, "less than 90 degrees"),
     ({"nadir": -0.1}, "less than 90 degrees"), ({"fallback": "guess"}, "as fallback"),
     ({"save_confidence": Path("frames")}, "place of its own")],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_beforehand(options: dict, message: str, tmp_path: Path) -> None:
    job = hall_job(tmp_path)
    if "save_confidence" in options:
        options = {"save_confidence": job.output}
    with pytest.raises(InputError, match=message):
        plan_interpolation(replace(job, **options))


SMALL = (64, 128)


def hall_pair(size: tuple[int, int] = SMALL, stop: float = 0.0) -> tuple[View, View]:
    first, second = hall_view(posed((0, 0, 0)), size), hall_view(posed((0.6, 0.1, 0), heading=0.7), size)
    return first, replace(second, image=in_eight_bits(exposed(second.image, stop)))


def depths(pair: tuple[View, View]) -> tuple[DepthEstimate, DepthEstimate]:
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
    hole = np.zeros(SMALL, bool)
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
