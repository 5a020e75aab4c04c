"""Steadiness along the geometry: exact frames are steady, and what is added to them is measured."""

import numpy as np
import pytest

from omnisyn_cli.evaluation.measure import change_psnr, flicker, warping_error
from omnisyn_cli.geometry.pose import Pose
from synthesis_samples import PHASES, RADIUS, WAVES, distance_to_wall, hall_image, posed

SIZE = (64, 128)
POSES = tuple(posed([0.15 * i, 0.05 * i, -0.1 * i], heading=0.3 * i, pitch=0.1 * i, roll=-0.2 * i) for i in range(4))
INVERSE_DEPTHS = tuple((1 / distance_to_wall(pose, SIZE)).astype(np.float32) for pose in POSES)
FRAMES = tuple(hall_image(pose, SIZE) for pose in POSES)
OFFSET = 0.05


def brightened(offsets: list[float]) -> list[np.ndarray]:
    return [frame + offset for frame, offset in zip(FRAMES, offsets, strict=True)]


def test_true_frames_of_a_static_scene_are_steady():
    assert warping_error(FRAMES, INVERSE_DEPTHS, POSES) < 5e-4
    assert flicker(FRAMES, INVERSE_DEPTHS, POSES) < 5e-4


def test_a_change_is_compared_with_the_true_change():
    """What is wrong alike in all frames is none; a step of e is 20·log10(1/e) dB wherever it happens, and once."""
    truths = [frame.astype(np.float64) for frame in FRAMES]
    assert min(change_psnr([0.5 * OFFSET + truth for truth in truths], truths)) > 200
    stepped = [truth + offset for truth, offset in zip(truths, [0, 0, OFFSET, OFFSET], strict=True)]
    before, at, after = change_psnr(stepped, truths)
    assert at == pytest.approx(-20 * np.log10(OFFSET))
    assert before == np.inf
    assert after > 200
    assert change_psnr(FRAMES[:1], truths[:1]) == []


def test_without_the_geometry_they_would_not_be():
    """The same frames with a pose, a turn or a depth that is wrong."""
    still = [Pose.identity()] * 4
    mirrored = [Pose(pose.rotation, -pose.position) for pose in POSES]
    assert warping_error(FRAMES, INVERSE_DEPTHS, still) > 0.02
    assert warping_error(FRAMES, INVERSE_DEPTHS, mirrored) > 0.01
    assert warping_error(FRAMES, [0.8 * rho for rho in INVERSE_DEPTHS], POSES) > 0.005


def test_a_step_in_brightness_is_the_warping_error():
    assert warping_error(brightened([0, 1, 2, 3]), INVERSE_DEPTHS, POSES) == pytest.approx(1, abs=1e-3)
    assert warping_error(brightened([0, -OFFSET, 0, OFFSET]), INVERSE_DEPTHS, POSES) == pytest.approx(OFFSET, abs=1e-3)


def test_a_steady_change_is_no_flicker_and_a_flash_counts_twice():
    steady = flicker(brightened([0, OFFSET, 2 * OFFSET, 3 * OFFSET]), INVERSE_DEPTHS, POSES)
    alternating = flicker(brightened([OFFSET, -OFFSET, OFFSET, -OFFSET]), INVERSE_DEPTHS, POSES)
    flash = flicker(brightened([0, OFFSET, 0, 0])[:3], INVERSE_DEPTHS[:3], POSES[:3])
    assert steady < 1e-3
    assert alternating == pytest.approx(4 * OFFSET, abs=1e-3)
    assert flash == pytest.approx(2 * OFFSET, abs=1e-3)


def test_agrees_with_the_definition_pixel_by_pixel():
    """The colour of the wall at the point that each pixel of the first frame sees, turned negative in the second."""
    negative = 1.0 - FRAMES[1]
    directions = np.array([[direction(row, col) for col in range(SIZE[1])] for row in range(SIZE[0])])
    total = weight_sum = 0.0
    for row, col in np.ndindex(SIZE):
        point = POSES[0].transform(directions[row, col] / INVERSE_DEPTHS[0][row, col])
        assert np.linalg.norm(point) == pytest.approx(RADIUS, rel=1e-5)
        colour = 1.0 - (0.5 + 0.4 * np.sin(point @ WAVES.T + PHASES))
        weight = np.sin((row + 0.5) * np.pi / SIZE[0])
        total += weight * np.abs(colour - FRAMES[0][row, col]).mean()
        weight_sum += weight
    result = warping_error([FRAMES[0], negative], INVERSE_DEPTHS[:2], POSES[:2])
    assert result == pytest.approx(total / weight_sum, rel=2e-3)


def direction(row: int, col: int) -> np.ndarray:
    azimuth, polar = (col + 0.5) / SIZE[1] * 2 * np.pi - np.pi, (row + 0.5) / SIZE[0] * np.pi
    return np.array([np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)])


@pytest.mark.parametrize("hidden_by", [2.0, -1.0, np.nan], ids=["something-nearer", "nothing-known", "not-a-number"])
def test_what_one_frame_does_not_see_does_not_count(hidden_by):
    """A patch of the second frame is spoiled; with a depth that is not the first frame's it is not looked at."""
    frames, depths = list(FRAMES), list(INVERSE_DEPTHS)
    frames[1] = frames[1].copy()
    frames[1][24:40, 32:96] = 5.0
    assert warping_error(frames, depths, POSES) > 0.1
    depths[1] = depths[1].copy()
    depths[1][22:42, 30:98] = hidden_by
    frames[1][20:22] = FRAMES[1][20:22]
    assert warping_error(frames[:2], depths[:2], POSES[:2]) < 5e-4
    assert flicker(frames[:3], depths[:3], POSES[:3]) < 5e-4


def test_infinity_is_steady_wherever_the_camera_goes():
    """A sky turns with the camera and does not move."""
    skies = [np.zeros(SIZE)] * 3
    frames = [0.5 + 0.4 * np.stack([np.sin(3 * _world(pose)[..., k]) for k in range(3)], -1) for pose in POSES[:3]]
    assert warping_error(frames, skies, POSES[:3]) < 5e-4
    assert flicker(frames, skies, POSES[:3]) < 5e-4


def _world(pose: Pose) -> np.ndarray:
    directions = np.array([[direction(row, col) for col in range(SIZE[1])] for row in range(SIZE[0])])
    return directions @ pose.rotation.T


def test_the_horizon_counts_more_than_the_poles():
    """In place, the share of the error is that of the solid angle: the upper quarter of the rows is (1 − √½) / 2."""
    spoiled = FRAMES[0].copy()
    spoiled[: SIZE[0] // 4] += 1.0
    result = warping_error([FRAMES[0], spoiled], [INVERSE_DEPTHS[0]] * 2, [POSES[0]] * 2)
    assert result == pytest.approx((1 - np.sqrt(0.5)) / 2, rel=1e-3)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match="something in common"):
        warping_error(FRAMES[:2], [np.full(SIZE, 0.5), np.full(SIZE, 0.1)], POSES[:2])
