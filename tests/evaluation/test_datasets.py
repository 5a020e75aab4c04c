"""Every layout brings back the poses and depth that were written, so that one view warps into the next."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.layouts import read_face_depth
from omnisyn_cli.evaluation.datasets.sources import NoScaleError, Scene, choose_pairs
from omnisyn_cli.evaluation.views import load_pair
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import direction_to_angles, pixel_directions
from omnisyn_cli.io import read_panorama, write_depth, write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from synthesis_samples import as_bytes

SIZE = (64, 128)
HEADINGS = (0.0, 0.5, 2.0)
METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True)
class Shot:
    """One panorama of the room: what it shows, how far that is, and where it was taken."""

    image: np.ndarray
    depth: np.ndarray
    pose: Pose


@lru_cache
def shots(pitch: float = 0.0) -> tuple[Shot, ...]:
    """Three panoramas along 0.8 m, facing different ways."""
    scene = generate_scene("room", 3)
    made = []
    for heading, place in zip(HEADINGS, sample_path(scene, 3, len(HEADINGS), baseline=0.8, vertical=0.0), strict=True):
        pose = Pose(rotation_from_heading(heading, pitch * heading, -pitch * heading), place.position)
        made.append(Shot(*render_panorama(scene, pose, SIZE, supersample=2, threads=1), pose))
    return tuple(made)


def write_millimetres(path: Path, depth: np.ndarray) -> None:
    cv2.imwrite(str(path), np.rint(np.minimum(np.where(np.isinf(depth), 0, depth) * 1000, 65535)).astype(np.uint16))


def write_own(folder: Path, taken: Sequence[Shot]) -> None:
    folder.mkdir()
    entries = {}
    for index, shot in enumerate(taken):
        write_image(folder / f"{index}.png", as_bytes(shot.image))
        write_depth(folder / f"{index}.exr", shot.depth)
        entries[f"{index}.png"] = PosedPanorama(shot.pose, folder / f"{index}.exr")
    write_poses(folder / "poses.json", entries)


def write_habitat(folder: Path, taken: Sequence[Shot]) -> None:
    for index, shot in enumerate(taken):
        view = folder / f"{index:02d}"
        view.mkdir(parents=True)
        write_image(view / "rgb.png", as_bytes(shot.image))
        write_millimetres(view / "depth.png", shot.depth)
        np.savetxt(view / "rot.txt", shot.pose.rotation)
        np.savetxt(view / "tran.txt", shot.pose.position)


def write_carla(
    run: Path, taken: Sequence[Shot], angles: Sequence[tuple[float, float, float]], unit: float = 1
) -> None:
    """``angles`` are yaw, pitch and roll in radians; ``unit`` is the length of one unit of location in metres."""
    for name in ("rgb", "depth"):
        (run / name).mkdir(parents=True)
    entries = []
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    face_axis = (pixel_directions(*SIZE) @ axes.T).max(axis=-1)
    for index, (shot, (yaw, pitch, roll)) in enumerate(zip(taken, angles, strict=True)):
        x, y, z = shot.pose.position
        frame = 100 + 7 * index
        entries.append(
            {
                "frame": frame,
                "location": {"x": -z / unit, "y": x / unit, "z": y / unit},
                "rotation": {"yaw": math.degrees(yaw), "pitch": math.degrees(pitch), "roll": math.degrees(roll)},
                "latitude": -z / METRES_PER_DEGREE, "longitude": x / METRES_PER_DEGREE, "altitude": y,
            }
        )  # fmt: skip
        write_image(run / "rgb" / f"{frame}.png", as_bytes(shot.image))
        write_millimetres(run / "depth" / f"{frame}.png", shot.depth * face_axis)
    entries.append({**entries[0], "frame": 999})  # its pictures were not kept
    (run / "gnss_data.json").write_text(json.dumps(entries))


def write_zind(tour: Path, taken: Sequence[Shot], scale: float | None = 2.5, room_scale: float = 0.4) -> None:
    """All in one room with two parts; coordinates of the floor are (−x, −z) metres over ``scale``."""
    (tour / "panos").mkdir(parents=True)
    parts: dict[str, dict[str, object]] = {"partial_room_00": {}, "partial_room_01": {}}
    for index, (shot, heading) in enumerate(zip(taken, HEADINGS, strict=True)):
        image = f"panos/floor_01_partial_room_00_pano_{index}.jpg"
        write_image(tour / image, as_bytes(shot.image))
        x, y, z = shot.pose.position / (scale or 1.0)
        parts[f"partial_room_{index % 2:02d}"][f"pano_{index + 9}"] = {
            "image_path": image, "camera_height": y / room_scale, "label": "room", "is_primary": True,
            "floor_plan_transformation": {
                "translation": [-x, -z], "rotation": math.degrees(heading), "scale": room_scale
            },
        }  # fmt: skip
    closet = {"partial_room_02": {"pano_1": next(iter(parts["partial_room_00"].values()))}}
    tour_data = {
        "scale_meters_per_coordinate": {"floor_01": scale},
        "merger": {"floor_01": {"complete_room_01": parts, "complete_room_02": closet}},
        "redraw": {},
    }
    (tour / "zind_data.json").write_text(json.dumps(tour_data))


def warping_error(
    first: np.ndarray, inverse_depth: np.ndarray, second: np.ndarray, truth: np.ndarray, pose: Pose
) -> float:
    """Mean absolute difference of the first view and the second one, read where the first one's points are in it."""
    points = pixel_directions(*inverse_depth.shape) / np.maximum(inverse_depth, 1e-6)[..., None]
    seen = pose.transform(points)
    distance = np.linalg.norm(seen, axis=-1)
    visible = np.abs(sample_nearest(truth, seen) / distance - 1) < 0.03
    assert visible.mean() > 0.5
    return float(np.abs(sample_bilinear(second, seen) - first)[visible].mean())


TURNS = [(heading, 0.1 * heading, -0.1 * heading) for heading in HEADINGS]


def check(scene: Scene, taken: tuple[Shot, ...], *, millimetres: bool = True) -> None:
    """Poses, pictures and depth are those of the shots, and views warp into each other with them."""
    assert len(scene.frames) == len(taken)
    for frame, shot in zip(scene.frames, taken, strict=True):
        assert frame.pose.almost_equals(shot.pose, metres=1e-6, radians=1e-6)
        inverse_depth = 1 / shot.depth
        if frame.depth is not None:
            inverse_depth = frame.read_depth(frame.depth)
            tolerance = 1.01e-3 if millimetres else 1e-6
            near = shot.depth < 40.0  # through the window there is more than 16 bits of millimetres
            assert inverse_depth[~near].max(initial=0.0) < 1 / 39.0
            np.testing.assert_allclose(1 / inverse_depth[near], shot.depth[near], atol=tolerance)
    first, second = scene.frames[0], scene.frames[-1]
    depth = first.read_depth(first.depth) if first.depth else 1 / taken[0].depth
    pictures = [read_panorama(frame.image).image for frame in (first, second)]
    there = second.pose.inverse() @ first.pose
    error = warping_error(pictures[0], depth, pictures[1], taken[-1].depth, there)
    assert error < 0.03
    assert np.abs(pictures[1] - pictures[0]).mean() > 2 * error


def only_scene(folder: Path, layout: str = "auto") -> Scene:
    (source,) = find_scenes(folder, layout)
    return source.read()


def test_the_programs_own_layout(tmp_path):
    write_own(tmp_path / "room", shots(0.1))
    (tmp_path / "notes").mkdir()
    for folder in (tmp_path, tmp_path / "room"):
        scene = only_scene(folder)
        assert scene.name == "room"
        check(scene, shots(0.1), millimetres=False)


def test_habitat_renders(tmp_path):
    write_habitat(tmp_path / "00000", shots(0.1))
    for folder in (tmp_path, tmp_path / "00000"):
        check(only_scene(folder), shots(0.1))
    (tmp_path / "00000" / "02" / "depth.png").unlink()
    assert [frame.depth is None for frame in only_scene(tmp_path).frames] == [False, False, True]


def test_a_hole_in_a_scan_is_not_infinitely_far(tmp_path):
    write_habitat(tmp_path / "00000", shots(0.1))
    depth = shots(0.1)[0].depth.copy()
    depth[:4] = np.inf
    write_millimetres(tmp_path / "00000" / "00" / "depth.png", depth)
    (pair,) = choose_pairs(None)(only_scene(tmp_path))
    known = load_pair(pair).views[0].known_depth
    assert known is not None
    assert not known.confidence[:4].any()
    np.testing.assert_array_equal(known.confidence[4:] > 0, np.isfinite(depth[4:]))


@pytest.mark.parametrize("unit", [1.0, 0.01], ids=["metres", "centimetres"])
def test_the_authors_carla_runs(tmp_path, unit):
    """Lengths come from the locations if those are metres, else from the geographic positions."""
    write_carla(tmp_path / "Town06" / "run_1", shots(0.1), TURNS, unit)
    for folder, name in ((tmp_path, "Town06/run_1"), (tmp_path / "Town06", "run_1")):
        scene = only_scene(folder)
        assert scene.name == name
        if unit == 1:
            check(scene, shots(0.1))
        steps = np.diff([frame.pose.position for frame in scene.frames], axis=0)
        expected = np.diff([shot.pose.position for shot in shots(0.1)], axis=0)
        np.testing.assert_allclose(steps, expected, rtol=0.02, atol=1e-3)
    assert [frame.name for frame in only_scene(tmp_path).frames] == ["100.png", "107.png", "114.png"]


def test_unreal_angles_are_unreals(tmp_path):
    """Forward, right and up are the columns of CARLA's ``Transform.get_matrix``."""
    angles = [(0.3, 0.2, -0.4), (-2.0, -0.5, 0.1), (1.0, 0.0, 2.0)]
    write_carla(tmp_path / "run", shots(0.1), angles)
    for frame, (yaw, pitch, roll) in zip(only_scene(tmp_path).frames, angles, strict=True):
        (cy, sy), (cp, sp), (cr, sr) = ((math.cos(a), math.sin(a)) for a in (yaw, pitch, roll))
        forward = (cp * cy, cp * sy, sp)
        right = (cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, -cp * sr)
        up = (-cy * sp * cr - sy * sr, -sy * sp * cr + cy * sr, cp * cr)
        for axis, (x, y, z) in zip(((0, 0, -1), (1, 0, 0), (0, 1, 0)), (forward, right, up), strict=True):
            np.testing.assert_allclose(frame.pose.rotation @ axis, (y, z, -x), atol=1e-9)


def test_what_carlas_files_cannot_hold_is_infinitely_far(tmp_path):
    depth = np.full(SIZE, 10.0)
    depth[0], depth[1] = np.inf, 80.0
    write_millimetres(tmp_path / "depth.png", depth)
    inverse = read_face_depth(tmp_path / "depth.png")
    assert not inverse[:2].any()
    assert inverse[2:].all()


def test_zind_tours(tmp_path):
    taken = shots()
    write_zind(tmp_path / "000", taken)
    for folder in (tmp_path, tmp_path / "000"):
        scene = only_scene(folder)
        assert scene.name == "000/floor_01/complete_room_01"
        assert [frame.name for frame in scene.frames] == ["pano_9", "pano_10", "pano_11"]
        check(scene, taken)


def test_a_point_of_a_zind_room_is_seen_where_zind_says(tmp_path):
    """``cartesian_to_sphere`` of ZInD sees (x, y) of a room at the azimuth atan2(−x, y)."""
    scale = 2.5
    write_zind(tmp_path / "000", shots(), scale)
    tour = json.loads((tmp_path / "000" / "zind_data.json").read_text())
    parts = tour["merger"]["floor_01"]["complete_room_01"].values()
    panoramas = {name: panorama for part in parts for name, panorama in part.items()}
    local = np.random.default_rng(0).normal(size=(20, 2))
    for frame in only_scene(tmp_path).frames:
        place = panoramas[frame.name]["floor_plan_transformation"]
        angle = math.radians(place["rotation"])
        matrix = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        floor = local @ matrix * place["scale"] + place["translation"]
        world = scale * np.stack([-floor[:, 0], np.zeros(20), -floor[:, 1]], axis=-1)
        azimuth, _ = direction_to_angles(frame.pose.inverse().transform(world))
        expected = np.stack([-local[:, 0], local[:, 1]]) / np.linalg.norm(local, axis=1)
        np.testing.assert_allclose([np.sin(azimuth), np.cos(azimuth)], expected, atol=1e-9)


def test_a_zind_floor_without_a_scale_says_so(tmp_path):
    write_zind(tmp_path / "000", shots(), None)
    with pytest.raises(NoScaleError, match=r"expected metres per coordinate of floor_01, got null"):
        only_scene(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [("run/gnss_data.json", "[{}]", r"frames\[0\].frame: expected the key"),
     ("run/gnss_data.json", "nonsense", "gnss_data.json"),
     ("run/gnss_data.json", "{}", "frames: expected a valid list"), ("000/zind_data.json", '{"merger": {}}', "merger"),
     ("scene/00/tran.txt", "1 2", "expected 3 numbers .*got 2 fields"),
     ("scene/00/tran.txt", "1 2 x", "expected numbers"), ("scene/poses.json", "{}", "poses.json")],
)  # fmt: skip
def test_damaged_poses_are_explained_when_they_are_read(tmp_path, name, content, message):
    path = tmp_path / name
    path.parent.mkdir(parents=True)
    path.write_text(content)
    if path.name == "tran.txt":
        (path.parent / "rot.txt").write_text("1 0 0 0 1 0 0 0 1")
    with pytest.raises(PoseError, match=message):
        only_scene(tmp_path)


def test_a_rotation_that_mirrors_is_refused(tmp_path):
    write_habitat(tmp_path / "00000", shots())
    np.savetxt(tmp_path / "00000" / "01" / "rot.txt", np.diag([1, 1, -1]))
    with pytest.raises(PoseError, match="expected a rotation"):
        only_scene(tmp_path)


def test_a_folder_without_scenes_is_an_error(tmp_path):
    with pytest.raises(InputError, match=r"expected scenes with poses\.json"):
        find_scenes(tmp_path)
    with pytest.raises(InputError, match="expected a folder of scenes"):
        find_scenes(tmp_path / "nosuch")
    write_own(tmp_path / "room", shots())
    with pytest.raises(InputError, match="the layout 'zind'"):
        find_scenes(tmp_path, "zind")
