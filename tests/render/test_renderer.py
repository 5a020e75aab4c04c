import numpy as np
import pytest
from render_samples import WHOLE, make_renderer, moved, random_pose, rough, smooth

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.render.surface_confidence import MIN_CONFIDENCE

everywhere = pytest.mark.parametrize("name", RENDERERS)


def picture(height: int, width: int) -> np.ndarray:
    """A smooth image, so that half a pixel costs little."""
    row, col = np.indices((height, width))
    waves = [np.sin(np.pi * (row + 0.5) / height) * np.cos(2 * np.pi * (col + 0.5) / width * k + k) for k in (0, 1, 2)]
    return (0.5 + 0.4 * np.stack(waves, axis=-1)).astype(np.float32)


def seen(renderer, pose):
    """Inverse depth and colour."""
    shown = renderer(pose)
    return shown.inverse_depth, shown.colour


@everywhere
def test_the_identity_pose_returns_the_photograph(name):
    image = picture(32, 64)
    inverse_depth, colour = seen(make_renderer(name, image, None, smooth(16, 32), None, (32, 64)), Pose.identity())
    rows = slice(1, -1)
    assert (inverse_depth[rows] >= 0).all()
    blurred = 0.06 if name == "points" else 1e-4  # discs overlap their neighbours
    np.testing.assert_allclose(colour[rows, :, :3], image[rows], atol=blurred)
    np.testing.assert_allclose(colour[rows, :, 3], 1.0, atol=1e-4)


@everywhere
@pytest.mark.parametrize(
    "sizes", [((16, 32), (16, 32), (16, 32)), ((40, 80), (8, 16), (21, 42)), ((4, 8), (16, 32), (9, 19))]
)
def test_photograph_mesh_and_target_each_have_a_size_of_their_own(name, sizes):
    image_size, mesh_size, size = sizes
    renderer = make_renderer(name, picture(*image_size), None, smooth(*mesh_size), np.ones(mesh_size), size)
    inverse_depth, colour = seen(renderer, random_pose(60, 0.4))
    assert inverse_depth.shape == size
    assert colour.shape == (*size, 4)
    assert inverse_depth.dtype == colour.dtype == np.float32
    assert (inverse_depth >= 0).mean() > 0.8
    assert (colour[inverse_depth < 0] == 0).all()
    assert ((colour >= -0.3) & (colour <= 1.3)).all()


def test_all_renderers_show_the_same_scene():
    """A smooth scene from half a metre away: the approximations differ from the exact one by little."""
    image, rho, pose = picture(64, 128), smooth(64, 128), random_pose(61, 0.5)
    views = {name: seen(make_renderer(name, image, None, rho, None, (64, 128)), pose) for name in RENDERERS}
    depth, colour = views["mesh"]
    for name, (other_depth, other_colour) in views.items():
        both = (depth >= 0) & (other_depth >= 0)
        assert both[4:-4].mean() > 0.9, name
        assert np.median(np.abs(other_depth - depth)[both] / depth[both]) < 5e-3, name
        assert np.abs(other_colour - colour)[both][:, :3].mean() < 0.02, name


@everywhere
def test_a_mask_at_the_photograph_s_resolution_takes_trust_away(name):
    mask = np.ones((32, 64), bool)
    mask[8:24, 16:32] = False
    colour = make_renderer(name, picture(32, 64), mask, smooth(16, 32), None, (32, 64), WHOLE)(Pose.identity()).colour
    assert (colour[10:22, 18:30, 3] == 0).all()
    assert (colour[2:6, :, 3] > 0.9).all()


@everywhere
def test_confidence_becomes_weight(name):
    confidence = np.full((16, 32), 0.5, np.float32)
    confidence[:, :16] = 0.0
    colour = make_renderer(name, picture(32, 64), None, smooth(16, 32), confidence, (32, 64), WHOLE)(
        Pose.identity()
    ).colour
    np.testing.assert_allclose(colour[4:-4, 36:60, 3], 0.5, atol=1e-4)
    assert (colour[4:-4, 4:28, 3] <= MIN_CONFIDENCE + 1e-4).all()


@everywhere
@pytest.mark.parametrize(("confidence", "worth"), [(0.5, 0.5), (0.0, MIN_CONFIDENCE)])
def test_confidence_becomes_weight_up_to_the_poles_and_never_nothing(name, confidence, worth):
    sure = np.full((16, 32), confidence, np.float32)
    renderer = make_renderer(name, picture(32, 64), None, smooth(16, 32), sure, (64, 128), WHOLE)
    inverse_depth, colour = seen(renderer, Pose.identity())
    np.testing.assert_allclose(colour[inverse_depth >= 0.0, 3], worth, rtol=1e-4)


def test_a_simplified_mesh_trusts_its_poles_as_little_as_what_is_beside_them():
    sure = np.full((16, 32), 0.5, np.float32)
    path_end = np.array([0.1, 0.0, 0.0])
    renderer = make_renderer("mesh", picture(32, 64), None, smooth(16, 32), sure, (64, 128), WHOLE, path_end=path_end)
    np.testing.assert_allclose(renderer(Pose.identity()).colour[..., 3], 0.5, rtol=1e-4)


@everywhere
@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_nothing(name, threads):
    scene = (picture(16, 32), None, rough(16, 32), None, (24, 48), Cut())
    one, many = (seen(make_renderer(name, *scene, n), random_pose(62, 0.8)) for n in (1, threads))
    np.testing.assert_array_equal(many[0], one[0])
    np.testing.assert_array_equal(many[1], one[1])


@everywhere
def test_a_view_does_not_depend_on_the_one_before(name):
    renderer = make_renderer(name, picture(16, 32), None, rough(16, 32), None, (24, 48))
    pose = moved(0.3, 0.1, -0.4)
    first = [buffer.copy() for buffer in seen(renderer, pose)]
    renderer(random_pose(63, 2.0))
    for before, again in zip(first, seen(renderer, pose), strict=True):
        np.testing.assert_array_equal(again, before)
