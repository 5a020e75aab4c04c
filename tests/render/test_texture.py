"""What a photograph is made into before it is looked up."""

import numpy as np
import pytest
from render_samples import noise

from omnisyn_cli.render.texture import make_texture


def test_the_first_level_is_the_image_with_a_wrapped_border():
    image = noise(8, 16)
    texture = make_texture(image)
    level = texture.texels[: 12 * 20 * 4].reshape(12, 20, 4)
    np.testing.assert_array_equal(level[2:-2, 2:-2, :3], image)
    np.testing.assert_array_equal(level[2:-2, 1, :3], image[:, -1])
    np.testing.assert_array_equal(level[2:-2, -2, :3], image[:, 0])
    np.testing.assert_array_equal(level[1, 2:-2, :3], np.roll(image[0], 8, axis=0))
    np.testing.assert_array_equal(level[-1, 2:-2, :3], np.roll(image[-2], 8, axis=0))


@pytest.mark.parametrize(("shape", "levels"), [((64, 128), 4), ((8, 16), 1), ((9, 18), 2), ((20, 40), 3), ((2, 4), 1)])
def test_levels_end_at_eight_rows(shape, levels):
    assert len(make_texture(noise(*shape)).layout) == levels
