"""A pose file says where cameras are, or says what is wrong with it."""

import json
import math
import unicodedata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from omnisyn_cli.errors import OmnisynError, OutputPathError, PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_from_quaternion
from omnisyn_cli.interpolation.inputs import named_tour
from omnisyn_cli.poses.file import PosedPanorama, PoseUncertainty, distinct_names, read_poses, write_poses

RIGID = {"position": [0, 0, 0], "rotation": [1, 0, 0, 0]}
PLACE = {"latitude": 48.1, "longitude": 11.5, "altitude": 520.0, "heading": 93.0}
EYE, WHOLE = np.eye(3).tolist(), np.eye(4).tolist()
numbers = st.floats(-1e6, 1e6)


def wrote(folder: Path, document: Any) -> Path:
    path = folder / "poses.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
    return path


def one(entry: Any) -> dict[str, Any]:
    return {"version": 1, "panoramas": {"a.jpg": entry}}


def pose_from_entry(folder: Path, entry: Any) -> Pose:
    return read_poses(wrote(folder, one(entry))).of("a.jpg").pose


def test_the_example_of_the_convention_is_understood(tmp_path):
    second = {"position": [0.1, 0, -5.0], "rotation": [1, 0, 0, 0], "depth": "sub/b depth.exr", "mask": "b.png"}
    poses = read_poses(wrote(tmp_path, {"version": 1, "panoramas": {"b.jpg": second, "a.jpg": RIGID}}))
    assert list(poses.panoramas) == ["b.jpg", "a.jpg"]
    panorama = poses.of(Path("/elsewhere/b.jpg"))
    np.testing.assert_array_equal(panorama.pose.position, [0.1, 0, -5])
    np.testing.assert_array_equal(panorama.pose.rotation, np.eye(3))
    assert panorama.depth == tmp_path / "sub" / "b depth.exr"
    assert panorama.mask == tmp_path / "b.png"
    assert poses.of("a.jpg").depth is None


def test_images_of_one_name_have_entries_by_their_folders(tmp_path):
    entries = {name: {**RIGID, "position": [k, 0, 0]} for k, name in enumerate(("a.jpg", "d1/a.jpg", "x/d2/a.jpg"))}
    poses = read_poses(wrote(tmp_path, {"version": 1, "panoramas": entries}))
    places = {"a.jpg": 0, "d0/a.jpg": 0, "d1/a.jpg": 1, "/any/d1/a.jpg": 1, "d2/a.jpg": 0, "x/d2/a.jpg": 2}
    assert {name: poses.of(name).pose.position[0] for name in places} == places
    assert distinct_names([tmp_path / "d1" / "a.jpg", tmp_path / "d2" / "a.jpg"]) == ["d1/a.jpg", "d2/a.jpg"]
    assert distinct_names([tmp_path / "d1" / "a.jpg", tmp_path / "d2" / "b.jpg"]) == ["a.jpg", "b.jpg"]


@pytest.mark.parametrize(("on_disk", "in_file"), [("NFD", "NFC"), ("NFC", "NFD")])
def test_a_name_is_the_same_in_both_unicode_forms(tmp_path, on_disk, in_file):
    """macOS splits accents from their letters, other systems do not."""
    images = [tmp_path / unicodedata.normalize(on_disk, name) for name in ("Büro.jpg", "Café.jpg")]
    for image in images:
        image.write_bytes(b"")
    entries = {unicodedata.normalize(in_file, image.name): RIGID for image in images}
    poses = read_poses(wrote(tmp_path, {"version": 1, "panoramas": entries}))
    assert [unicodedata.normalize("NFC", poses.name_of(image)) for image in images] == ["Büro.jpg", "Café.jpg"]
    assert named_tour([tmp_path]).images == tuple(images)


@settings(max_examples=25)
@given(st.lists(numbers, min_size=3, max_size=3), st.lists(st.floats(-1, 1), min_size=4, max_size=4))
def test_writing_and_reading_is_exact_in_position_and_a_rounding_in_rotation(tmp_path_factory, position, quaternion):
    if np.linalg.norm(quaternion) < 1e-3:
        quaternion = [1.0, 0.0, 0.0, 0.0]
    folder = tmp_path_factory.mktemp("poses")
    pose = Pose(rotation_from_quaternion(np.array(quaternion)), np.array(position))
    write_poses(folder / "p.json", {"ünï '1'.jpg": PosedPanorama(pose, folder / "d" / "x.exr")})
    panorama = read_poses(folder / "p.json").of("ünï '1'.jpg")
    np.testing.assert_array_equal(panorama.pose.position, position)
    np.testing.assert_allclose(panorama.pose.rotation, pose.rotation, atol=1e-12)
    assert panorama.depth == folder / "d" / "x.exr"


def test_uncertainties_are_kept_with_two_digits(tmp_path):
    known = [None, PoseUncertainty(np.radians(0.0123456), 0.0345678), PoseUncertainty(np.radians(1.0), None)]
    entries = {f"{k}.jpg": PosedPanorama(Pose.identity(), uncertainty=spread) for k, spread in enumerate(known)}
    write_poses(tmp_path / "p.json", entries)
    _, second, third = [panorama.uncertainty for panorama in read_poses(tmp_path / "p.json").panoramas.values()]
    assert (second.rotation, second.position) == pytest.approx((np.radians(0.012), 0.035))
    assert (third.rotation, third.position) == (pytest.approx(np.radians(1.0)), None)


def test_quaternion_3x3_and_4x4_say_the_same(tmp_path):
    rotation = rotation_from_quaternion(np.array([0.5, 0.5, -0.5, 0.5]))
    position = [1.0, 2.0, 3.0]
    full = np.block([[rotation, np.array(position)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    entries = [
        {"position": position, "rotation": [0.5, 0.5, -0.5, 0.5]},
        {"position": position, "matrix": rotation.tolist()},
        {"matrix": full.tolist()},
        {"matrix": full.tolist(), "position": position},
    ]
    expected = Pose(rotation, np.array(position))
    assert all(pose_from_entry(tmp_path, entry).almost_equals(expected) for entry in entries)


def test_nearly_unit_quaternions_are_normalised(tmp_path):
    rotation = pose_from_entry(tmp_path, {"position": [0, 0, 0], "rotation": [0.7071, 0.7071, 0, 0]}).rotation
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)


def test_the_first_geographic_place_is_the_origin_and_north_is_minus_z(tmp_path):
    metre = 1 / 111_200
    north = {**PLACE, "latitude": 48.1 + 10 * metre, "altitude": 521.0, "heading": 0}
    poses = read_poses(wrote(tmp_path, {"version": 1, "panoramas": {"a.jpg": PLACE, "b.jpg": north}}))
    np.testing.assert_allclose(poses.of("a.jpg").pose.position, 0, atol=1e-9)
    np.testing.assert_allclose(poses.of("b.jpg").pose.position, [0, 1, -10], atol=0.02)
    east = poses.of("a.jpg").pose.rotation @ [0, 0, -1]
    np.testing.assert_allclose(east, [math.cos(math.radians(3)), 0, math.sin(math.radians(3))], atol=1e-9)
    np.testing.assert_allclose(poses.of("b.jpg").pose.rotation, np.eye(3), atol=1e-12)


def without(entry: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in entry.items() if name != key}


BROKEN: dict[str, tuple[Any, str]] = {
    "no object": ([], r"top level: expected an object in braces, got \[\]"),
    "no JSON": ("{", "expected JSON"),
    "deep": ("[" * 200_000, "expected JSON"),
    "no version": ({"panoramas": {"a.jpg": RIGID}}, "expected the key 'version'"),
    "other version": ({"version": 2, "panoramas": {"a.jpg": RIGID}}, "version: expected 1.*, got 2"),
    "version true": ({"version": True, "panoramas": {"a.jpg": RIGID}}, "version: expected 1.*, got True"),
    "nothing": ({"version": 1, "panoramas": {}}, "at least 1 item"),
    "unknown key": ({"version": 1, "panoramas": {"a.jpg": RIGID}, "units": "m"}, "got 'units'"),
    "typo": (one({**RIGID, "positon": [0, 0, 0]}), r"panoramas\.'a\.jpg'\.positon: .*did you mean 'position'"),
    "mixed in an entry": (one({**RIGID, **PLACE}), "got position, rotation mixed with altitude"),
    "mixed entries": ({"version": 1, "panoramas": {"a.jpg": RIGID, "b.jpg": PLACE}}, "'b.jpg' .* mixed with 'a.jpg'"),
    "two rotations": (one({**RIGID, "matrix": EYE}), "either rotation or matrix, got both"),
    "no rotation": (one({"position": [0, 0, 0]}), "either rotation or matrix, got neither"),
    "no position": (one({"rotation": [1, 0, 0, 0]}), "expected the key 'position'"),
    "no heading": (one(without(PLACE, "heading")), "expected the key 'heading'"),
    "empty entry": (one({}), "got neither"),
    "entry is a list": (one([0, 0, 0]), r"panoramas\.'a\.jpg': expected an object in braces, got \[0, 0, 0\]"),
    "two numbers": (one({**RIGID, "position": [0, 0]}), r"position: expected at least 3 items, got \[0, 0\];"),
    "text for a number": (one({**RIGID, "position": [0, "1", 0]}), r"position\[1\]: expected .*number, got '1'"),
    "truth for a number": (one({**RIGID, "position": [0, True, 0]}), r"position\[1\]: expected .*number, got True"),
    "NaN": (json.dumps(one({**RIGID, "position": [0, math.nan, 0]})), "expected finite numbers, got NaN"),
    "infinity": (json.dumps(one({**RIGID, "position": [0, -math.inf, 0]})), "got -Infinity"),
    "overflow": (json.dumps(one({**RIGID, "position": [0, 7, 0]})).replace("7", "1e999"), r"position\[1\]: .*inf"),
    "wrong unit": (one({**RIGID, "position": [0, 1e12, 0]}), r"position\[1\]: expected .*less than"),
    "long quaternion": (one({**RIGID, "rotation": [1, 0.1, 0, 0]}), "unit quaternion.*length 1.00499"),
    "giant quaternion": (one({**RIGID, "rotation": [1e200, 0, 0, 0]}), r"unit quaternion.*length 1e\+200"),
    "angles": (one({**RIGID, "rotation": [0, 90, 0]}), r"a unit quaternion \[w, x, y, z\], got \[0, 90, 0\]; correct"),
    "zero quaternion": (one({**RIGID, "rotation": [0, 0, 0, 0]}), "length 0"),
    "scaled": (one({"position": [0, 0, 0], "matrix": [[2, 0, 0], [0, 2, 0], [0, 0, 2]]}), "rigid .*deviation of 3"),
    "mirrored": (one({"position": [0, 0, 0], "matrix": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}), "mirror image"),
    "ragged": (one({"position": [0, 0, 0], "matrix": [[1, 0], [0, 1, 0], [0, 0, 1]]}), "3×3 or 4×4"),
    "transposed": (one({"matrix": [*WHOLE[:3], [1, 2, 3, 1]]}), r"last row \[0, 0, 0, 1\]"),
    "disagreeing": (one({"position": [9, 0, 0], "matrix": WHOLE}), "position to agree"),
    "latitude": (one({**PLACE, "latitude": 91}), "latitude: expected .*less than or equal to 90, got 91"),
    "depth above": (one({**RIGID, "depth": "../secret.exr"}), "leading out of the folder"),
    "depth absolute": (one({**RIGID, "depth": "/etc/passwd"}), "absolute"),
    "depth on a drive": (one({**RIGID, "mask": "C:x.png"}), "absolute"),
    "depth with backslashes": (one({**RIGID, "mask": "..\\x.png"}), "backslash"),
    "depth empty": (one({**RIGID, "depth": ""}), "empty"),
    "name empty": ({"version": 1, "panoramas": {"": RIGID}}, "file name of an image, got ''"),
    "name outside": ({"version": 1, "panoramas": {"../a.jpg": RIGID}}, "leading out of the folder"),
    "name above": ({"version": 1, "panoramas": {"..": RIGID}}, "file name of an image"),
    "name twice": ('{"version": 1, "panoramas": {"a.jpg": {}, "a.jpg": {}}}', "'a.jpg' twice"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_every_broken_file_gets_one_line_that_says_what_is_wrong(tmp_path, case):
    document, words = BROKEN[case]
    with pytest.raises(PoseError, match=words) as caught:
        read_poses(wrote(tmp_path, document))
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(tmp_path / "poses.json"))
    assert "expected" in message


def test_unreadable_files_are_pose_errors(tmp_path):
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00{")
    with (tmp_path / "huge.json").open("wb") as huge:
        huge.truncate((64 << 20) + 1)
    words = {"binary.json": "UTF-8", "huge.json": "at most", "none.json": "No such file", ".": "folder|directory"}
    for name, expected in words.items():
        with pytest.raises(PoseError, match=expected):
            read_poses(tmp_path / name)


def test_a_byte_order_mark_does_no_harm(tmp_path):
    path = wrote(tmp_path, one(RIGID))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert list(read_poses(path).panoramas) == ["a.jpg"]


LEAVES = st.none() | st.booleans() | st.floats() | st.text()


@given(st.recursive(LEAVES, lambda x: st.lists(x) | st.dictionaries(st.text(), x)))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_entry_is_a_pose_or_a_pose_error(tmp_path_factory, entry):
    path = wrote(tmp_path_factory.mktemp("any"), one(entry))
    with pytest.raises(PoseError):
        read_poses(path)


def test_an_unknown_image_is_answered_with_the_names_there_are(tmp_path):
    poses = read_poses(wrote(tmp_path, {"version": 1, "panoramas": {"left.jpg": RIGID, "right.jpg": RIGID}}))
    with pytest.raises(PoseError, match=r"'rigth.jpg', got 'left.jpg', 'right.jpg'; did you mean 'right.jpg'\?"):
        poses.of("rigth.jpg")


def test_nothing_is_written_that_could_not_be_read(tmp_path):
    good, mirrored = Pose.identity(), Pose(-np.eye(3), np.zeros(3))
    bad: list[tuple[str, PosedPanorama]] = [
        ("a.jpg", PosedPanorama(mirrored)),
        ("a.jpg", PosedPanorama(Pose(np.eye(3), np.array([0, np.nan, 0])))),
        ("../a.jpg", PosedPanorama(good)),
        ("a.jpg", PosedPanorama(good, depth=tmp_path.parent / "d.exr")),
    ]
    for name, panorama in bad:
        with pytest.raises(OmnisynError):
            write_poses(tmp_path / "p.json", {name: panorama})
    with pytest.raises(OutputPathError):
        write_poses(tmp_path / "none" / "p.json", {"a.jpg": PosedPanorama(good)})
    assert not list(tmp_path.iterdir())
