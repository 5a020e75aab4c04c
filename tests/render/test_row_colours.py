"""Colours made where they are asked for are those of the whole picture, and so are those of samples of 8 bits."""

import numpy as np
import pytest
from render_samples import make_renderer, random_pose, rough

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.render.renderer import MeshRenderer, RendererInputs
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture

SIZE = (40, 80)


def renderer(image: np.ndarray, threads: int = 1) -> MeshRenderer:
    surface_confidence = np.random.default_rng(3).uniform(0.2, 1.0, (16, 32))
    return MeshRenderer(RendererInputs(image, None, rough(16, 32), surface_confidence, SIZE, None, threads))


def samples(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(4).integers(0, 256, (height, width, 3), np.uint8)


@pytest.mark.parametrize("name", RENDERERS)
def test_rows_and_crossings_are_those_of_the_whole(name: str) -> None:
    surface_confidence = np.random.default_rng(3).uniform(0.2, 1.0, (16, 32))
    draw = make_renderer(
        name, np.float32(samples(64, 128) / 255), None, rough(16, 32), surface_confidence, SIZE, None, 2
    )
    pose = random_pose(60, 0.4)
    seen = draw(pose)
    assert seen.target_from_source is pose
    colour, out = seen.colour, np.full((7, SIZE[1], 4), np.nan, np.float32)
    for top in (0, 11, 33):
        seen.colour_rows(top, top + 7, out)
        np.testing.assert_allclose(out, colour[top : top + 7], atol=1e-6)
    which = np.array([0, 3, 4, 39]), np.array([1, 2, 50, 79])
    np.testing.assert_allclose(seen.subsampled_colours(*which), colour[np.ix_(*which)], atol=1e-6)


def test_colours_on_demand_are_those_of_the_whole_shader() -> None:
    draw, pose = renderer(samples(64, 128)), random_pose(60, 0.4)
    seen, shader = draw(pose), Shader(SIZE, 2)
    np.testing.assert_allclose(
        seen.colour, shader(seen.inverse_depth, draw._confidence_map, draw._texture, pose), atol=1e-6
    )


@pytest.mark.parametrize("height", [20, 40, 64, 90, 160])
def test_samples_of_eight_bits_look_like_the_numbers_they_stand_for(height: int) -> None:
    """Magnified, as they are and minified: mip levels are rounded by half a level each, places between texels too."""
    image, pose = samples(height, 2 * height), random_pose(61, 0.3)
    exact, rounded = (renderer(each)(pose).colour for each in (np.float32(image / 255.0), image))
    np.testing.assert_allclose(rounded, exact, atol=0.51 / 255)
    if height <= SIZE[0] // 2:
        np.testing.assert_allclose(rounded, exact, atol=0.3 / 255)
        np.testing.assert_allclose(rounded.mean(), exact.mean(), atol=0.01 / 255)


def test_an_alpha_of_samples_is_that_of_numbers() -> None:
    mask = np.random.default_rng(5).random((64, 128)) > 0.3
    image = samples(64, 128)
    whole, small = make_texture(np.float32(image / 255.0), mask), make_texture(image, mask)
    np.testing.assert_allclose(small.texels / 255.0, whole.texels, atol=0.51 / 255)
    assert small.texels.nbytes * 4 == whole.texels.nbytes


def test_rows_that_are_infinitely_far_are_those_of_the_whole_sphere() -> None:
    shader, texture = Shader(SIZE, 1), make_texture(samples(30, 60))
    turn = Pose(random_pose(62, 0.0).rotation, np.zeros(3))
    whole = shader.shade_at_infinity(texture, turn)
    np.testing.assert_allclose(shader.rows_at_infinity(texture, turn, 5, 17), whole[5:17], atol=1e-6)
