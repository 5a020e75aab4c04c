"""What is left out of a command is found: the pose file, the panoramas of a folder, the name of what is made."""

from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from cli.cli_samples import Omnisyn, write_pair
from interpolation_samples import CHAIN
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.inputs import NamedTour, named_tour, video_ending
from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES
from omnisyn_cli.poses.file import POSES_NAME, PosedPanorama, read_poses, write_poses
from synthesis_samples import write_hall

# The ending of what a command makes, and options that make it cheap.
COMMANDS: dict[str, tuple[str, tuple[object, ...]]] = {
    "interpolate": (".mp4", ("--frames", 3, "--encoder-preset", "ultrafast")),
    "view": (".html", ()),
    "export": (".glb", ()),
}
every_command = pytest.mark.parametrize("command", COMMANDS)


@pytest.fixture
def walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder ``tour`` with three panoramas and their poses, in the current folder."""
    folder = tmp_path / "tour"
    folder.mkdir()
    write_hall(folder, CHAIN)
    monkeypatch.chdir(tmp_path)
    return folder


def cheap(command: str, *arguments: object) -> list[object]:
    return [command, *arguments, "--threads", 1, *COMMANDS[command][1]]


def planned(omnisyn: Omnisyn, command: str, *arguments: object) -> Any:
    return omnisyn.json(*cheap(command, *arguments), "--dry-run")


def names(walk: Path) -> list[str]:
    return list(read_poses(walk / POSES_NAME).panoramas)


@every_command
def test_the_output_is_named_after_the_first_and_the_last_panorama(walk: Path, omnisyn: Omnisyn, command: str) -> None:
    """In the current folder, and nothing there is replaced unless that is asked for."""
    images = [walk / name for name in names(walk)]
    output = Path(f"{images[0].stem}-{images[-1].stem}{COMMANDS[command][0]}")
    words = cheap(command, *images, "--poses", walk / POSES_NAME)
    assert omnisyn.quiet(*words).out.startswith(f"{output}: ")
    made = output.read_bytes()
    output.write_text("mine")
    assert omnisyn.refused(*words).startswith(f"omnisyn: {output}: expected a new file, got one that exists")
    assert output.read_text() == "mine"
    omnisyn.made(*words, "--overwrite")
    assert output.read_bytes() == made


@every_command
def test_a_folder_stands_for_the_panoramas_that_its_pose_file_names(walk: Path, omnisyn: Omnisyn, command: str) -> None:
    """In the order of the file, which is not that of their names; other images in the folder are not looked at."""
    poses = read_poses(walk / POSES_NAME).panoramas
    write_poses(walk / POSES_NAME, dict(reversed(poses.items())))
    (walk / "0.png").write_text("no panorama")
    plan = planned(omnisyn, command, "tour/")
    assert plan["inputs"] == [f"tour/{name}" for name in reversed(poses)]
    assert plan["output"] == f"tour{COMMANDS[command][0]}"
    omnisyn.quiet(*cheap(command, "tour"))
    assert Path(plan["output"]).is_file()


@every_command
def test_poses_are_looked_for_beside_the_panoramas(
    walk: Path, omnisyn: Omnisyn, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = names(walk)
    assert planned(omnisyn, command, *(walk / image for image in images[:2]))["depth"] == "file"
    monkeypatch.chdir(walk)
    assert planned(omnisyn, command, *images)["inputs"] == images
    assert planned(omnisyn, command, ".")["output"] == f"tour{COMMANDS[command][0]}"
    (walk / POSES_NAME).rename(walk / "other.json")
    assert "expected --poses, or a poses.json beside" in omnisyn.refused(*cheap(command, *images))
    assert planned(omnisyn, command, ".", "--poses", "other.json")["inputs"] == images


def test_what_fills_a_folder_does_not_get_that_of_the_panoramas(walk: Path, omnisyn: Omnisyn) -> None:
    for codec, output in (("png", "tour-frames"), ("prores", "tour.mov")):
        assert omnisyn.json("interpolate", "tour", "--codec", codec, "--dry-run")["output"] == output
    assert planned(omnisyn, "view", "tour", "--folder")["output"] == "tour-walk"
    for name, output in (("ply", "tour.ply"), ("splats", "tour.ply"), ("colmap", "tour-colmap")):
        assert planned(omnisyn, "export", "tour", "--format", name)["output"] == output


def test_a_dot_or_a_number_in_names_makes_no_file_and_no_pattern_of_a_folder() -> None:
    tour = NamedTour((), Path(), "a.png-%05d.png")
    assert (str(tour.output(".mp4")), str(tour.output("-frames"))) == ("a.png-%05d.png.mp4", "a_png-_05d_png-frames")
    assert [video_ending(codec) for codec in (None, "h265", "prores", "exr")] == [".mp4", ".mp4", ".mov", "-frames"]


def keep_one(walk: Path) -> None:
    poses = read_poses(walk / POSES_NAME).panoramas
    write_poses(walk / POSES_NAME, dict(list(poses.items())[:1]))


REFUSED = {
    "no pose file": (
        lambda walk: (walk / POSES_NAME).unlink(), "tour: expected a poses.json in the folder, got none"
    ),
    "a panorama is missing": (
        lambda walk: (walk / names(walk)[1]).unlink(), "names, got none called '{name}' (1 missing)"
    ),
    "a single one": (keep_one, "poses.json: expected two or more panoramas, got 1"),
    "beside others": (lambda walk: [walk, walk / names(walk)[0]], "or one folder alone, got a folder among 2 names"),
}  # fmt: skip


@every_command
@pytest.mark.parametrize("case", REFUSED)
def test_a_folder_that_cannot_be_used_is_one_line(walk: Path, omnisyn: Omnisyn, command: str, case: str) -> None:
    spoil, words = REFUSED[case]
    name = names(walk)[1]
    arguments = spoil(walk) or [walk]
    assert words.format(name=name) in omnisyn.refused(*cheap(command, *arguments))


def test_a_folder_without_poses_stands_for_all_its_pictures(tmp_path: Path, omnisyn: Omnisyn) -> None:
    """In the natural order of their names, without masks and depth; one picture is too few."""
    for name in ("p10.jpg", "p9.jpg", "p9_mask.png", "p10_depth.exr", "notes.txt"):
        (tmp_path / name).touch()
    images = named_tour([tmp_path], POSES_FROM_PICTURES).images
    assert [image.name for image in images] == ["p9.jpg", "p10.jpg"]
    images[0].unlink()
    (tmp_path / "p9_mask.png").unlink()
    assert "two or more panoramas in the folder" in omnisyn.refused("view", tmp_path, "--poses", "auto")


@every_command
def test_without_poses_too_a_missing_panorama_is_named(tmp_path: Path, omnisyn: Omnisyn, command: str) -> None:
    (tmp_path / "other").mkdir()
    without = omnisyn.refused(*cheap(command, tmp_path / "other" / "d.png", write_pair(tmp_path)[1]))
    assert f"{tmp_path / 'other' / 'd.png'}: expected a panorama, got no such file" in without


@every_command
@pytest.mark.parametrize("poses", [(), ("--poses", "auto")])
def test_a_single_name_is_a_panorama_too_few_or_wrong(
    tmp_path: Path, omnisyn: Omnisyn, command: str, poses: tuple[str, ...]
) -> None:
    """Before anything is said of poses or frames."""
    (tmp_path / "a.png").touch()
    for name, words in (("a.png", "expected two or more panoramas"), ("tuor", "got no such file")):
        assert f"{tmp_path / name}: " in (told := omnisyn.refused(command, tmp_path / name, *poses))
        assert words in told


@pytest.mark.parametrize("command", [*COMMANDS, "poses check", "poses refine"])
def test_a_panorama_that_does_not_exist_is_no_missing_pose(tmp_path: Path, omnisyn: Omnisyn, command: str) -> None:
    inputs = [write_pair(tmp_path)[0], tmp_path / "c.png", "--poses", tmp_path / POSES_NAME]
    output = ["-o", tmp_path / "new.json"] if command == "poses refine" else []
    expected = f"omnisyn: {tmp_path / 'c.png'}: expected a file, got no such file; check the name\n"
    assert omnisyn.refused(*command.split(), *inputs, *output) == expected


@pytest.mark.parametrize("command", ["interpolate", "view"])
def test_one_panorama_twice_is_made_and_said(
    tmp_path: Path, omnisyn: Omnisyn, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one place there is nothing to walk along, whatever is made of it."""
    monkeypatch.chdir(tmp_path)
    image = write_pair(tmp_path)[0]
    assert "a.png and a.png have the same position" in omnisyn.made(*cheap(command, image, image)).err
    assert Path(f"a-a{COMMANDS[command][0]}").is_file()


def test_a_folder_at_the_top_has_a_name_too(walk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "resolve", lambda path: Path("/"))
    assert named_tour([walk]).name == "tour"
    assert named_tour([walk]).poses == walk / POSES_NAME


@every_command
def test_poses_from_another_folder_are_said_to_be(walk: Path, omnisyn: Omnisyn, command: str) -> None:
    """A picture of the same name in another folder would otherwise take a pose that is not its own, in silence."""
    first, second, _ = names(walk)
    room = walk.parent / "room"
    room.mkdir()
    (walk / second).rename(room / second)
    plan = planned(omnisyn, command, walk / first, room / second)
    assert f"{room / second}: the pose is taken from {walk / POSES_NAME}, which lies in another folder" in plan["notes"]
    (room / second).rename(walk / second)
    assert not any("another folder" in note for note in planned(omnisyn, command, walk / first, walk / second)["notes"])


@every_command
def test_what_is_unusual_about_the_input_is_noted(walk: Path, omnisyn: Omnisyn, command: str) -> None:
    """An animation is its first picture; a thousand kilometres between panoramas are a mistake."""
    first, second, _ = names(walk)
    picture = PIL.Image.open(walk / first)
    picture.save(walk / "moving.gif", save_all=True, append_images=[PIL.Image.open(walk / second)])
    entries = read_poses(walk / POSES_NAME).panoramas
    far = PosedPanorama(Pose(np.eye(3), np.array([1e6, 0, 0])))
    write_poses(walk / POSES_NAME, {first: PosedPanorama(entries[first].pose), "moving.gif": far})
    notes = planned(omnisyn, command, walk / first, walk / "moving.gif", "--depth", "matching")["notes"]
    assert f"{first} and moving.gif are 1,000,000 m apart; are the positions in metres, and in this order?" in notes
    assert "'moving.gif': holds several pictures or is animated; the first picture is taken" in notes
