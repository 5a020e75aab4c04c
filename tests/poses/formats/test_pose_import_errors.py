"""Sources that cannot be used say where and why in one line; what was assumed is said too."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from foreign_samples import axis_angle, imported, refuse, row, write_images, write_json, write_text

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.poses.formats import import_poses
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportedView, ImportOptions
from omnisyn_cli.poses.formats.writers import write_imported

IMAGE = "1 1 0 0 0 0 0 0 1 a.png"
SHOT = {"camera": "c", "rotation": [0, 0, 0], "translation": [0, 0, 0]}
SPHERICAL = {"c": {"projection_type": "spherical"}}
EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
TWICE = [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]
TEXTS = {
    "colmap fields": ("images.txt", "1 1 0 0 0 0 0 0 1\n\n", r"images\.txt:1: expected IMAGE_ID QW .*, got 9 fields"),
    "colmap number": ("images.txt", "#\n1 1 0 0 0 x 0 0 1 a\n\n", r"images\.txt:2: expected numbers .*'x'"),
    "colmap quaternion": ("images.txt", "1 2 0 0 0 0 0 0 1 a\n\n", r"images\.txt:1: .*unit quaternion, got length 2"),
    "colmap no points line": ("images.txt", f"{IMAGE}\n{IMAGE}\n", r"images\.txt:2: expected 2-D points in threes"),
    "colmap outside": ("images.txt", f"{IMAGE[:-5]}../a.png\n\n", r"images\.txt:1: .*inside the source's folder"),
    "tum fields": ("a.tum", "0 0 0 0 0 0 0 1\n1 0 0\n", r"a\.tum:2: expected 8 numbers .*, got 3 fields"),
    "tum twice": ("a.tum", "0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", r"a\.tum:2: expected every time stamp once"),
    "tum nan": ("a.tum", "0 nan 0 0 0 0 0 1\n", r"a\.tum:1: expected finite numbers"),
    "kitti": ("a.txt", "1 0 0 0 0 1 0 0 0 0 -1 0\n", r"a\.txt:1: .*determinant \+1\), got a mirror image"),
    "kitti scale": ("a.txt", "2 0 0 0 0 2 0 0 0 0 2 0\n", r"a\.txt:1: .*got a deviation of 3"),
    "csv number": ("a.csv", "image,lat,lng,heading\na,1,2,3\nb,1,x,3\n", r"a\.csv:3: expected numbers \(longitude\)"),
    "csv range": ("a.csv", "image,lat,lng,heading\na,91,2,3\n", r"a\.csv:2: expected latitude within ±90, got 91"),
    "csv column": ("a.csv", "image,lat,lng\na,1,2\n", r"a\.csv:1: expected heading \(heading or yaw"),
    "csv twice": ("a.csv", "image,lat,lng,heading\na,1,2,3\na,1,2,3\n", r"a\.csv:3: .*got 'a' twice"),
    "csv short": ("a.csv", "image,lat,lng,heading\na,1,2\n", r"a\.csv:2: expected numbers \(heading\)"),
    "csv empty": ("a.csv", "image,lat,lng,heading\n", r"a\.csv: expected at least one panorama"),
    "json broken": ("a.json", '{"frames": [', r"a\.json: expected JSON, got '.*line 1 column 13"),
    "json nan": ("a.json", '{"frames": NaN}', r"a\.json: expected finite numbers, got NaN"),
    "ours": ("p.json", '{"version": 1, "panoramas": {}}', r"p\.json: expected poses of another program"),
    "unknown": ("a.txt", "1 2 3\n", r"a\.txt: .*got a first line of 3 fields; name the format with --format"),
    "not text": ("a.txt", "\udcff", r"a\.txt: expected a readable file in UTF-8"),
}


@pytest.mark.parametrize("case", TEXTS)
def test_malformed_text(tmp_path, case):
    name, text, message = TEXTS[case]
    (tmp_path / name).write_bytes(text.encode("utf-8", errors="surrogateescape"))
    refuse(message, tmp_path / name)


DOCUMENTS: dict[str, tuple[Any, str]] = {
    "frames empty": ({"frames": []}, r"frames: expected .*at least 1 item"),
    "frames keys": ({"frames": [{"file_path": "a"}]}, r"frames\[0\]\.transform_matrix: expected the key"),
    "frames shape": ({"frames": [{"file_path": "a", "transform_matrix": [[1]]}]}, r"frames\[0\]\.transform_matrix"),
    "frames scale": ({"frames": [{"file_path": "a", "transform_matrix": TWICE}]}, "deviation of 3"),
    "frames transposed": (
        {"frames": [{"file_path": "a", "transform_matrix": [*EYE, [1, 2, 3, 1]]}]}, r"last row \[0, 0, 0, 1\]",
    ),
    "frames perspective": (
        {"camera_model": "OPENCV", "frames": [{"file_path": "a", "transform_matrix": EYE}]}, r"EQUIRECTANGULAR, got 1",
    ),
    "applied mirror": (
        {"frames": [{"file_path": "a", "transform_matrix": EYE}], "applied_transform": np.diag([1, 1, -1, 1]).tolist()},
        r"applied_transform: expected a scaled rotation, got determinant -1",
    ),
    "shots camera": ([{"cameras": {}, "shots": {"a": SHOT}}], r"shots\.'a'\.camera: .*got 'c'"),
    "shots vector": ([{"cameras": SPHERICAL, "shots": {"a": {**SHOT, "rotation": [0]}}}], r"shots\.a\.rotation"),
    "shots kind": (
        [{"cameras": {"c": {"projection_type": "brown"}}, "shots": {"a": SHOT}}], r"spherical camera, got none",
    ),
    "floors": ({"merger": {"floor_01": {}, "floor_02": {}}}, r"one floor, got 'floor_01', 'floor_02'; .*--floor"),
    "tour": ({"merger": {"floor_01": {"r": {"p": {"q": {}}}}}}, r"merger\.floor_01\.r\.p\.q.*image_path"),
    "table": ([1], "JSON with int"),
    "table keys": ([{"lat": 1}], r"panorama 1: expected image \(image or file"),
}  # fmt: skip


@pytest.mark.parametrize("case", DOCUMENTS)
def test_malformed_json(tmp_path, case):
    document, message = DOCUMENTS[case]
    refuse(message, write_json(tmp_path / "a.json", document))


@pytest.mark.parametrize("broken", ["pickle", "shape", "missing", "nan", "text"])
def test_arrays_of_the_authors(tmp_path, broken):
    np.save(tmp_path / "rotations.npy", np.broadcast_to(np.eye(3), (2, 3, 3)))
    values = {"pickle": np.array([None, {}]), "shape": np.zeros((3, 3)), "nan": np.full((2, 3), np.nan)}
    if broken in values:
        np.save(tmp_path / "translations.npy", values[broken], allow_pickle=True)
    elif broken == "text":
        write_text(tmp_path / "translations.npy", "no array")
    refuse("expected", tmp_path)


def test_images_have_to_be_countable(tmp_path):
    trajectory = write_text(tmp_path / "a.tum", "0 0 0 0 0 0 0 1", "1 0 0 0 0 0 0 1")
    write_images(tmp_path, ["a.png"])
    refuse(r"as many panoramas as poses \(2\), got 1 .*--images", trajectory)


def test_time_stamps_name_images(tmp_path):
    """Names in the order of the trajectory; poses between the images are left out."""
    trajectory = write_text(tmp_path / "a.tum", *(f"{100 + 0.1 * at:.1f} {at} 0 0 0 0 0 1" for at in range(10)))
    write_images(tmp_path / "rgb", ["100.21.png", "100.69.png"])
    result = imported(trajectory, expected="tum")
    assert [(view.name, view.pose.position[0]) for view in result.views] == [("100.21.png", 2), ("100.69.png", 7)]
    assert any("8 poses without a panorama" in note for note in result.notes)
    write_text(tmp_path / "rgb.txt", "# listed", "100.3 rgb/b.png", "100.0 rgb/a.png")
    result = imported(trajectory, expected="tum")
    assert [(view.name, view.pose.position[0]) for view in result.views] == [("rgb/a.png", 0), ("rgb/b.png", 3)]


def test_time_stamps_that_are_too_far_apart_name_nothing(tmp_path):
    trajectory = write_text(tmp_path / "a.tum", *(f"{100 + 0.1 * at:.1f} {at} 0 0 0 0 0 1" for at in range(10)))
    write_images(tmp_path / "rgb", ["100.24.png", "100.69.png"])
    refuse(r"as many panoramas as poses \(10\), got 2", trajectory)
    result = imported(trajectory, expected="tum", time_tolerance=0.045)
    assert [view.pose.position[0] for view in result.views] == [2, 7]


def test_numbers_come_in_natural_order(tmp_path):
    write_images(tmp_path, ["frame10.png", "frame9.png", "frame9b.png"])
    lines = [row(np.c_[np.eye(3), [index, 0, 0]]) for index in range(3)]
    result = imported(write_text(tmp_path / "a.txt", *lines), expected="kitti")
    assert [view.name for view in result.views] == ["frame9.png", "frame9b.png", "frame10.png"]


def test_formats_at_once_are_ambiguous(tmp_path):
    write_json(tmp_path / "transforms.json", {})
    write_text(tmp_path / "images.txt", IMAGE, "")
    refuse("one program, got colmap, nerfstudio; choose with --format", tmp_path)
    assert import_poses([tmp_path], "colmap", ImportOptions())[0] == "colmap"


def test_broken_binary_models_and_empty_folders_are_explained(tmp_path):
    refuse("a format that is known", tmp_path)
    write_text(tmp_path / "images.bin", "")
    refuse(r"images\.bin: expected more bytes", tmp_path)
    refuse("got none; check the name", tmp_path / "nosuch")


def test_images_without_place_or_heading(tmp_path):
    write_images(tmp_path, ["a.jpg"])
    refuse("expected images with EXIF GPS, got none in 1 images", tmp_path)
    place = {f"GPS:{name}": ("float[3]", (1.0, 2.0, 3.0)) for name in ("Latitude", "Longitude")}
    write_images(tmp_path, ["a.jpg"], **place, **{"GPS:LatitudeRef": "N", "GPS:LongitudeRef": "E"})
    refuse("expected a compass heading", tmp_path)


@pytest.mark.parametrize(
    ("option", "values"), [("--origin", {"origin": (1.0, 2.0, 3.0)}), ("--floor", {"floor": "floor_01"})]
)
def test_options_that_do_not_fit_are_refused(tmp_path, option, values):
    write_text(tmp_path / "images.txt", IMAGE, "")
    refuse(f"expected no {option} with format colmap", tmp_path, **values)


def test_axes_can_be_overruled(tmp_path):
    """A body with x forward, y left, z up in a world with z up: at rest it looks east, that is along our x."""
    write_images(tmp_path, ["a.png"])
    trajectory = write_text(tmp_path / "a.tum", "0 1 2 3 0 0 0 1")
    result = imported(trajectory, expected="tum", camera="flu", up="z")
    pose = result.views[0].pose
    np.testing.assert_allclose(pose.position, [1, 3, -2])
    np.testing.assert_allclose(pose.rotation @ [0, 0, -1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(pose.rotation @ [0, 1, 0], [0, 1, 0], atol=1e-15)
    assert not any(note.startswith(("world:", "cameras:")) for note in result.notes)


def test_up_of_the_cameras_levels_the_world(tmp_path):
    """A world that was tilted as a whole comes back level, and nothing moves against anything else."""
    tilt = axis_angle((0.4, 0.2, -0.3))[0]
    lines = []
    for index, heading in enumerate((0.1, 1.7, -2.0)):
        inverse = (tilt @ axis_angle((0, heading, 0))[0]).T
        place = tilt @ [index, 0.5 * index, 0]
        quaternion = axis_angle(_rotation_vector(inverse))[1]
        lines += [f"{index} {row(quaternion, -inverse @ place)} 1 {index}.png", ""]
    write_text(tmp_path / "images.txt", *lines)
    result = imported(tmp_path, expected="colmap", up="cameras")
    poses = [view.pose for view in result.views]
    for index, pose in enumerate(poses):
        np.testing.assert_allclose(pose.rotation[:, 1], [0, 1, 0], atol=1e-12)
        assert pose.position[1] == pytest.approx(-0.5 * index)
        assert np.linalg.norm(pose.position) == pytest.approx(index * np.sqrt(1.25))


def _rotation_vector(matrix: np.ndarray) -> np.ndarray:
    angle = np.arccos((np.trace(matrix) - 1) / 2)
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return axis / (2 * np.sin(angle)) * angle


def test_copies_of_equal_names_are_whole_or_not_there(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    images = write_images(tmp_path, ["0/rgb.png", "1/rgb.png"])
    depths = write_images(tmp_path, ["0/depth.png"])
    views = tuple(
        ImportedView(f"{index}/rgb.png", Pose(np.eye(3), np.full(3, float(index))), image, depth)
        for index, (image, depth) in enumerate(zip(images, [depths[0], None], strict=True))
    )
    with pytest.raises(PoseError, match=r"different names, got '0/rgb\.png' and '0/rgb\.png'"):
        write_imported(out / "poses.json", ImportedPoses((*views, replace(views[0], depth=None)), ()))
    lost = ImportedView("2/rgb.png", Pose.identity())
    with pytest.raises(PoseError, match=r"got no '2/rgb\.png'"):
        write_imported(out / "poses.json", ImportedPoses((*views, lost), ()), copy_images=True)
    assert not list(out.iterdir())
    write_imported(out / "poses.json", ImportedPoses(views, ()), copy_images=True)
    assert {path.name for path in out.iterdir()} == {"poses.json", "0_rgb.png", "1_rgb.png", "0_rgb_depth.png"}
    poses = read_poses(out / "poses.json")
    assert poses.of("0_rgb.png").depth == out / "0_rgb_depth.png"
    np.testing.assert_array_equal(poses.of("1_rgb.png").pose.position, [1, 1, 1])
    assert (out / "1_rgb.png").read_bytes() == images[1].read_bytes()


def test_depth_is_referred_to_within_the_folder_of_the_pose_file(tmp_path):
    image, depth = write_images(tmp_path / "scene", ["0/rgb.png", "0/depth.png"])
    imported_poses = ImportedPoses((ImportedView("0/rgb.png", Pose.identity(), image, depth),), ())
    write_imported(tmp_path / "scene" / "poses.json", imported_poses)
    entries = json.loads((tmp_path / "scene" / "poses.json").read_text(encoding="utf-8"))["panoramas"]
    assert entries["rgb.png"]["depth"] == "0/depth.png"
    (tmp_path / "elsewhere").mkdir()
    notes = write_imported(tmp_path / "elsewhere" / "poses.json", imported_poses)
    assert read_poses(tmp_path / "elsewhere" / "poses.json").of("rgb.png").depth is None
    assert any("depth: left out" in note for note in notes)
    assert any("not in the folder" in note for note in notes)
