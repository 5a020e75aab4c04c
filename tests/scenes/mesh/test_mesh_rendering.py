import numpy as np
import pytest
from mesh_samples import SIZE, box_room, checks, depth_in_box, joined, wall_ahead

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.textured_mesh import Material
from omnisyn_cli.scenes.mesh.places import find_line, find_places
from omnisyn_cli.scenes.mesh.raycast import MeshCaster
from omnisyn_cli.scenes.mesh.render import MeshScene, draw_lighting, render_mesh
from omnisyn_cli.scenes.mesh.texturing import SurfaceColours, papered_mesh, untextured_share, varied_mesh

EYE = np.array([0.7, 1.5, -0.4])
TURNED = rotation_from_rotation_vector(np.array([0.3, -1.1, 0.2]))


def lit(mesh, rays=24, seed=0):
    caster = MeshCaster(mesh)
    return MeshScene(caster, SurfaceColours(caster), draw_lighting(caster, np.random.default_rng(seed), EYE, rays))


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
    scene = lit(box_room()).exposed_at(Pose(np.eye(3), EYE))
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
    scene = lit(box_room()).exposed_at(Pose(np.eye(3), EYE))
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
    assert all(1.0 < place.position[1] < 2.0 for place in places)
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
