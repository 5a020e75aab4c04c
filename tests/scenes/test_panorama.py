import numpy as np
import pytest
from scene_samples import DAY, builder, random_shapes

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.scene import SceneBuilder, Shape

SIZE = (40, 80)


@pytest.fixture(scope="module")
def street():
    scene = generate_scene("street", 2)
    return scene, sample_path(scene, 2, 2)


def test_the_result_does_not_depend_on_the_number_of_threads(street):
    scene, path = street
    single = render_panorama(scene, path[0], SIZE, threads=1)
    several = render_panorama(scene, path[0], SIZE, threads=3)
    for a, b in zip(single, several, strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("columns", [1, 20, 40])
def test_turning_by_whole_columns_shifts_the_picture_across_the_seam(street, columns):
    scene, path = street
    turned = Pose(rotation_from_heading(2.0 * np.pi * columns / SIZE[1]) @ path[0].rotation, path[0].position)
    image, depth = render_panorama(scene, path[0], SIZE)
    rotated_image, turned_depth = render_panorama(scene, turned, SIZE)
    same = np.isclose(turned_depth, np.roll(depth, -columns, axis=1), rtol=1e-4)
    assert same.mean() > 0.999  # a ray may slip past an edge
    assert np.abs(rotated_image - np.roll(image, -columns, axis=1)).mean() < 2e-3


def test_the_poles_see_one_point():
    _, depth = render_panorama(builder(ground=-2.0).build("test"), Pose.identity(), (64, 128))
    assert np.ptp(depth[-1]) < 1e-5
    assert depth[-1, 0] == pytest.approx(2.0, rel=1e-3)


def test_an_image_is_finite_and_in_range(street):
    scene, path = street
    image, depth = render_panorama(scene, path[1], SIZE, supersample=3)
    assert image.dtype == depth.dtype == np.float32
    assert np.isfinite(image).all()
    assert 0.0 <= image.min() < image.max() <= 1.0
    assert image.std() > 0.05


def under_a_roof(*, casts_shadow: bool) -> np.ndarray:
    """The ground as it looks there."""
    build = builder(ground=-1.0)
    build.box((-30.0, 3.0, -30.0), (30.0, 3.2, 30.0), Material(), casts_shadow=casts_shadow)
    return render_panorama(build.build("test"), Pose.identity(), SIZE)[0][35:, :]


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


def test_wrong_sizes_are_named():
    with pytest.raises(ValueError, match=r"size \(0, 4\)"):
        render_panorama(random_shapes(0, 4), Pose.identity(), (0, 4))
