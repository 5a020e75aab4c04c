"""Every layout brings back the poses and depth that were written, so that one view warps into the next."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import (
    HEADINGS,
    SIZE,
    Shot,
    shots,
    warping_error,
    write_carla,
    write_habitat,
    write_millimetres,
    write_own,
    write_zind,
)

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.layouts import read_face_depth
from omnisyn_cli.evaluation.datasets.sources import NoScaleError, Scene, choose_pairs
from omnisyn_cli.evaluation.views import load_pair
from omnisyn_cli.geometry.sphere import direction_to_angles
from omnisyn_cli.io import read_panorama

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
