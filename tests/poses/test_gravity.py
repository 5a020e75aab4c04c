"""How a single camera was held: tilts are told within a degree; upside-down and rolled pictures are named."""

import math

import numpy as np
import pytest
from registration_samples import street_image

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sphere import FORWARD, UP, normalize, pixel_directions
from omnisyn_cli.interpolation.describe import describe_file
from omnisyn_cli.io import write_image
from omnisyn_cli.poses.estimation import PictureOptions, estimate_poses
from omnisyn_cli.poses.gravity import Gravity, Vertical, gravity_of, gravity_of_picture
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

SIZE = (384, 768)


@pytest.fixture(scope="module")
def pictures():
    """Upright panoramas of three streets, rooms and homes."""
    scenes = [(generate_scene(kind, seed), seed) for kind in ("street", "room", "home") for seed in (500, 501)]
    return [render_panorama(scene, sample_path(scene, seed, 2)[0], SIZE, threads=2)[0] for scene, seed in scenes]


def held(picture: np.ndarray, degrees: float, axis: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """What a camera sees that was turned about an axis of its own, and the zenith in its frame."""
    turn = rotation_from_rotation_vector(math.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    table = RemapTable.for_directions(pixel_directions(*SIZE) @ turn.T, SIZE)
    channels = [table.bilinear(np.ascontiguousarray(picture[..., k], np.float32)) for k in range(3)]
    return np.stack(channels, axis=-1), turn.T @ UP


def test_tilts_of_3_to_30_degrees_are_told_within_one(pictures):
    for index, (picture, degrees) in enumerate(zip(pictures, np.linspace(3, 30, len(pictures)), strict=True)):
        seen, up = held(picture, degrees, (math.cos(index), 0.0, math.sin(index)))
        gravity = gravity_of_picture(seen)
        assert gravity.attitude == "upright", index
        off = math.degrees(math.acos(min(1.0, float(gravity.vertical.up @ up))))
        assert off < 1.0 or not gravity.vertical.is_certain, (index, off)


@pytest.mark.parametrize(("crooked", "is_certain"), [(0.2, True), (1.4, False)])
@pytest.mark.parametrize("seed", range(4))
def test_crooked_edges_are_not_certain(crooked, is_certain, seed):
    rng = np.random.default_rng(seed)
    normals = normalize(np.cross(UP, rng.normal(size=(30, 3)))) + rng.normal(0.0, math.radians(crooked), (30, 3))
    gravity = gravity_of(np.full((64, 128, 3), 0.5), 0.1 * np.asarray(normalize(normals)))
    assert gravity.attitude == "upright"
    assert gravity.tilt < 3.0 * gravity.vertical.std
    assert gravity.vertical.is_certain is is_certain


@pytest.mark.parametrize(("degrees", "axis", "attitude"), [
    (0, (0, 0, 1), "upright"), (180, (0, 0, 1), "upside down"), (180, (1, 0, 0), "upside down"),
    (90, (0, 0, 1), "rolled by 90°"), (-90, (0, 0, 1), "rolled by 90°"), (90, (1, 0, 0), "rolled by 90°"),
])  # fmt: skip
def test_pictures_that_are_not_upright_are_named_and_no_upright_one(pictures, degrees, axis, attitude):
    assert {gravity_of_picture(held(picture, degrees, axis)[0]).attitude for picture in pictures} == {attitude}


def test_a_tour_and_info_say_so_with_the_remedy_unless_the_pictures_disagree(tmp_path, monkeypatch):
    paths = [tmp_path / name for name in ("a.png", "b.png")]
    for index, path in enumerate(paths):
        write_image(path, np.ascontiguousarray(street_image(index, SIZE)[::-1, ::-1]).astype(np.float32))
    remedy = "upside down; if so, rotate the picture by 180°"
    assert describe_file(paths[0])["looks"] == remedy
    notes = estimate_poses(paths, (1.0,), PictureOptions(threads=1)).notes
    assert [f"{path.name} looks {remedy}" in notes for path in paths] == [True, True]
    answers = [
        Gravity(Vertical(up, 0.0, True), held) for up, held in ((-UP, "upside down"), (FORWARD, "rolled by 90°"))
    ]
    monkeypatch.setattr("omnisyn_cli.poses.estimation.gravity_of", lambda *_: answers.pop())
    notes = estimate_poses(paths, (1.0,), PictureOptions(threads=1)).notes
    assert not any(" looks " in note for note in notes)
