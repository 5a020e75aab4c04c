import dataclasses

import numpy as np
import pytest
from scene_samples import builder, clearance, unit_directions

from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes import GENERATORS, generate_scene, sample_path
from omnisyn_cli.scenes.materials import Material
from omnisyn_cli.scenes.panorama import trace_rays
from omnisyn_cli.scenes.scene import Shape, Walkway

KINDS = sorted(GENERATORS)


def frozen_bytes(scene):
    arrays = (getattr(scene, field.name) for field in dataclasses.fields(scene))
    return b"".join(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode() for value in arrays)


@pytest.mark.parametrize("kind", KINDS)
def test_equal_seeds_give_equal_scenes(kind):
    first, again, other = generate_scene(kind, 3), generate_scene(kind, 3), generate_scene(kind, 4)
    assert frozen_bytes(first) == frozen_bytes(again)
    assert frozen_bytes(first) != frozen_bytes(other)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(12))
def test_scenes_are_sound_and_cameras_stand_free(kind, seed):
    scene = generate_scene(kind, seed)
    path = sample_path(scene, seed, 5)
    positions = np.stack([pose.position for pose in path])
    rotation = scene.shapes["rotation"]
    assert (scene.shapes["half"] > 0).all()
    np.testing.assert_allclose(rotation @ np.swapaxes(rotation, 1, 2), [np.eye(3)] * len(rotation), atol=1e-9)
    assert clearance(scene, positions).min() > 0.05
    directions = pixel_directions(12, 24).reshape(-1, 3)
    for position in positions:
        distance, _ = trace_rays(scene, position, directions)
        assert distance.min() > 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_is_straight_even_and_as_long_as_asked(kind):
    scene = generate_scene(kind, 1)
    path = sample_path(scene, 8, 4, baseline=0.8, vertical=0.0)
    steps = np.diff(np.stack([pose.position for pose in path]), axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-12)
    assert np.linalg.norm(steps.sum(axis=0)) == pytest.approx(0.8)
    np.testing.assert_array_equal(path[0].rotation, path[3].rotation)


def test_equal_seeds_give_equal_paths():
    scene = generate_scene("room", 2)
    first, again = sample_path(scene, 5, 3), sample_path(scene, 5, 3)
    assert all(a.almost_equals(b, metres=0.0, radians=0.0) for a, b in zip(first, again, strict=True))


def test_upright_paths_go_straight_up():
    scene = generate_scene("room", 2)
    path = sample_path(scene, 5, 3, baseline=0.6, vertical=1.0)
    np.testing.assert_allclose(path[2].position - path[0].position, [0.0, 0.6, 0.0], atol=1e-12)


def test_tilted_cameras_are_held_askew():
    path = sample_path(generate_scene("street", 2), 5, 3, tilt=0.1)
    ups = np.stack([pose.rotation[:, 1] for pose in path])
    assert (ups[:, 1] < 1.0 - 1e-6).all()
    assert np.abs(path[0].rotation - path[1].rotation).max() > 0.01


def test_a_path_does_not_leave_through_walls_or_windows():
    with pytest.raises(ValueError, match="shorter baseline"):
        sample_path(generate_scene("room", 1), 0, 2, baseline=50.0, vertical=0.0)


@pytest.mark.parametrize(("baseline", "fits"), [(1.5, True), (4.0, False)])
def test_a_path_keeps_within_four_thin_walls(baseline, fits):
    build = builder(ground=0.0)
    walls = ((1.5, 0.0, 0.01, 1.6), (-1.5, 0.0, 0.01, 1.6), (0.0, 1.5, 1.6, 0.01), (0.0, -1.5, 1.6, 0.01))
    for x, z, wide, deep in walls:
        build.add(Shape.BOX, (x, 1.5, z), (wide, 1.5, deep), Material())
    build.walkways.append(Walkway((-1.0, 1.0, -1.0), (1.0, 2.0, 1.0), (0.0, 1.0), (1.0, 1.0), 0.2))
    scene = build.build("test")
    if fits:
        path = sample_path(scene, 0, 2, baseline=baseline, vertical=0.0)
        assert max(np.abs(pose.position[[0, 2]]).max() for pose in path) < 1.5
    else:
        with pytest.raises(ValueError, match="found none"):
            sample_path(scene, 0, 2, baseline=baseline, vertical=0.0)


@pytest.mark.parametrize("seed", range(6))
def test_paths_are_no_longer_than_three_times_the_distance_of_what_is_near(seed):
    """And stay where walkways are: not through a window."""
    scene = generate_scene("home", seed)
    start, end = (pose.position for pose in sample_path(scene, seed, 2))
    directions = pixel_directions(8, 16).reshape(-1, 3)
    near = min(np.quantile(trace_rays(scene, place, directions)[0], 0.04) for place in (start, end))
    assert 0.25 <= np.linalg.norm(end - start) <= 3.0 * near + 1e-9
    lows, highs = (np.array([getattr(walkway, name) for walkway in scene.walkways]) for name in ("low", "high"))
    assert np.any(np.all((end >= lows) & (end <= highs), axis=1, where=[True, False, True]))


def test_usual_baselines_are_spread_evenly_in_their_logarithm():
    """From a quarter of a metre to several; what is long is shortened until it fits."""
    lengths = []
    for seed in range(24):
        start, end = (pose.position for pose in sample_path(generate_scene("home", seed), seed, 2))
        lengths.append(np.linalg.norm(end - start))
    assert min(lengths) < 0.5
    assert max(lengths) > 2.0
    assert 0.4 < np.median(lengths) < 2.5


def test_things_are_near_the_way():
    """In most scenes a tenth of what is seen lies nearer than two metres."""
    near = []
    for seed in range(8):
        scene = generate_scene("home", seed)
        distance, _ = trace_rays(scene, sample_path(scene, seed, 1)[0].position, unit_directions(seed, 200))
        near.append(np.quantile(distance, 0.1) < 2.0)
    assert np.mean(near) > 0.5
