"""Which frames are inputs; and photographs of a tour, each compared with what its neighbours make."""

from pathlib import Path

import numpy as np
import pytest
from hall_samples import run, write_halls

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets.layouts import tours_of_photographs
from omnisyn_cli.evaluation.datasets.sources import Scene, SceneFrame, choose_pairs, in_tours
from omnisyn_cli.evaluation.metrics.image import CAMERA_DEG, comparable_pixels, photograph_scores
from omnisyn_cli.geometry.pose import Pose, distance_between
from omnisyn_cli.io import write_image
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path


def scene(count: int, name: str = "hall") -> Scene:
    poses = [Pose(np.eye(3), np.array([0.0, 0.0, -k])) for k in range(count)]
    return Scene(name, tuple(SceneFrame(f"f{k}", Path(f"f{k}.png"), pose) for k, pose in enumerate(poses)))


def chosen(text: str | None, count: int, name: str = "hall") -> list[str]:
    return [
        f"{pair.first.name[1:]}[{''.join(frame.name[1:] for frame in pair.between)}]{pair.second.name[1:]}"
        for pair in choose_pairs(text)(scene(count, name))
    ]


@pytest.mark.parametrize(
    ("text", "count", "pairs"),
    [(None, 5, ["0[123]4"]), (None, 2, ["0[]1"]), (None, 1, []), (None, 0, []), ("0:4,1:3", 5, ["0[123]4", "1[2]3"]),
     ("every:2", 6, ["0[1]2", "2[3]4"]), ("every:2", 7, ["0[1]2", "2[3]4", "4[5]6"]), ("every:4", 4, [])],
)  # fmt: skip
def test_pairs_are_the_frames_asked_for(text, count, pairs):
    assert chosen(text, count) == pairs


def test_a_file_names_scenes_and_frames_by_name_or_index(tmp_path):
    path = tmp_path / "pairs.txt"
    path.write_text("# scene first second\nhall f1 4\n\nstreet 0 2  # the corner\nhall 0 2\n")
    assert chosen(str(path), 5) == ["1[23]4", "0[1]2"]
    assert chosen(str(path), 3, "street") == ["0[1]2"]
    assert chosen(str(path), 3, "campus") == []


@pytest.mark.parametrize("text", ["0", "0:x", "0-4", "every:0", "every:", "every:-1", "-1:3", "", "nosuch.txt"])
def test_what_is_no_list_of_pairs_is_refused(text):
    with pytest.raises(InputError, match="expected"):
        choose_pairs(text)


@pytest.mark.parametrize("text", ["0:5", "3:1", "2:2"])
def test_frames_that_a_scene_does_not_have_are_refused(text):
    with pytest.raises(InputError, match=r"between 0 and 4"):
        choose_pairs(text)(scene(5))


@pytest.mark.parametrize(("line", "message"), [("hall 0", "line 1"), ("hall 0 f9", "expected a frame of hall")])
def test_a_wrong_line_is_explained(tmp_path, line, message):
    path = tmp_path / "pairs.txt"
    path.write_text(line)
    with pytest.raises(InputError, match=message):
        choose_pairs(str(path))(scene(5))


def test_in_a_tour_pairs_know_the_panoramas_of_those_that_they_share_one_with():
    pairs = in_tours(choose_pairs("0:2,2:4,5:6")(scene(7)))
    around = [[frame and frame.name for frame in (pair.before, pair.after)] for pair in pairs]
    assert around == [[None, "f4"], ["f0", None], [None, None]]


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


def test_a_pose_file_is_not_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses are estimated once: a run that goes on has those of the first."""
    scene = generate_scene("street", 3)
    path = sample_path(scene, 3, 3)
    for number, pose in enumerate(path):
        image, _ = render_panorama(scene, pose, (384, 768), supersample=1)
        write_image(tmp_path / f"{number + 8}.jpg", image)
    (source,) = tours_of_photographs(tmp_path, choose_pairs("around"), tmp_path / "report")
    frames = source.read().frames
    monkeypatch.setattr("omnisyn_cli.evaluation.datasets.layouts.estimate_poses", None)
    again = source.read().frames
    assert all(one.pose.almost_equals(other.pose, metres=0.0) for one, other in zip(frames, again, strict=True))
    assert [frame.name for frame in frames] == ["8.jpg", "9.jpg", "10.jpg"]
    for poses in (path, [frame.pose for frame in frames]):
        assert distance_between(*poses[:2]) / distance_between(*poses[::2]) == pytest.approx(0.5, abs=0.03)


def test_other_kinds_of_data_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected --leave-out alone"):
        run(tmp_path, "crossfade", leave_out=True, layout="m3d")


def test_too_few_photographs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected three photographs"):
        tours_of_photographs(tmp_path, choose_pairs("around"), tmp_path)


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
