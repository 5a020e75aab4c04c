"""Depth and pictures of generated scenes against closed forms and against every surface tried one by one."""

import math

import numpy as np
import pytest
from scene_samples import DAY, builder, one, oracle_distance, random_shapes, unit_directions

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.panorama import trace_rays
from omnisyn_cli.scenes.scene import SEGMENTS, SceneBuilder, Shape, triangles

SIZE = (32, 64)
ORIGIN = np.zeros(3)
# Share of a radius by which triangles may lie inside of what is round, along both of its angles.
FLATTENED = 1.0 - math.cos(math.pi / SEGMENTS) ** 2


def depth_of(scene, rotation=None, size=SIZE):
    pose = Pose(np.eye(3) if rotation is None else rotation, ORIGIN)
    return render_panorama(scene, pose, size, supersample=1, threads=1)[1]


def test_a_sphere_is_round_but_for_its_triangles():
    centre, radius = np.array([1.0, 0.5, -4.0]), 1.3
    depth = depth_of(one(Shape.ELLIPSOID, tuple(centre), (radius,) * 3))
    points = pixel_directions(*SIZE) * np.where(np.isinf(depth), 0.0, depth)[..., None]
    from_centre = np.linalg.norm(points - centre, axis=-1)[depth < 10.0]
    assert len(from_centre) > 20
    assert from_centre.max() < radius * (1.0 + 1e-6)
    assert from_centre.min() > radius * (1.0 - FLATTENED)


def test_flat_faces_are_planes():
    directions = pixel_directions(*SIZE)
    wall, ahead = depth_of(one(Shape.BOX, (0.0, 0.0, -3.0), (50.0, 50.0, 1.0))), directions[..., 2] < -0.2
    np.testing.assert_allclose(wall[ahead], (2.0 / -directions[..., 2])[ahead], rtol=1e-6)
    ground, down = depth_of(builder(ground=-1.7).build("test")), directions[..., 1] < 0
    np.testing.assert_allclose(ground[down], (1.7 / -directions[..., 1])[down], rtol=1e-6)
    assert np.isinf(ground[~down]).all()


def test_a_rod_joins_its_ends():
    build = builder()
    build.rod((1.0, 1.0, -4.0), (-2.0, 0.0, -4.0), 0.05, build.ground_material)
    scene = build.build("test")
    for end in ((0.99, 0.997, -4.0), (-1.99, 0.003, -4.0)):
        towards = np.array([end]) / np.linalg.norm(end)
        assert trace_rays(scene, ORIGIN, towards)[0][0] == pytest.approx(np.linalg.norm(end), abs=0.06)


@pytest.mark.parametrize("shape", Shape)
def test_triangles_are_closed_and_fill_their_shape(shape):
    """Every edge is that of two faces, once in each direction, but for edges without length."""
    half = np.array([0.5, 2.0, 0.5])
    vertices, faces, _, _ = triangles(one(shape, (0.0, 0.0, 0.0), tuple(half)).shapes[1:])
    np.testing.assert_allclose(np.abs(vertices).max(axis=0), half, rtol=1e-6)
    _, point = np.unique(vertices.round(6), axis=0, return_inverse=True)
    edges = np.concatenate([point.ravel()[faces[:, pair]] for pair in ((0, 1), (1, 2), (2, 0))])
    edges = np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count % 2 == 0).all()


@pytest.mark.parametrize("seed", range(4))
def test_every_shape_agrees_with_the_oracle(seed):
    """Exactly where it is flat, nearly where it is round; beside an edge a ray may slip past."""
    scene, directions = random_shapes(seed), unit_directions(seed, 500)
    distance, hit = trace_rays(scene, ORIGIN, directions)
    expected, which = map(np.array, zip(*(oracle_distance(scene, ORIGIN, d) for d in directions), strict=True))
    assert (hit == which).mean() > 0.96
    same = (hit == which) & (hit >= 0)
    box = same & (scene.shapes["kind"][hit] == Shape.BOX)
    np.testing.assert_allclose(distance[box], expected[box], rtol=1e-6)
    assert np.median(np.abs(distance[same] - expected[same])) < 0.01
    assert len(np.unique(hit)) > 20


@pytest.mark.parametrize(("kind", "seed"), [("street", 3), ("room", 0), ("home", 1)])
def test_depth_in_a_rotated_frame_is_that_along_the_rotated_rays(kind, seed):
    scene = generate_scene(kind, seed)
    position = sample_path(scene, seed, 1)[0].position
    rotation = rotation_from_rotation_vector(np.array([1.2, 0.5, -0.8]))
    _, depth = render_panorama(scene, Pose(rotation, position), (33, 70), supersample=2)
    expected, hit = trace_rays(scene, position, (pixel_directions(33, 70) @ rotation.T).reshape(-1, 3))
    np.testing.assert_allclose(depth.ravel(), expected, rtol=1e-6)
    assert (depth > 0).all()
    np.testing.assert_array_equal(np.isinf(depth.ravel()), hit == -1)


PICTURE_SIZE = (40, 80)


@pytest.fixture(scope="module")
def street():
    scene = generate_scene("street", 2)
    return scene, sample_path(scene, 2, 2)


def test_the_result_does_not_depend_on_the_number_of_threads(street):
    scene, path = street
    single = render_panorama(scene, path[0], PICTURE_SIZE, threads=1)
    several = render_panorama(scene, path[0], PICTURE_SIZE, threads=3)
    for a, b in zip(single, several, strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("columns", [1, 20, 40])
def test_turning_by_whole_columns_shifts_the_picture_across_the_seam(street, columns):
    scene, path = street
    turned = Pose(rotation_from_heading(2.0 * np.pi * columns / PICTURE_SIZE[1]) @ path[0].rotation, path[0].position)
    image, depth = render_panorama(scene, path[0], PICTURE_SIZE)
    rotated_image, turned_depth = render_panorama(scene, turned, PICTURE_SIZE)
    same = np.isclose(turned_depth, np.roll(depth, -columns, axis=1), rtol=1e-4)
    assert same.mean() > 0.999  # a ray may slip past an edge
    assert np.abs(rotated_image - np.roll(image, -columns, axis=1)).mean() < 2e-3


def test_the_poles_see_one_point():
    _, depth = render_panorama(builder(ground=-2.0).build("test"), Pose.identity(), (64, 128))
    assert np.ptp(depth[-1]) < 1e-5
    assert depth[-1, 0] == pytest.approx(2.0, rel=1e-3)


def test_an_image_is_finite_and_in_range(street):
    scene, path = street
    image, depth = render_panorama(scene, path[1], PICTURE_SIZE, supersample=3)
    assert image.dtype == depth.dtype == np.float32
    assert np.isfinite(image).all()
    assert 0.0 <= image.min() < image.max() <= 1.0
    assert image.std() > 0.05


def under_a_roof(*, casts_shadow: bool) -> np.ndarray:
    """The ground as it looks there."""
    build = builder(ground=-1.0)
    build.box((-30.0, 3.0, -30.0), (30.0, 3.2, 30.0), Material(), casts_shadow=casts_shadow)
    return render_panorama(build.build("test"), Pose.identity(), PICTURE_SIZE)[0][35:, :]


def test_shadows_darken_what_is_under_a_roof():
    dark, bright = (under_a_roof(casts_shadow=is_solid) for is_solid in (True, False))
    assert dark.mean() < bright.mean() - 0.05


def test_a_ray_passes_between_bars():
    build = SceneBuilder(np.random.default_rng(0), lighting=DAY)
    bars = Material(Pattern.BARS, cell=(0.5, 0.5), line=0.1)
    build.add(Shape.BOX, (0.0, 1.0, -2.0), (20.0, 1.0, 0.01), bars)
    scene = build.build("test")
    _, depth = render_panorama(scene, Pose(np.eye(3), np.array([0.0, 1.0, 0.0])), (64, 128))
    ahead = depth[33, 48:80]
    assert np.isclose(ahead.min(), 2.0, rtol=0.05)
    assert (ahead > 10.0).sum() > 10


def test_far_texture_fades_to_its_mean():
    build = builder(ground=-2.0)
    build.ground_material = Material(
        Pattern.CHECKER, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), cell=(0.5, 0.5), grain=0.0, line=0.0
    )
    image, _ = render_panorama(build.build("test"), Pose.identity(), (128, 256))
    assert image[120].std() > 0.2
    assert image[66].std() < 0.03


def test_an_empty_scene_is_ground_and_sky():
    image, depth = render_panorama(builder(ground=-1.0).build("test"), Pose.identity(), (8, 16))
    assert np.isinf(depth[:4]).all()
    assert np.isfinite(depth[4:]).all()
    assert np.isfinite(image).all()
