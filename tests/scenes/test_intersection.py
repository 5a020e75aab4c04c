import math

import numpy as np
import pytest
from scene_samples import builder, one, oracle_distance, random_shapes, unit_directions

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes import generate_scene, render_panorama, render_views, sample_path
from omnisyn_cli.scenes.intersection import is_shadowed
from omnisyn_cli.scenes.panorama import trace_rays
from omnisyn_cli.scenes.scene import Shape
from omnisyn_cli.scenes.world import pack_scene, seen_from

SIZE = (32, 64)
ORIGIN = np.zeros(3)
UPRIGHT = np.eye(3)


def depth_of(scene, position=ORIGIN, rotation=UPRIGHT, size=SIZE):
    return render_panorama(scene, Pose(rotation, np.asarray(position, dtype=float)), size, supersample=1, threads=1)[1]


def test_the_distance_of_a_sphere_is_the_closed_form():
    centre, radius = np.array([1.0, 0.5, -4.0]), 1.3
    depth = depth_of(one(Shape.ELLIPSOID, tuple(centre), (radius,) * 3))
    along = pixel_directions(*SIZE) @ centre
    inside = along**2 - centre @ centre + radius**2
    is_hit = (inside > 0) & (along > 0)
    assert is_hit.sum() > 20
    np.testing.assert_allclose(depth[is_hit], (along - np.sqrt(np.maximum(inside, 0)))[is_hit], rtol=1e-6)


def test_the_wall_of_a_box_is_a_plane():
    depth = depth_of(one(Shape.BOX, (0.0, 0.0, -3.0), (50.0, 50.0, 1.0)))
    directions = pixel_directions(*SIZE)
    ahead = directions[..., 2] < -0.2
    np.testing.assert_allclose(depth[ahead], (2.0 / -directions[..., 2])[ahead], rtol=1e-6)


def test_the_side_of_a_pole_is_a_circle():
    radius, away = 0.1, 3.0
    build = builder()
    build.pole((away, -5.0, 0.0), 10.0, radius, build.ground_material)
    sideways = np.array([[1.0, 0.0, 0.0], [math.cos(0.02), 0.0, math.sin(0.02)]])
    distance, _ = trace_rays(build.build("test"), ORIGIN, sideways)
    expected = [away - radius, away * math.cos(0.02) - math.sqrt(radius**2 - (away * math.sin(0.02)) ** 2)]
    np.testing.assert_allclose(distance, expected, rtol=1e-12)


def test_the_ground_is_as_far_as_the_eye_is_high():
    depth = depth_of(builder(ground=-1.7).build("test"))
    directions = pixel_directions(*SIZE)
    down = directions[..., 1] < 0
    np.testing.assert_allclose(depth[down], (1.7 / -directions[..., 1])[down], rtol=1e-6)
    assert np.isinf(depth[~down]).all()


def test_a_rod_joins_its_ends():
    build = builder()
    build.rod((1.0, 1.0, -4.0), (-2.0, 0.0, -4.0), 0.05, build.ground_material)
    scene = build.build("test")
    for end in ((0.99, 0.997, -4.0), (-1.99, 0.003, -4.0)):
        towards = np.array([end]) / np.linalg.norm(end)
        assert trace_rays(scene, ORIGIN, towards)[0][0] == pytest.approx(np.linalg.norm(end), abs=0.06)


@pytest.mark.parametrize("seed", range(4))
def test_every_shape_agrees_with_the_oracle(seed):
    scene, directions = random_shapes(seed), unit_directions(seed, 500)
    distance, hit = trace_rays(scene, ORIGIN, directions)
    expected = [oracle_distance(scene, ORIGIN, direction) for direction in directions]
    np.testing.assert_allclose(distance, [d for d, _ in expected], rtol=1e-9)
    np.testing.assert_array_equal(hit, [k for _, k in expected])
    assert len(np.unique(hit)) > 20


@pytest.mark.parametrize("size", [(1, 2), (3, 5), (33, 70), (64, 128)])
def test_tiles_lose_nothing(size):
    scene, rotation = random_shapes(5), rotation_from_rotation_vector(np.array([0.4, -1.3, 0.7]))
    expected, _ = trace_rays(scene, ORIGIN, (pixel_directions(*size) @ rotation.T).reshape(-1, 3))
    np.testing.assert_allclose(depth_of(scene, ORIGIN, rotation, size).ravel(), expected, rtol=1e-6)


@pytest.mark.parametrize(("kind", "seed"), [("street", 3), ("street", 4), ("room", 0), ("room", 1)])
def test_depth_in_a_rotated_frame_is_that_along_the_rotated_rays(kind, seed):
    scene = generate_scene(kind, seed)
    position = sample_path(scene, seed, 1)[0].position
    rotation = rotation_from_rotation_vector(np.array([1.2, 0.5, -0.8]))
    _, depth = render_views(scene, rotation, position[None], (48, 96), supersample=2)
    expected, hit = trace_rays(scene, position, (pixel_directions(48, 96) @ rotation.T).reshape(-1, 3))
    np.testing.assert_allclose(depth.ravel(), expected, rtol=1e-6)
    assert (depth > 0).all()
    np.testing.assert_array_equal(np.isinf(depth.ravel()), hit == -2)


def test_a_point_is_shadowed_if_a_ray_to_the_sun_hits_something():
    scene = random_shapes(6, count=60)
    points = np.random.default_rng(7).uniform(-8, 8, (400, 3))
    points = points[[oracle_clear(scene, point) for point in points]]
    packed = pack_scene(scene)
    world, _ = seen_from(packed, scene, ORIGIN)
    sun = np.array([0.0, 1.0, 0.0])
    shadowed = [bool(is_shadowed(world, *point, *sun)) for point in points]
    expected = [oracle_distance(scene, point, sun)[1] >= 0 for point in points]
    assert 20 < sum(expected) < len(points) - 20
    assert shadowed == expected


def oracle_clear(scene, point):
    """Whether a point is outside of all shapes: a ray that starts inside one hits it nowhere else but from inside."""
    local = np.einsum("nji,nj->ni", scene.rotation, point - scene.centre) / scene.half
    return bool((np.abs(local).max(axis=1) > 1.0).all())
