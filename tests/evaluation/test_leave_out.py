"""Photographs of a tour, each compared with the frame that its neighbours make."""

from pathlib import Path

import numpy as np
import pytest
from hall_samples import run, write_halls

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets.layouts import tours_of_photographs
from omnisyn_cli.evaluation.datasets.sources import choose_pairs
from omnisyn_cli.evaluation.metrics.photographs import CAMERA_DEG, comparable_pixels, photograph_scores
from omnisyn_cli.geometry.pose import distance_between
from omnisyn_cli.io import write_image
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

ALL = comparable_pixels((128, 256))


@pytest.fixture(scope="module")
def walk() -> list[np.ndarray]:
    scene = generate_scene("street", 3)
    return [render_panorama(scene, pose, (128, 256), supersample=2)[0] for pose in sample_path(scene, 3, 3)]


def test_each_panorama_but_the_ends_is_the_truth_once(tmp_path: Path) -> None:
    write_halls(tmp_path / "tour", "hall")
    records = run(tmp_path / "tour", "crossfade,matching", leave_out=True)
    assert [record.scene for record in records[::2]] == ["hall: p0 to p2", "hall: p1 to p3"]
    assert all(record.status == "done" for record in records)
    scores = set(records[0].frames[0].scores)
    assert scores == {"ws_psnr", "ws_ssim", "aligned_psnr", "aligned_ssim", "misplacement", "shards"}


def test_a_pose_file_is_not_needed(tmp_path: Path) -> None:
    scene = generate_scene("street", 3)
    path = sample_path(scene, 3, 3)
    for number, pose in enumerate(path):
        image, _ = render_panorama(scene, pose, (384, 768), supersample=1)
        write_image(tmp_path / f"{number + 8}.jpg", image)
    (source,) = tours_of_photographs(tmp_path, choose_pairs("around"))
    frames = source.read().frames
    assert [frame.name for frame in frames] == ["8.jpg", "9.jpg", "10.jpg"]
    for poses in (path, [frame.pose for frame in frames]):
        assert distance_between(*poses[:2]) / distance_between(*poses[::2]) == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("more", [{"tours": True}, {"layout": "m3d"}])
def test_other_kinds_of_data_are_refused(tmp_path: Path, more: dict[str, object]) -> None:
    with pytest.raises(InputError, match="expected --leave-out alone"):
        run(tmp_path, "crossfade", leave_out=True, **more)


def test_too_few_photographs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected three photographs"):
        tours_of_photographs(tmp_path, choose_pairs("around"))


def test_light_does_not_count_and_neither_does_what_is_left_out(walk: list[np.ndarray]) -> None:
    truth = walk[1]
    darker = 0.5 * truth + np.array([0.1, 0.0, 0.2])
    darker[ALL[:, :, None].repeat(3, axis=2) == 0] = 1.0
    scores = photograph_scores(darker, truth, ALL)
    assert scores["ws_psnr"] > 60.0
    assert scores["ws_ssim"] > 0.999
    assert scores["misplacement"] < 0.1


@pytest.mark.parametrize("columns", [1, 2])
def test_what_is_a_little_off_is_aligned(walk: list[np.ndarray], columns: int) -> None:
    scores = photograph_scores(np.roll(walk[1], columns, axis=1), walk[1], ALL)
    assert scores["aligned_psnr"] > scores["ws_psnr"] + 3.0
    assert scores["misplacement"] == pytest.approx(columns * 360.0 / 256, rel=0.4)


def test_nothing_is_compared_around_the_nadir_or_behind_a_mask() -> None:
    mask = np.ones((64, 128), bool)
    mask[:8] = False
    usable = comparable_pixels((128, 256), mask, None)
    assert not usable[:16].any()
    assert usable[17].all()
    assert usable.any(axis=1).nonzero()[0].max() == round(128 * (1 - CAMERA_DEG / 180)) - 1
