"""Depth by matching against closed forms, whatever it is shown; and limits to threads, which change nothing."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from stereo_samples import OPENINGS, SIZE, landscape, room

from omnisyn_cli.compute.threads import allowed_threads, both, limited_threads, run_ranges
from omnisyn_cli.errors import ImageError
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_quaternion
from omnisyn_cli.geometry.sweep import swap_cameras_in_epipole_frame
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.stereo import disparity as disparity_module
from omnisyn_cli.stereo import matching_estimator
from omnisyn_cli.stereo.disparity import DisparityMap, left_right_check
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.types import DepthEstimate, View

ORIGIN = Pose.identity()
DATA = Path(__file__).parents[3] / "shared" / "data"


def share_within(estimate: np.ndarray, truth: np.ndarray, factor: float) -> float:
    ratio = np.maximum(estimate, 1e-9) / truth
    return float(np.mean(np.maximum(ratio, 1.0 / ratio) < factor))


def is_valid(estimate: DepthEstimate) -> bool:
    rho, confidence = estimate.inverse_depth, estimate.confidence
    finite = np.isfinite(rho).all() and np.isfinite(confidence).all()
    return bool(finite and rho.min() >= 0 and confidence.min() >= 0 and confidence.max() <= 1)


@pytest.mark.parametrize("name", OPENINGS)
def test_a_textured_room_is_recovered_from_both_ends_of_any_baseline(estimator, name) -> None:
    (first, truth_first), (second, truth_second) = room(ORIGIN), room(OPENINGS[name])
    for estimate, truth in zip(estimator(first, second), (truth_first, truth_second), strict=True):
        assert share_within(estimate.inverse_depth, truth, 1.25) > 0.97
        assert share_within(estimate.inverse_depth, truth, 1.05) > 0.85
        assert estimate.confidence.mean() > 0.8


@pytest.mark.parametrize("name", ["level", "oblique and turned"])
def test_swapping_the_inputs_swaps_the_outputs(estimator: MatchingDepthEstimator, name: str) -> None:
    first, second = room(ORIGIN)[0], room(OPENINGS[name])[0]
    estimates, swapped = estimator(first, second), estimator(second, first)
    for a, b in zip(estimates, swapped[::-1], strict=True):
        assert np.mean(np.isclose(a.inverse_depth, b.inverse_depth, rtol=1e-3)) > 0.99


def test_rolling_the_columns_of_both_inputs_rolls_the_outputs(estimator: MatchingDepthEstimator) -> None:
    views, columns = (room(ORIGIN)[0], room(OPENINGS["level"])[0]), SIZE[1] // 4
    turn = rotation_from_heading(-2.0 * np.pi * columns / SIZE[1])
    rolled = [View(np.roll(v.image, columns, axis=1), Pose(v.pose.rotation @ turn, v.pose.position)) for v in views]
    for before, after in zip(estimator(*views), estimator(*rolled), strict=True):
        expected = np.roll(before.inverse_depth, columns, axis=1)
        assert np.mean(np.isclose(expected, after.inverse_depth, rtol=0.02)) > 0.97


def test_how_the_second_camera_was_held_does_not_matter_to_the_first(estimator: MatchingDepthEstimator) -> None:
    first, upright = room(ORIGIN)[0], OPENINGS["level"]
    tilted = Pose(rotation_from_heading(2.0, 0.4, 0.3), upright.position)
    a, b = (estimator(first, room(pose)[0])[0].inverse_depth for pose in (upright, tilted))
    assert share_within(a, b, 1.05) > 0.93


def test_all_lengths_scale_together(estimator: MatchingDepthEstimator) -> None:
    first, second = room(ORIGIN)[0], room(OPENINGS["level"])[0]
    far = View(second.image, Pose(second.pose.rotation, 10.0 * second.pose.position))
    near, scaled = estimator(first, second)[0], estimator(first, far)[0]
    np.testing.assert_allclose(near.inverse_depth, 10.0 * scaled.inverse_depth, rtol=1e-4)


def test_the_sky_is_exactly_zero_and_the_ground_is_flat(estimator: MatchingDepthEstimator) -> None:
    (first, truth), (second, _) = landscape(ORIGIN), landscape(OPENINGS["level"])
    estimate = estimator(first, second)[0].inverse_depth
    horizon = SIZE[0] // 2
    assert np.mean(estimate[: horizon - 8] == 0) > 0.97
    assert share_within(estimate[horizon + 20 :], truth[horizon + 20 :], 1.1) > 0.95


def test_a_plain_ceiling_is_no_sky_because_a_window_shows_some() -> None:
    scene = generate_scene("room", 20_000_020)
    path = sample_path(scene, 20_000_020, 2, baseline=1.0, vertical=0.0)
    first, second = (View(render_panorama(scene, pose, (512, 1024), supersample=2)[0], pose) for pose in path)
    for features in MatchingDepthEstimator(threads=1).features(first, second):
        assert not features.sky.any()
        assert (features.filled[:64] > 0.1).mean() > 0.95, "the ceiling is two metres overhead"


def test_a_bright_blank_ceiling_is_no_sky(estimator: MatchingDepthEstimator) -> None:
    (first, truth), (second, _) = room(ORIGIN, blank_ceiling=True), room(OPENINGS["level"], blank_ceiling=True)
    estimate = estimator(first, second)[0].inverse_depth
    assert estimate.min() > 0
    below = slice(SIZE[0] // 2, None)
    assert share_within(estimate[below], truth[below], 1.1) > 0.9


@pytest.mark.parametrize("metres", [0.0, 1e-9])
def test_equal_positions_give_zero_with_no_confidence(estimator: MatchingDepthEstimator, metres: float) -> None:
    first = room(ORIGIN)[0]
    turned = room(Pose(rotation_from_heading(1.0), np.array([metres, 0.0, 0.0])))[0]
    for estimate in estimator(first, turned):
        assert estimate.inverse_depth.shape == SIZE
        assert not estimate.inverse_depth.any()
        assert not estimate.confidence.any()


@pytest.mark.parametrize("kind", ["noise", "black", "white", "two greys"])
def test_nothing_to_see_is_never_a_spike(estimator: MatchingDepthEstimator, kind: str) -> None:
    rng = np.random.default_rng(1)
    images = {
        "noise": rng.random((2, *SIZE, 3)),
        "black": np.zeros((2, *SIZE, 3)),
        "white": np.ones((2, *SIZE, 3)),
        "two greys": np.stack([np.full((*SIZE, 3), 0.2), np.full((*SIZE, 3), 0.7)]),
    }[kind].astype(np.float32)
    both = estimator(View(images[0], ORIGIN), View(images[1], OPENINGS["level"]))
    assert all(is_valid(estimate) for estimate in both)


@pytest.mark.parametrize("size", [(32, 64), (300, 600)])
def test_images_of_any_size_are_welcome(estimator: MatchingDepthEstimator, size: tuple[int, int]) -> None:
    both = estimator(room(ORIGIN, size)[0], room(OPENINGS["level"], size)[0])
    assert all(is_valid(e) and e.inverse_depth.shape == SIZE for e in both)


def test_an_image_that_is_no_panorama_is_refused(estimator: MatchingDepthEstimator) -> None:
    view = room(ORIGIN)[0]
    with pytest.raises(ImageError, match="got 256×192"):
        estimator(view, View(view.image[:, :256], OPENINGS["level"]))


def test_what_a_mask_hides_changes_nothing_and_is_filled(estimator: MatchingDepthEstimator) -> None:
    (first, truth), (second, _) = room(ORIGIN), room(OPENINGS["level"])
    mask = np.ones(SIZE, bool)
    mask[140:, 80:220] = False
    rng = np.random.default_rng(2)
    views = [
        View(np.where(mask[..., None], v.image, rng.random(3)).astype(np.float32), v.pose, mask)
        for v in (first, second)
    ]
    estimate = estimator(*views)[0]
    hidden = np.zeros(SIZE, bool)
    hidden[146:, 86:214] = True
    assert estimate.confidence[hidden].max() < 0.1
    assert share_within(estimate.inverse_depth[hidden], truth[hidden], 1.25) > 0.9


def test_rendered_warehouse_with_true_depth() -> None:
    oiio = pytest.importorskip("OpenImageIO")
    folder = DATA / "warehouse_0"
    if not folder.is_dir():
        pytest.skip(f"no test data at {folder}")
    panoramas = json.loads((folder / "poses.json").read_text())["panoramas"]
    views, truths = [], []
    for name in ("0000.png", "0004.png"):
        entry = panoramas[name]
        pose = Pose(rotation_from_quaternion(np.array(entry["rotation"], float)), np.array(entry["position"], float))
        image = oiio.ImageBuf(str(folder / name)).get_pixels(oiio.FLOAT)[..., :3]
        views.append(View(np.ascontiguousarray(image), pose))
        truths.append(1.0 / oiio.ImageBuf(str(folder / entry["depth"])).get_pixels(oiio.FLOAT)[..., 0])
    for estimate, truth in zip(MatchingDepthEstimator(MatchingOptions())(*views), truths, strict=True):
        assert share_within(estimate.inverse_depth, truth, 1.25) > 0.93
        assert share_within(estimate.inverse_depth, truth, 1.05) > 0.80


@pytest.mark.parametrize(("rows", "apart", "is_confirmed"), [
    (4.0, 0.9, True), (4.0, 1.1, False), (40.0, 1.9, True), (40.0, -1.9, True), (40.0, 2.1, False), (40.0, -2.1, False),
])  # fmt: skip
def test_both_directions_may_differ_by_more_about_near_things(rows: float, apart: float, is_confirmed: bool) -> None:
    """Far things move by a few rows, near ones by many; the other direction has found some rows more or less."""
    size, options = (64, 4), MatchingOptions()
    first = DisparityMap(np.full(size, rows, np.float32), np.ones(size, np.bool_))
    second = DisparityMap(
        swap_cameras_in_epipole_frame(np.full(size, rows + apart, np.float32)), np.ones(size, np.bool_)
    )
    valid = left_right_check((first, second), options.left_right_rows, options.near_left_right_rows)[0].valid
    assert valid[: 64 - int(rows)].all() == is_confirmed
    assert not valid[64 - int(rows) :].any()


def test_a_slope_is_read_between_the_rows_of_the_other_direction(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other picture foreshortens it: its disparity changes by 1.5 a row, and is found 0.8 too large."""
    rows = np.arange(64, dtype=np.float64)
    disparity = np.interp(rows, [10.0, 30.0], [12.0, 0.0])
    in_second = rows - np.interp(rows, rows + disparity, rows) + 0.8
    everywhere = np.ones((64, 4), np.bool_)
    first, second = (np.repeat(d[:, None], 4, axis=1).astype(np.float32) for d in (disparity, in_second))
    found = DisparityMap(first, everywhere), DisparityMap(swap_cameras_in_epipole_frame(second), everywhere)
    assert left_right_check(found, 1.0)[0].valid.all()
    monkeypatch.setattr(disparity_module, "MAX_INTERPOLATED_STEP", -1.0)
    assert 0.2 < left_right_check(found, 1.0)[0].valid[10:30].mean() < 0.9


FEW_PIXELS = MatchingOptions(size=(96, 192))


def counts() -> tuple[int, int]:
    return allowed_threads(), cv2.getNumThreads()


def test_the_limit_holds_inside_and_is_gone_after_a_failure() -> None:
    before = counts()

    def fail() -> None:
        with limited_threads(1):
            assert counts() == (1, 1)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert counts() == before


@pytest.mark.parametrize("threads", [None, 10_000])
def test_a_limit_above_what_there_is_changes_nothing(threads: int | None) -> None:
    before = counts()
    with limited_threads(threads):
        assert counts() == before


def test_limits_lie_within_each_other_and_loops_keep_to_them() -> None:
    """A band per thread would be handed to a pool; on one thread there is a single plain call."""
    calls: list[tuple[int, int]] = []
    with limited_threads(1), limited_threads(2):
        assert counts() == (1, 1)
        run_ranges(lambda begin, end: calls.append((begin, end)), 100)
    assert calls == [(0, 100)]


def test_there_is_at_least_one_thread() -> None:
    with pytest.raises(ValueError, match="got 0"), limited_threads(0):
        pass


def test_an_estimate_keeps_to_its_threads_and_does_not_depend_on_them(monkeypatch: pytest.MonkeyPatch) -> None:
    views = room(Pose.identity(), FEW_PIXELS.size)[0], room(OPENINGS["level"], FEW_PIXELS.size)[0]
    seen = []
    plain = matching_estimator.fill_with_planes
    monkeypatch.setattr(matching_estimator, "fill_with_planes", lambda *a: seen.append(counts()) or plain(*a))
    many = MatchingDepthEstimator(FEW_PIXELS)
    for free, limited in zip(many(*views), replace(many, threads=1)(*views), strict=True):
        np.testing.assert_array_equal(free.inverse_depth, limited.inverse_depth)
        np.testing.assert_array_equal(free.confidence, limited.confidence)
    assert seen == [counts()] * 2 + [(1, 1)] * 2


@pytest.mark.parametrize("threads", [1, None])
def test_both_are_done_under_the_limit_and_failures_are_told(threads: int | None) -> None:
    with limited_threads(threads):
        inside = allowed_threads()
        assert both(allowed_threads, allowed_threads) == (inside, inside)
        with pytest.raises(ZeroDivisionError):
            both(lambda: 1, lambda: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            both(lambda: 1 // 0, lambda: 1)
