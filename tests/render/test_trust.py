import numpy as np
import pytest
from render_samples import rough

from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.quads import CUT_EDGES
from omnisyn_cli.render.trust import AT_CUTS, AT_RIMS, FAR_BEHIND, LEAST, REACH, trust_of_quads


def whole(height, width):
    return np.zeros((height - 1, width), bool)


def test_is_the_least_confidence_of_the_corners_and_never_zero():
    confidence = np.ones((4, 6), np.float32)
    confidence[1, 2], confidence[3, 5] = 0.5, 0.0
    expected = np.ones((3, 6))
    expected[:2, 1:3], expected[2, 4:6] = 0.5, LEAST
    np.testing.assert_allclose(trust_of_quads(np.ones((4, 6)), whole(4, 6), confidence), expected)


def test_is_little_where_the_mesh_is_cut():
    mesh = build_mesh(rough(8, 16))
    np.testing.assert_allclose(mesh.trust[(mesh.quads & CUT_EDGES) != 0], AT_CUTS)


@pytest.mark.parametrize("times", [0.98 * FAR_BEHIND, 1.02 * FAR_BEHIND, np.inf])
@pytest.mark.parametrize(("row", "col"), [(20, 30), (20, 1), (20, 59), (0, 30), (39, 30), (2, 58)])
def test_a_rim_lies_around_what_is_much_nearer_across_the_seam_but_not_beyond_the_poles(row, col, times):
    rho = np.full((40, 60), 1.0 / times, np.float32)
    rho[row, col] = 1.0
    rows, cols = np.mgrid[:40, :60]
    apart = np.maximum(abs(rows - row), np.minimum((cols - col) % 60, (col - cols) % 60))
    is_rim = (apart <= REACH) & (apart > 0) & (times > FAR_BEHIND)
    corners = [is_rim[:-1], is_rim[1:], np.roll(is_rim, -1, axis=1)[:-1], np.roll(is_rim, -1, axis=1)[1:]]
    expected = np.where(np.any(corners, axis=0), np.float32(AT_RIMS), np.float32(1.0))
    np.testing.assert_array_equal(trust_of_quads(rho, whole(40, 60)), expected)


def test_masked_vertices_are_before_nothing():
    rho = np.full((12, 16), 0.2, np.float32)
    mask = np.ones(rho.shape, bool)
    rho[6, 8], mask[6, 8] = 5.0, False
    mesh = build_mesh(rho, mask=mask)
    assert (mesh.trust[(mesh.quads & CUT_EDGES) == 0] == 1.0).all()
