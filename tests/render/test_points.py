"""Point cloud rendering: the photograph from its own place, what is near in front, holes where points come apart."""

import numpy as np

from omnisyn_cli.baselines.points import PointRenderer
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.renderer import RendererInputs

SIZE = (64, 128)


def seen(rho: np.ndarray, position: tuple[float, float, float], mask: np.ndarray | None = None) -> np.ndarray:
    """Red is the pixel's inverse depth, so that it says which point is seen; then confidence and inverse depth."""
    image = np.zeros((*SIZE, 3), np.float32)
    image[..., 0] = rho
    layer = PointRenderer(RendererInputs(image, mask, rho, None, SIZE))(Pose(np.eye(3), np.array(position)))
    return np.concatenate([layer.colour, layer.inverse_depth[..., None]], axis=-1)


def test_from_its_own_place_a_panorama_is_what_it_was() -> None:
    rho = np.random.default_rng(5).uniform(0.3, 0.31, SIZE).astype(np.float32)
    found = seen(rho, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(found[24:40, :, 0], rho[24:40], atol=0.01)
    np.testing.assert_allclose(found[..., 4], rho, atol=0.01)
    assert (found[..., 3] > 0.99).all()


def test_what_is_near_hides_what_is_far() -> None:
    rho = np.full(SIZE, 0.1, np.float32)
    rho[24:40, 56:72] = 1.0
    found = seen(rho, (0.3, 0.0, 0.0))  # the points move to the right, those nearby further
    np.testing.assert_allclose(found[30:34, 66:72, 0], 1.0, atol=0.1)
    np.testing.assert_allclose(found[30:34, 20:40, 0], 0.1, atol=0.01)


def test_points_come_apart_where_the_camera_comes_closer_and_masked_ones_are_none() -> None:
    rho = np.full(SIZE, 0.5, np.float32)
    closer = seen(rho, (0.0, 0.0, 1.6))  # a fifth of the radius is left ahead
    assert (closer[24:40, 56:72, 4] < 0.0).mean() > 0.3
    assert (closer[closer[..., 4] < 0.0][:, :4] == 0.0).all()
    mask = np.ones(SIZE, bool)
    mask[:, :64] = False
    assert (seen(rho, (0.0, 0.0, 0.0), mask)[8:56, 4:58, 3] == 0.0).all()
