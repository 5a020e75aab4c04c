import numpy as np
import pytest
from render_samples import rough, shade

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.quad_blocks import CUT_EDGES, FACES_PER_QUARTER
from omnisyn_cli.render.rasterize import rasterize
from omnisyn_cli.render.surface_confidence import (
    BEHIND_CUT_CONFIDENCE,
    BEHIND_RATIO,
    BEHIND_RIM_CONFIDENCE,
    CUT_QUAD_CONFIDENCE,
    FAR_BEHIND_CUT_CONFIDENCE,
    FAR_BEHIND_RATIO,
    FAR_BEHIND_RIM_CONFIDENCE,
    FAR_RIM_VERTICES,
    MIN_CONFIDENCE,
    quarter_confidence,
)
from omnisyn_cli.render.texture import make_texture


def whole(height, width):
    return np.zeros((height - 1, width), bool)


def test_is_the_least_confidence_of_the_corners_and_never_zero():
    confidence = np.ones((4, 6), np.float32)
    confidence[1, 2], confidence[3, 5] = 0.5, 0.0
    expected = np.ones((3, 6, 4))
    expected[:2, 1:3], expected[2, 4:6] = 0.5, MIN_CONFIDENCE
    np.testing.assert_allclose(quarter_confidence(np.ones((4, 6)), whole(4, 6), confidence), expected)
    nothing = quarter_confidence(rough(8, 16), ~whole(8, 16), np.zeros((8, 16)))
    assert nothing.min() >= MIN_CONFIDENCE


def test_is_little_where_the_mesh_is_cut_and_less_far_behind_the_cut():
    rho = np.full((8, 16), 0.1, np.float32)
    rho[:, 5:10] = 0.09
    rho[:, 10:14] = 1.0
    mesh = build_mesh(rho)
    assert (mesh.quads[:, [4, 9, 13, 15]] & CUT_EDGES == [5, 5, 5, 0]).all()
    np.testing.assert_allclose(
        mesh.surface_confidence[:, 4], [np.float32([FAR_BEHIND_CUT_CONFIDENCE, CUT_QUAD_CONFIDENCE])[[1, 0, 1, 0]]] * 7
    )
    np.testing.assert_allclose(
        mesh.surface_confidence[:, 9], [np.float32([FAR_BEHIND_CUT_CONFIDENCE, CUT_QUAD_CONFIDENCE])[[0, 1, 0, 1]]] * 7
    )
    np.testing.assert_allclose(
        mesh.surface_confidence[:, 13], [np.float32([CUT_QUAD_CONFIDENCE, FAR_BEHIND_CUT_CONFIDENCE])[[0, 1, 0, 1]]] * 7
    )
    np.testing.assert_allclose(mesh.surface_confidence[:, 11], 1.0)


def test_a_little_behind_a_cut_one_quad_counts_for_less():
    """Across the seam as well; closer behind than that, and in front, nothing but the cut itself does."""
    for times, beside, behind in (
        (1.02 * BEHIND_RATIO, BEHIND_RIM_CONFIDENCE, BEHIND_CUT_CONFIDENCE),
        (0.98 * BEHIND_RATIO, 1.0, CUT_QUAD_CONFIDENCE),
    ):
        rho = np.full((4, 16), 1.0 / times, np.float32)
        rho[:, 0:8] = 1.0
        surface_confidence = build_mesh(rho).surface_confidence[1]
        np.testing.assert_allclose(
            surface_confidence[[7, 15]],
            np.float32([[CUT_QUAD_CONFIDENCE, behind] * 2, [behind, CUT_QUAD_CONFIDENCE] * 2]),
        )
        np.testing.assert_allclose(surface_confidence[[8, 14]], np.float32(beside))
        np.testing.assert_allclose(surface_confidence[np.r_[0:7, 9:14]], 1.0)


@pytest.mark.parametrize("times", [0.98 * BEHIND_RATIO, 0.98 * FAR_BEHIND_RATIO, 1.02 * FAR_BEHIND_RATIO, np.inf])
@pytest.mark.parametrize(("row", "col"), [(20, 30), (20, 1), (20, 59), (0, 30), (39, 30), (2, 58)])
def test_a_rim_lies_around_what_is_much_nearer_across_the_seam_but_not_beyond_the_poles(row, col, times):
    rho = np.full((40, 60), 1.0 / times, np.float32)
    rho[row, col] = 1.0
    rows, cols = np.mgrid[:40, :60]
    apart = np.maximum(abs(rows - row), np.minimum((cols - col) % 60, (col - cols) % 60))
    expected = np.ones((39, 60), np.float32)
    for reach, least, surface_confidence in (
        (1, BEHIND_RATIO, BEHIND_RIM_CONFIDENCE),
        (FAR_RIM_VERTICES, FAR_BEHIND_RATIO, FAR_BEHIND_RIM_CONFIDENCE),
    ):
        is_rim = (apart <= reach) & (apart > 0) & (times > least)
        corners = [is_rim[:-1], is_rim[1:], np.roll(is_rim, -1, axis=1)[:-1], np.roll(is_rim, -1, axis=1)[1:]]
        expected[np.any(corners, axis=0)] = surface_confidence
    found = quarter_confidence(rho, whole(40, 60))
    np.testing.assert_array_equal(found, np.repeat(expected[..., None], 4, axis=-1))


def test_masked_vertices_are_before_nothing():
    rho = np.full((12, 16), 0.2, np.float32)
    mask = np.ones(rho.shape, bool)
    rho[6, 8], mask[6, 8] = 5.0, False
    mesh = build_mesh(rho, mask=mask)
    assert (mesh.surface_confidence[(mesh.quads & CUT_EDGES) == 0] == 1.0).all()


def test_is_found_by_place_as_by_face():
    """Seen from its own centre, a pixel of a panorama lies in the quarter whose face it shows."""
    mesh, size = build_mesh(rough(12, 24)), (96, 192)
    texture = make_texture(np.ones((*size, 3), np.float32))
    fragments = rasterize(mesh, Pose.identity(), size)
    caps = [mesh.surface_confidence[0, :, :2].min(axis=-1), mesh.surface_confidence[-1, :, 2:].min(axis=-1)]
    by_face = np.concatenate([mesh.surface_confidence.ravel(), *caps]).repeat(FACES_PER_QUARTER)[fragments.face]
    assert len(np.unique(by_face)) > 2
    shown = shade(fragments.inverse_depth, mesh, texture, Pose.identity())
    np.testing.assert_allclose(shown[..., 3], by_face, rtol=1e-5)
