"""Which frames are inputs: the ends, indices, steps, or the lines of a file."""

from pathlib import Path

import numpy as np
import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets.sources import Scene, SceneFrame, choose_pairs, in_tours
from omnisyn_cli.geometry.pose import Pose


def scene(count: int, name: str = "hall") -> Scene:
    poses = [Pose(np.eye(3), np.array([0.0, 0.0, -k])) for k in range(count)]
    return Scene(name, tuple(SceneFrame(f"f{k}", Path(f"f{k}.png"), pose) for k, pose in enumerate(poses)))


def chosen(text: str | None, count: int, name: str = "hall") -> list[str]:
    """Every pair as ``first[between]second``, one digit a frame."""
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
