"""Meshes as scenes: their files, and how they are rendered."""

import json

import numpy as np
import pytest
from PIL import Image

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.textured_mesh import Material, TexturedMesh
from omnisyn_cli.io import read_depth
from omnisyn_cli.io.encode import write_image
from omnisyn_cli.io.meshes import list_meshes, read_mesh
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.scenes.mesh.raycast import MeshCaster, find_line, find_places
from omnisyn_cli.scenes.mesh.render import lit_scene, render_mesh
from omnisyn_cli.scenes.mesh.texturing import papered_mesh, untextured_share, varied_mesh
from omnisyn_cli.training.data import load_walk

SIZE = np.array([6.0, 3.0, 8.0])  # Metres, of the box room, which stands on y = 0 around the origin.


def checks(seed=0, cells=8, pixels=64):
    """A texture of random squares."""
    colours = np.random.default_rng(seed).integers(30, 226, (cells, cells, 3), dtype=np.uint8)
    return np.kron(colours, np.ones((pixels // cells, pixels // cells, 1), np.uint8))


def box(size=SIZE, centre=(0.0, SIZE[1] / 2, 0.0)):
    """Vertices (24), faces (12) and texture coordinates of a box, four vertices a side."""
    vertices, uv = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = np.empty(3)
                corner[axis] = sign / 2
                corner[(axis + 1) % 3], corner[(axis + 2) % 3] = u - 0.5, v - 0.5
                vertices.append(corner * size + centre)
                uv.append((u, v))
    faces = [[4 * k + a for a in corners] for k in range(6) for corners in ((0, 1, 2), (0, 2, 3))]
    return np.array(vertices, np.float32), np.array(faces, np.int32), np.array(uv, np.float32)


def box_room(materials=None, **options):
    vertices, faces, uv = box()
    if materials is None:
        materials = tuple(Material(f"side {k}", np.full(3, 0.5), texture=checks(k), **options) for k in range(6))
    return TexturedMesh(vertices, faces, uv, np.repeat(np.arange(6, dtype=np.int32), 2), materials)


def joined(one, other):
    return TexturedMesh(
        np.concatenate([one.vertices, other.vertices]),
        np.concatenate([one.faces, other.faces + len(one.vertices)]).astype(np.int32),
        np.concatenate([one.uv, other.uv]),
        np.concatenate([one.face_material, other.face_material + len(one.materials)]).astype(np.int32),
        one.materials + other.materials,
    )


def wall_ahead(distance, material):
    """A square wall of two metres straight ahead (−z) of a camera at eye height in the middle of the room."""
    vertices = np.array([[x, 1.5 + y, -distance] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], np.float32)
    faces, uv = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return TexturedMesh(vertices, faces, uv, np.zeros(2, np.int32), (material,))


def depth_in_box(position, directions, size=SIZE, centre=(0.0, SIZE[1] / 2, 0.0)):
    """Distance to the inner sides of a box, in closed form."""
    with np.errstate(divide="ignore"):
        to_sides = (np.sign(directions) * size / 2 - (position - np.array(centre))) / directions
    return np.where(directions == 0, np.inf, to_sides).min(axis=-1)


def write_glb(path, colours=None):
    """The box room as glTF: a texture, or vertex colours."""
    import trimesh

    vertices, faces, uv = box()
    if colours is None:
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(checks()), name="paint")
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    else:
        visual = trimesh.visual.ColorVisuals(vertex_colors=colours)
    trimesh.Scene(trimesh.Trimesh(vertices, faces, visual=visual, process=False)).export(path)
    return path


EYE = np.array([0.7, 1.5, -0.4])
TURNED = rotation_from_rotation_vector(np.array([0.3, -1.1, 0.2]))


def lit(mesh, rays=24, seed=0):
    return lit_scene(MeshCaster(mesh), np.random.default_rng(seed), Pose(np.eye(3), EYE), rays)


@pytest.mark.parametrize("rotation", [np.eye(3), TURNED], ids=["upright", "turned"])
@pytest.mark.parametrize("size", [(32, 64), (65, 130)])
def test_depth_is_that_of_the_closed_form_in_every_pixel_seam_and_poles_included(rotation, size):
    _, depth = render_mesh(lit(box_room()), Pose(rotation, EYE), size, supersample=1)
    expected = depth_in_box(EYE, pixel_directions(*size) @ rotation.T)
    np.testing.assert_allclose(depth, expected, rtol=1e-5)


def test_nothing_is_infinitely_far():
    mesh = box_room()
    keep = mesh.face_material != 3  # no ceiling
    open_room = type(mesh)(mesh.vertices, mesh.faces[keep], mesh.uv, mesh.face_material[keep], mesh.materials)
    image, depth = render_mesh(lit(open_room), Pose(np.eye(3), EYE), (32, 64))
    sky = depth_in_box(EYE, pixel_directions(32, 64)) * pixel_directions(32, 64)[..., 1] + EYE[1] > SIZE[1] - 1e-4
    assert sky.any()
    np.testing.assert_array_equal(np.isinf(depth), sky)
    assert np.isfinite(image).all()
    assert image.min() >= 0.0
    assert image.max() <= 1.0


def test_a_texture_lies_where_its_coordinates_say():
    """The middle of a wall of four colours, a quarter each: left and right, above and below are told apart."""
    texture = np.zeros((2, 2, 3), np.uint8)
    texture[0, 0], texture[0, 1], texture[1, 0], texture[1, 1] = (200, 0, 0), (0, 200, 0), (0, 0, 200), (200, 200, 0)
    texture = np.kron(texture, np.ones((32, 32, 1), np.uint8))
    wall = wall_ahead(2.0, Material("wall", np.ones(3), texture=texture, is_lit=True))
    image, _ = render_mesh(lit(wall), Pose(np.eye(3), np.array([0.0, 1.5, 0.0])), (64, 128), supersample=1)
    shown = [image[row, col].argmax() for row, col in ((27, 60), (27, 67), (36, 60))]
    assert shown == [0, 1, 2]
    assert image[36, 67, :2].min() > image[36, 67, 2]


def test_all_views_agree_about_the_colour_of_a_point():
    """Light and textures belong to the surface: what two cameras see of a point is the same."""
    scene = lit(box_room())
    points = np.array([[x, 0.0, z] for x in np.linspace(-2, 2, 9) for z in np.linspace(-3, 3, 9)])
    shown = []
    for position in (EYE, EYE + np.array([0.8, 0.1, 0.9])):
        directions = points - position
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        hits = scene.caster.hits(position[None], directions)
        normals = np.broadcast_to([0.0, 1.0, 0.0], points.shape)
        light = scene.lighting.at(scene.caster, position + directions * hits.distance[:, None], normals)
        shown.append(light)
    np.testing.assert_allclose(*shown, rtol=2e-3, atol=2e-3)


def test_holes_of_a_texture_let_rays_through():
    opacity = np.full((8, 8), 255, np.uint8)
    opacity[:, 4:] = 0  # the right half is open
    grille = Material("grille", np.ones(3), texture=checks(), opacity=opacity)
    scene = lit(joined(box_room(), wall_ahead(1.0, grille)))
    _, depth = render_mesh(scene, Pose(np.eye(3), np.array([0.0, 1.5, 0.0])), (64, 128), supersample=1)
    directions = pixel_directions(64, 128)
    behind = depth_in_box(np.array([0.0, 1.5, 0.0]), directions)
    assert depth[32, 60] == pytest.approx(-1.0 / directions[32, 60, 2], rel=1e-5)
    assert depth[32, 67] == pytest.approx(behind[32, 67], rel=1e-5)


def test_supersampling_averages_and_leaves_depth_alone():
    scene = lit(box_room())
    coarse, one = render_mesh(scene, Pose(np.eye(3), EYE), (32, 64), supersample=1)
    fine, same = render_mesh(scene, Pose(np.eye(3), EYE), (32, 64), supersample=4)
    np.testing.assert_array_equal(one, same)
    assert 0.0 < np.abs(coarse - fine).mean() < 0.06


def test_vertex_colours_are_interpolated_where_there_is_no_texture():
    plain = box_room(tuple(Material(f"{k}", np.zeros(3), is_lit=True) for k in range(6)))
    height = plain.vertices[:, 1:2] / np.float32(SIZE[1])
    coloured = type(plain)(
        plain.vertices, plain.faces, plain.uv, plain.face_material, plain.materials,
        vertex_colours=np.repeat(height, 3, axis=1),
    )  # fmt: skip
    scene = lit(coloured)
    hits = scene.caster.hits(np.array([EYE]), np.array([[1.0, 0.0, 0.0]]))
    colour = scene.colours.at(hits, 0.01)
    np.testing.assert_allclose(colour, 0.5, atol=1e-6)


def test_places_stand_at_eye_height_and_lines_are_free():
    pillar = box_room()
    caster, rng = MeshCaster(joined(pillar, wall_ahead(1.0, pillar.materials[0]))), np.random.default_rng(3)
    places = find_places(caster, rng, 30)
    assert len(places) == 30
    assert all(1.0 < position[1] < 2.0 for position, _ in places)
    for _ in range(20):
        line = find_line(caster, places, rng, 4)
        assert line is not None
        steps = np.diff(line, axis=0)
        length = np.linalg.norm(line[-1] - line[0])
        assert caster.distances(line[0][None], ((line[-1] - line[0]) / length)[None])[0] > length
        directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        np.testing.assert_allclose(directions, directions[:1].repeat(3, axis=0), atol=1e-6)


def test_a_mesh_without_a_floor_has_no_places():
    wall = wall_ahead(2.0, Material("wall", np.ones(3)))
    assert find_places(MeshCaster(wall), np.random.default_rng(0), 10) == []
    assert find_line(MeshCaster(wall), [], np.random.default_rng(0), 3) is None


def test_variations_are_a_matter_of_chance_alone_and_keep_the_room_closed():
    photos = [checks(k) for k in range(9, 12)]
    one, same = (varied_mesh(box_room(), np.random.default_rng(5), photos) for _ in range(2))
    np.testing.assert_array_equal(one.vertices, same.vertices)
    sizes = np.ptp(one.vertices, axis=0) / SIZE
    np.testing.assert_allclose(sizes, sizes[0], rtol=1e-5)
    assert len(one.faces) == 12  # every side is a large part of the room
    _, depth = render_mesh(lit(one), Pose(np.eye(3), EYE), (16, 32), supersample=1)
    assert np.isfinite(depth).all()


def test_paper_goes_where_there_is_no_texture():
    plain = box_room(tuple(Material(f"{k}", np.full(3, 0.5)) for k in range(6)))
    assert untextured_share(plain) == 1.0
    papered = papered_mesh(plain, np.random.default_rng(0), [checks()])
    assert untextured_share(papered) == 0.0
    image, _ = render_mesh(lit(papered), Pose(np.eye(3), EYE), (32, 64))
    assert image.std() > 0.03


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
    return "scenes", "render", *arguments, "--size", "64x32", "--light-rays", 8, "-q"


def test_a_rendered_mesh_is_a_data_set_that_eval_reads(tmp_path, omnisyn):
    mesh = write_glb(tmp_path / "room.glb")
    omnisyn.made(*render(mesh, "-o", tmp_path / "out", "--count", 2, "--frames", 3))
    folders = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert folders == ["room_00_0000", "room_00_0001"]
    poses = read_poses(tmp_path / "out" / folders[0] / "poses.json").panoramas
    depth = read_depth(tmp_path / "out" / folders[0] / "0001_depth.exr")
    assert list(poses) == ["0000.png", "0001.png", "0002.png"]
    assert np.isfinite(depth).all()
    assert depth.max() < np.linalg.norm(SIZE)
    assert len(find_scenes(tmp_path / "out")) == 2


def test_cameras_may_be_given(tmp_path, omnisyn):
    mesh = write_glb(tmp_path / "room.glb")
    entry = {"position": [0.5, 1.4, 0.0], "rotation": [1, 0, 0, 0]}
    (tmp_path / "cameras.json").write_text(json.dumps({"version": 1, "panoramas": {"here.png": entry}}))
    omnisyn.made(*render(mesh, "-o", tmp_path / "out", "--poses", tmp_path / "cameras.json"))
    depth = read_depth(tmp_path / "out" / "here_depth.exr")
    assert depth[16, 48] == pytest.approx(2.5, rel=0.01)  # to the right
    assert depth[16, 32] == pytest.approx(4.0, rel=0.01)  # ahead


def test_a_training_scene_is_what_the_recipe_reads(tmp_path, omnisyn):
    omnisyn.made(*render(write_glb(tmp_path / "room.glb"), "-o", tmp_path / "pool", "--pool", "--frames", 3))
    walk = load_walk(tmp_path / "pool" / "room_00_0000.npz")
    assert walk.images.shape == (3, 32, 64, 3)
    assert walk.is_mesh
    np.testing.assert_array_equal(walk.positions[0], 0.0)


@pytest.mark.parametrize("arguments", [("--pool", "--frames", 1), ("--poses", "p.json", "--count", 2)])
def test_options_that_contradict_each_other_are_refused(tmp_path, arguments, omnisyn):
    omnisyn.misused(*render(write_glb(tmp_path / "room.glb"), "-o", tmp_path / "out", *arguments))


def test_what_cannot_be_walked_through_is_said(tmp_path, omnisyn):
    plain = write_archive(tmp_path / "plain", materials=np.array('[{"name": "a", "color": [1, 1, 1]}]'))
    assert "--textures" in omnisyn.refused(*render(plain, "-o", tmp_path / "out"))
    doll = write_glb(tmp_path / "doll.glb")
    assert "expected a floor" in omnisyn.refused(*render(doll, "-o", tmp_path / "out", "--scale", 0.2))
