"""``omnisyn poses check``, ``refine``, ``estimate``, and ``interpolate`` with poses from the pictures."""

import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import Omnisyn, listing
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.io.placement import Reading
from omnisyn_cli.poses.file import PosedPanorama, read_poses, write_poses
from omnisyn_cli.poses.registration.least_squares import direction_error, relative_pose, rotation_error
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

NAMES = ("a.png", "b.png", "c.png")
STREET = Path(__file__).parents[2] / "examples" / "street"


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Three panoramas along a street, tilted and looking different ways, with their poses."""
    folder = tmp_path_factory.mktemp("tour")
    scene = generate_scene("street", 101)
    poses = sample_path(scene, 101, 3, tilt=0.1)
    for name, pose in zip(NAMES, poses, strict=True):
        image, _ = render_panorama(scene, pose, (192, 384), threads=2)
        write_image(folder / name, np.rint(image * 255).astype(np.uint8))
    write_poses(folder / "poses.json", dict(zip(NAMES, map(PosedPanorama, poses), strict=True)))
    write_image(folder / "blank.png", np.full((192, 384, 3), 128, np.uint8))
    before = listing(folder)
    yield folder
    assert listing(folder) == before  # no command writes beside its inputs


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Photographs of the example, smaller."""
    folder = tmp_path_factory.mktemp("street")
    for name in ("first.jpg", "second.jpg"):
        write_image(folder / name, read_panorama(STREET / name, reading=Reading(size=(384, 768))).image)
    return folder / "first.jpg", folder / "second.jpg"


def images(folder: Path, count: int = 2) -> list[Path]:
    return [folder / name for name in NAMES[:count]]


def poses_of(path: Path, count: int = 2) -> list[Pose]:
    return [read_poses(path).of(name).pose for name in NAMES[:count]]


def changed_file(tour: Path, path: Path, change: object) -> Path:
    panoramas = read_poses(tour / "poses.json").panoramas
    write_poses(path, {name: PosedPanorama(change(entry.pose)) for name, entry in panoramas.items()})  # type: ignore[operator]
    return path


def disturbed_file(tour: Path, path: Path) -> Path:
    """Poses of which all but the first are turned by some degrees."""
    turns = iter(map(rotation_from_rotation_vector, np.array([[0, 0, 0], [0.03, 0.03, 0.03], [-0.03, 0.02, 0.04]])))
    return changed_file(tour, path, lambda pose: Pose(next(turns) @ pose.rotation, pose.position))


def test_right_poses_fit_pair_by_pair(tour: Path, omnisyn: Omnisyn) -> None:
    """Those beside the pictures, where nothing else is named."""
    result = omnisyn.quiet("poses", "check", *images(tour, 3), "--threads", 2)
    assert "a.png and b.png: the poses fit\n" in result.out
    assert "b.png and c.png: the poses fit\n" in result.out


def test_the_height_of_the_camera_follows_from_the_distance_given(tmp_path, street, omnisyn: Omnisyn) -> None:
    """The example stands 2.42 m above its street; in kilometres that is too little, and wrong poses say nothing."""
    for name, scale, words in (("metres", 1.0, "2.42 m above the floor\n"), ("kilometres", 1e-3, "is unusual")):
        file = changed_file(
            STREET, tmp_path / f"{name}.json", lambda pose, scale=scale: Pose(pose.rotation, scale * pose.position)
        )
        assert words in omnisyn.made("poses", "check", *street, "--poses", file).out
        (pair,) = json.loads(omnisyn.made("poses", "check", *street, "--poses", file, "--json").out)
        assert pair["camera_height"] == pytest.approx(2.418 * scale, rel=0.01)
    inverted = changed_file(STREET, tmp_path / "inverted.json", lambda pose: pose.inverse())
    (pair,) = json.loads(omnisyn.ended(1, "poses", "check", *street, "--poses", inverted, "--json").out)
    assert pair["camera_height"] is None


@pytest.mark.parametrize(
    ("heights", "words"),
    [(None, "1 of 1 pairs see"), ([], "matched points tell"), ([0.5], "planes that matched points do not confirm")],
)
def test_the_height_of_the_camera_gives_metres_or_none(tmp_path, street, omnisyn, monkeypatch, heights, words) -> None:
    """By the floor; by points where no plane is found, as around a tripod; not by a table."""
    if heights is not None:
        monkeypatch.setattr("omnisyn_cli.poses.estimation.floor_heights", lambda _: heights)
    output = tmp_path / "found.json"
    command = ("poses", "estimate", *street, "--camera-height", 2.418, "-o", output)
    if heights:
        assert words in omnisyn.refused(*command)
        return
    assert words in omnisyn.made(*command).err
    lengths = [
        np.linalg.norm(np.subtract(*(read_poses(file).of(picture.name).pose.position for picture in street)))
        for file in (output, STREET / "poses.json")
    ]
    assert lengths[0] == pytest.approx(lengths[1], rel=0.02)


def test_inverted_poses_are_named_with_figures_and_a_remedy(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    inverted = changed_file(tour, tmp_path / "inverted.json", lambda pose: pose.inverse())
    words = ("poses", "check", *images(tour), "--poses", inverted)
    printed = omnisyn.ended(1, *words).out
    assert "the poses do not fit" in printed
    assert "world-to-camera transforms, given as camera-to-world" in printed
    assert "to do: invert every transform" in printed
    (pair,) = json.loads(omnisyn.ended(1, *words, "--json").out)
    assert (pair["verdict"], pair["mistakes"][0]["name"]) == ("mistake", "world-to-camera")
    relative, wrong = relative_pose(*poses_of(tour / "poses.json")), relative_pose(*poses_of(inverted))
    assert pair["given"]["rotation_off_deg"] == pytest.approx(math.degrees(rotation_error(wrong, relative)), abs=0.5)
    assert pair["given"]["direction_off_deg"] == pytest.approx(math.degrees(direction_error(wrong, relative)), abs=1.0)
    assert pair["mistakes"][0]["corrected"]["residual_deg"] < 0.3 < pair["given"]["residual_deg"]


def test_refining_brings_a_disturbed_tour_back(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    disturbed = disturbed_file(tour, tmp_path / "disturbed.json")
    output = tmp_path / "refined.json"
    arguments = ("poses", "refine", *images(tour, 3), "--poses", disturbed, "-o", output)
    assert "2 of 2 pairs refined" in omnisyn.made(*arguments).err
    truth, refined = poses_of(tour / "poses.json", 3), poses_of(output, 3)
    assert refined[0].almost_equals(truth[0])
    for k in range(2):
        found, right = relative_pose(refined[k], refined[k + 1]), relative_pose(truth[k], truth[k + 1])
        assert math.degrees(rotation_error(found, right)) < 0.3
        assert math.degrees(direction_error(found, right)) < 2.0
        lengths = [np.linalg.norm(poses[k + 1].position - poses[k].position) for poses in (refined, truth)]
        assert lengths[0] == pytest.approx(lengths[1])
    assert "--overwrite" in omnisyn.refused(*arguments)
    omnisyn.quiet(*arguments, "--overwrite", "-q")


def test_what_contradicts_the_pictures_is_left_alone_and_said(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    inverted = changed_file(tour, tmp_path / "inverted.json", lambda pose: pose.inverse())
    output = tmp_path / "out.json"
    result = omnisyn.made("poses", "refine", *images(tour), "--poses", inverted, "-o", output)
    assert "it looks as if the poses are world-to-camera" in result.err
    assert "0 of 1 pairs refined" in result.err
    assert all(a.almost_equals(b) for a, b in zip(poses_of(inverted), poses_of(output), strict=True))


def test_poses_are_estimated_without_any(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    output, truth = tmp_path / "found.json", poses_of(tour / "poses.json", 3)
    lengths = [float(np.linalg.norm(truth[k + 1].position - truth[k].position)) for k in range(2)]
    options = ("--baseline", lengths[0], "--baseline", lengths[1], "-o", output)
    assert "vertical edges say" in omnisyn.made("poses", "estimate", *images(tour, 3), *options).err
    found = poses_of(output, 3)
    np.testing.assert_array_equal(found[0].position, np.zeros(3))
    for k in range(3):
        up = (found[k].rotation @ truth[k].rotation.T)[:, 1]  # the world is level, though the first camera was not
        assert math.degrees(math.acos(min(1.0, up[1]))) < 0.6
        right, relative = truth[0].inverse() @ truth[k], found[0].inverse() @ found[k]
        assert math.degrees(rotation_error(relative, right)) < 0.6
        assert np.linalg.norm(relative.position - right.position) <= 0.05 * sum(lengths[:k])


REFUSED = {
    "too few matches": (("estimate", "a.png", "blank.png", "--baseline", 1), "expected more matches that agree"),
    "one panorama": (("estimate", "a.png", "--baseline", 1), "expected two or more panoramas"),
    "one twice": (("estimate", "a.png", "a.png", "--baseline", 1), "expected every panorama once"),
    "baselines": (("estimate", "a.png", "b.png", "--baseline", 1, "--baseline", 2), "expected one baseline"),
    "no poses": (("refine", "nowhere/a.png", "b.png"), "beside"),
    "no entry": (("refine", "a.png", "blank.png", "--poses", "poses.json"), "expected an entry for 'blank.png'"),
    "over the input": (
        ("refine", "a.png", "b.png", "--poses", "poses.json", "-o", "poses.json", "--overwrite"), "not overwritten",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_done_is_refused_and_nothing_is_written(
    tour: Path, tmp_path: Path, omnisyn: Omnisyn, case: str
) -> None:
    (command, *arguments), words = REFUSED[case]
    paths = [tour / str(a) if str(a).endswith((".png", ".json")) else a for a in arguments]
    assert words in omnisyn.refused("poses", command, "-o", tmp_path / "out.json", *paths)


def test_masks_outside_of_the_folder_are_read_only_if_allowed(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    """And written: the refined file names the same mask, from where that file is."""
    (tmp_path / "poses").mkdir()
    write_image(tmp_path / "mask.png", np.full((192, 384), 255, np.uint8))
    document = json.loads((tour / "poses.json").read_text())
    document["panoramas"]["a.png"]["mask"] = "../mask.png"
    file, output = tmp_path / "poses" / "poses.json", tmp_path / "refined.json"
    file.write_text(json.dumps(document))
    for words in (
        ("check", *images(tour), "--poses", file),
        ("refine", *images(tour), "--poses", file, "-o", output),
        ("export", file, "--format", "tum", "-o", tmp_path / "out.tum", "--size", "384x192"),
    ):
        assert "--allow-outside" in omnisyn.refused("poses", *words)
        omnisyn.made("poses", *words, "--allow-outside")
    assert json.loads(output.read_text())["panoramas"]["a.png"]["mask"] == "mask.png"
    deeper = tmp_path / "a" / "b"
    deeper.mkdir(parents=True)
    omnisyn("poses", "refine", *images(tour), "--poses", file, "-o", deeper / "p.json", "--allow-outside")
    assert json.loads((deeper / "p.json").read_text())["panoramas"]["a.png"]["mask"] == "../../mask.png"
    mask = read_poses(deeper / "p.json", allow_outside=True).of("a.png").mask
    assert mask is not None
    assert mask.samefile(tmp_path / "mask.png")


def test_masks_that_the_new_file_could_not_name_are_refused_before_any_picture_is_read(
    tour: Path, tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    document = json.loads((tour / "poses.json").read_text())
    document["panoramas"]["a.png"]["mask"] = "mask.png"
    (tmp_path / "poses.json").write_text(json.dumps(document))
    write_image(tmp_path / "mask.png", np.full((192, 384), 255, np.uint8))
    arguments = ("poses", "refine", *images(tour), "--poses", tmp_path / "poses.json", "-o")
    with monkeypatch.context() as patched:
        patched.setattr("omnisyn_cli.poses.estimation.read_panorama", lambda *_, **__: pytest.fail("a picture is read"))
        result = omnisyn.refused(*arguments, tmp_path / "elsewhere" / "out.json")
    assert "'a.png'.mask: expected a file in the folder of the pose file" in result
    assert "write the pose file beside it, or allow files elsewhere (--allow-outside)" in result
    omnisyn.made(*arguments, tmp_path / "beside.json")
    omnisyn.made(*arguments, tmp_path / "elsewhere" / "out.json", "--allow-outside")


def test_with_too_few_matches_refine_keeps_what_was_given(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_poses(tmp_path / "p.json", {name: PosedPanorama(Pose.identity()) for name in ("a.png", "blank.png")})
    arguments = (tour / "a.png", tour / "blank.png", "--poses", tmp_path / "p.json")
    result = omnisyn.made("poses", "refine", *arguments, "-o", tmp_path / "out.json")
    assert "too few of 0 matches agree; the poses stay as they are" in result.err
    assert read_poses(tmp_path / "out.json").of("blank.png").pose.almost_equals(Pose.identity())
    assert "too few matches to judge the poses" in omnisyn.made("poses", "check", *arguments).out


def test_interpolating_with_poses_from_the_pictures(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    arguments = ("interpolate", *images(tour), "-o", tmp_path / "out", "--dry-run")
    result = omnisyn.made(*arguments, "--poses", "auto", "--json")
    assert "taken to be 1 m apart" in result.err
    assert json.loads(result.out)["path_metres"] == pytest.approx(1.0)
    assert omnisyn.json(*arguments, "--poses", "auto", "--baseline", 2.5)["path_metres"] == pytest.approx(2.5)
    given = ("--poses", tour / "poses.json", "--baseline", 2.5)
    assert "expected a baseline only where poses are found" in omnisyn.refused(*arguments, *given)
    assert "expected poses to refine" in omnisyn.refused(*arguments, "--poses", "auto", "--refine")


def test_a_folder_is_walked_in_the_order_that_its_pictures_tell(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    folder, names = tmp_path / "folder", ("2.png", "3.png", "1.png")  # of the tour's first, second and third
    folder.mkdir()
    for image, name in zip(images(tour, 3), names, strict=True):
        shutil.copy(image, folder / name)
    words = ("interpolate", folder, "--poses", "auto", "-o", tmp_path / "out", "--codec", "png", "--dry-run")
    assert "order: 1.png, 3.png, 2.png" in omnisyn.made(*words).err


def test_interpolating_with_refined_poses(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    disturbed = disturbed_file(tour, tmp_path / "disturbed.json")
    arguments = ("interpolate", *images(tour), "-o", tmp_path / "out", "--dry-run", "--poses", disturbed, "--refine")
    assert "a.png and b.png: rotation corrected by " in omnisyn.made(*arguments).err
