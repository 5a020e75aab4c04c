import json

import numpy as np
import pytest
from click.testing import CliRunner
from mesh_samples import SIZE, box, checks, write_glb

from omnisyn_cli.cli.scenes import scenes
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.io import read_depth
from omnisyn_cli.io.encode import write_image
from omnisyn_cli.io.meshes import list_meshes, read_mesh
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.training.data import load_walk


def test_a_glb_comes_with_its_texture(tmp_path):
    mesh = read_mesh(write_glb(tmp_path / "room.glb"))
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), SIZE, rtol=1e-6)
    assert len(mesh.faces) == 12
    np.testing.assert_array_equal(mesh.materials[0].texture, checks())
    vertices, faces, uv = box()
    for face in range(12):  # corners may be in another order, but each keeps its texture coordinates
        expected = np.hstack([vertices[faces[face]], uv[faces[face]]]).tolist()
        found = np.hstack([mesh.vertices[mesh.faces[face]], mesh.uv[mesh.faces[face]]]).tolist()
        np.testing.assert_allclose(sorted(found), sorted(expected), atol=1e-6)


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb"])
def test_vertex_colours_are_read(tmp_path, suffix):
    colours = np.random.default_rng(0).integers(0, 256, (24, 4), dtype=np.uint8)
    colours[:, 3] = 255
    mesh = read_mesh(write_glb(tmp_path / f"room.{suffix}", colours))
    assert mesh.vertex_colours is not None
    np.testing.assert_allclose(mesh.vertex_colours, colours[:, :3] / 255.0, atol=1 / 250)


def test_z_may_be_up_and_units_may_differ(tmp_path):
    path = write_glb(tmp_path / "room.glb")
    mesh = read_mesh(path, 0.5, z_up=True)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), SIZE[[0, 2, 1]] / 2, rtol=1e-6)


def write_archive(folder, **changed):
    vertices, faces, uv = box()
    z_up = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    materials = [{"name": "paint", "tex": "paint.png", "color": [1, 1, 1], "alpha": None, "lm": False, "emit": False}]
    arrays = {
        "verts": z_up, "faces": faces, "uv": uv, "mat": np.zeros(12, np.uint16), "has_lm": np.array(False),
        "materials": np.array(json.dumps(materials)),
    }  # fmt: skip
    folder.mkdir()
    write_image(folder / "paint.png", checks() / np.float32(255.0))
    np.savez(folder / "scene.npz", **(arrays | changed))
    return folder / "scene.npz"


def test_an_archive_is_the_same_room(tmp_path):
    mesh, same = read_mesh(write_glb(tmp_path / "room.glb")), read_mesh(write_archive(tmp_path / "archive"))
    np.testing.assert_allclose(same.vertices[same.faces].min((0, 1)), mesh.vertices[mesh.faces].min((0, 1)), atol=1e-6)
    np.testing.assert_array_equal(same.materials[0].texture, mesh.materials[0].texture)
    assert list_meshes(tmp_path) == [tmp_path / "archive" / "scene.npz", tmp_path / "room.glb"]


@pytest.mark.parametrize("content", [b"", b"glTF\x02\x00\x00\x00 nonsense", b"\x00" * 999])
def test_a_damaged_file_is_named(tmp_path, content):
    path = tmp_path / "room.glb"
    path.write_bytes(content)
    with pytest.raises(InputError, match="expected a mesh") as raised:
        read_mesh(path)
    assert str(path) in str(raised.value)


def test_other_things_that_are_no_rooms_are_refused(tmp_path):
    with pytest.raises(InputError, match="found no file"):
        read_mesh(tmp_path / "none.glb")
    with pytest.raises(InputError, match="other units"):
        read_mesh(write_glb(tmp_path / "far.glb"), 1e4)
    with pytest.raises(InputError, match="other units"):
        read_mesh(write_glb(tmp_path / "tiny.glb"), 1e-3)
    with pytest.raises(InputError, match="expected a mesh archive"):
        read_mesh(write_archive(tmp_path / "torn", materials=np.array("[{")))
    with pytest.raises(InputError, match="found none that have an area"):
        read_mesh(write_archive(tmp_path / "nan", verts=np.full((24, 3), np.nan)))
    with pytest.raises(InputError, match="expected meshes"):
        list_meshes(tmp_path / "nan" / "nothing")


def render(*arguments):
    command = ["render", *map(str, arguments), "--size", "64x32", "--light-rays", "8"]
    return CliRunner().invoke(scenes, command, catch_exceptions=True)


def test_a_rendered_mesh_is_a_data_set_that_eval_reads(tmp_path):
    mesh = write_glb(tmp_path / "room.glb")
    assert render(mesh, "-o", tmp_path / "out", "--count", 2, "--frames", 3, "-q").exit_code == 0
    folders = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert folders == ["room_00_0000", "room_00_0001"]
    poses = read_poses(tmp_path / "out" / folders[0] / "poses.json").panoramas
    depth = read_depth(tmp_path / "out" / folders[0] / "0001_depth.exr")
    assert list(poses) == ["0000.png", "0001.png", "0002.png"]
    assert np.isfinite(depth).all()
    assert depth.max() < np.linalg.norm(SIZE)
    assert len(find_scenes(tmp_path / "out")) == 2


def test_cameras_may_be_given(tmp_path):
    mesh = write_glb(tmp_path / "room.glb")
    entry = {"position": [0.5, 1.4, 0.0], "rotation": [1, 0, 0, 0]}
    (tmp_path / "cameras.json").write_text(json.dumps({"version": 1, "panoramas": {"here.png": entry}}))
    assert render(mesh, "-o", tmp_path / "out", "--poses", tmp_path / "cameras.json", "-q").exit_code == 0
    depth = read_depth(tmp_path / "out" / "here_depth.exr")
    assert depth[16, 48] == pytest.approx(2.5, rel=0.01)  # to the right
    assert depth[16, 32] == pytest.approx(4.0, rel=0.01)  # ahead


def test_a_training_scene_is_what_the_recipe_reads(tmp_path):
    mesh = write_glb(tmp_path / "room.glb")
    assert render(mesh, "-o", tmp_path / "pool", "--pool", "--frames", 3, "-q").exit_code == 0
    walk = load_walk(tmp_path / "pool" / "room_00_0000.npz")
    assert walk.images.shape == (3, 32, 64, 3)
    assert walk.is_mesh
    np.testing.assert_array_equal(walk.positions[0], 0.0)


@pytest.mark.parametrize("arguments", [("--pool", "--frames", 1), ("--poses", "p.json", "--count", 2)])
def test_options_that_contradict_each_other_are_refused(tmp_path, arguments):
    mesh = write_glb(tmp_path / "room.glb")
    assert render(mesh, "-o", tmp_path / "out", *arguments).exit_code == 2


def test_what_cannot_be_walked_through_is_said(tmp_path):
    plain = write_archive(tmp_path / "plain", materials=np.array('[{"name": "a", "color": [1, 1, 1]}]'))
    assert "--textures" in str(render(plain, "-o", tmp_path / "out").exception)
    doll = render(write_glb(tmp_path / "doll.glb"), "-o", tmp_path / "out", "--scale", "0.2")
    assert "expected a floor" in str(doll.exception)
