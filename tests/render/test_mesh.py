"""Meshes: faces tile the sphere, quads are cut at steps, masks stay; and what is trusted of them."""

import math
import tracemalloc

import numpy as np
import pytest
from render_samples import CUTS, WHOLE, rough, shade, smooth

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render import mesh as mesh_module
from omnisyn_cli.render.mesh import Cut, build_mesh, mask_of_vertices
from omnisyn_cli.render.quad_blocks import CUT_EDGES, FACES_PER_QUAD, FACES_PER_QUARTER
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

SHAPES = [(2, 2), (2, 5), (4, 8), (9, 14)]


def solid_angle(triangle: np.ndarray) -> float:
    """Signed, of a triangle of vectors of any length (Van Oosterom and Strackee)."""
    a, b, c = triangle / np.linalg.norm(triangle, axis=-1, keepdims=True)
    return 2.0 * math.atan2(a @ np.cross(b, c), 1 + a @ b + b @ c + c @ a)


@pytest.mark.parametrize("shape", SHAPES[1:])
@pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
def test_the_faces_tile_the_sphere_once(shape, cut):
    triangles = build_mesh(rough(*shape), cut).triangles()
    areas = np.array([solid_angle(face) for face in triangles.direction])
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(4 * math.pi)


def test_a_whole_mesh_has_two_faces_per_quad_and_a_cap_triangle_per_column():
    assert len(build_mesh(smooth(6, 10), WHOLE).triangles().face) == 2 * 5 * 10 + 2 * 10


def test_faces_are_numbered_in_ascending_order_without_repetition():
    faces = build_mesh(rough(8, 12)).triangles().face
    assert (np.diff(faces) > 0).all()
    assert faces.max() < FACES_PER_QUAD * 7 * 12 + 2 * 2 * 12


@pytest.mark.parametrize("masked", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
def test_faces_are_counted_without_being_made(cut, masked):
    """Whole, quartered and removed quads, quarters without a surface, and caps with and without one."""
    mesh = build_mesh(rough(9, 14), cut, np.random.default_rng(2).random((9, 14)) >= masked)
    assert mesh.face_count() == len(mesh.triangles().face)


@pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
def test_each_corner_of_a_quad_keeps_the_inverse_depth_of_its_pixel(cut):
    rho = rough(6, 12)
    triangles = build_mesh(rho, cut).triangles()
    is_quad = triangles.face < FACES_PER_QUAD * 5 * 12
    points, values = triangles.direction[is_quad].reshape(-1, 3), triangles.inverse_depth[is_quad].reshape(-1)
    for direction, inverse_depth in zip(pixel_directions(6, 12).reshape(-1, 3), rho.ravel(), strict=True):
        at = np.linalg.norm(points - direction, axis=-1) < 1e-9
        assert at.any()
        np.testing.assert_allclose(values[at], inverse_depth, rtol=1e-6)


@pytest.mark.parametrize("some", [1, 5, 16, 10_000])
def test_blocks_are_the_same_however_many_pieces_are_made_at_a_time(monkeypatch, some):
    expected = build_mesh(rough(9, 14), Cut()).blocks
    monkeypatch.setattr(mesh_module, "CUT_QUADS_AT_A_TIME", some)
    for found, wanted in zip(build_mesh(rough(9, 14), Cut()).blocks, expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


def test_blocks_of_a_heavily_cut_mesh_take_little_more_memory_than_they_keep():
    mesh = build_mesh(np.where(np.random.default_rng(0).random((256, 512)) < 0.25, 1.0, 0.3), Cut())
    tracemalloc.start()
    kept = sum(array.nbytes for array in mesh.blocks)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(mesh.cut_quads) > 0.5 * mesh.quads.size
    assert peak < 1.4 * kept


def test_a_cut_quad_never_mixes_surfaces():
    """Between 1 m and 10 m no corner of a face lies anywhere else than at 1 m or 10 m."""
    rho = np.where(np.random.default_rng(0).random((12, 24)) > 0.5, 1.0, 0.1).astype(np.float32)
    found = build_mesh(rho).triangles().inverse_depth
    assert np.isclose(found, 1.0).sum() + np.isclose(found, 0.1).sum() == found.size


@pytest.mark.parametrize(
    ("row", "cut", "is_cut"),
    [
        ((1.0, 0.96, 0.90, 0.90), Cut(relative=0.05), [False, True, False, True]),
        ((1 / 3, 1 / 4.9, 1 / 7.1, 1 / 5.2), Cut(relative=None, metres=2.0), [False, True, False, True]),
        ((0.0, 0.0, 0.01, 0.01), Cut(), [False, True, False, True]),
        ((1.0, 1.0, 1.0, 0.5), Cut(), [False, False, True, True]),
        ((1.0, 0.1, 0.0, 0.5), WHOLE, [False] * 4),
    ],
    ids=["steps against the nearer vertex", "the paper's metres", "steps to infinity", "columns wrap", "no criterion"],
)
def test_quads_are_cut_where_steps_are_large(row, cut, is_cut):
    """Of two equal rows of inverse depths."""
    assert [bool(code & CUT_EDGES) for code in build_mesh(np.array([row, row], np.float32), cut).quads[0]] == is_cut


@pytest.mark.parametrize("size", [(3, 4), (4, 8), (5, 7), (6, 8), (12, 16), (9, 20)])
def test_a_mask_of_vertices_loses_no_usable_pixel(size):
    for row, col in np.ndindex(6, 8):
        mask = np.zeros((6, 8), bool)
        mask[row, col] = True
        found = mask_of_vertices(mask, size)
        assert found.shape == size
        assert found.any() or size[0] > 6 or size[1] > 8
        assert size != mask.shape or (found == mask).all()
    assert mask_of_vertices(None, size) is None


@pytest.mark.parametrize(
    ("rho", "message"),
    [
        (np.ones((1, 4)), "at least 2×2"), (np.ones(4), "at least 2×2"), (np.full((4, 8), np.nan), "finite"),
        (np.full((4, 8), np.inf), "finite"), (np.full((4, 8), -0.1), ">= 0"),
    ],
)  # fmt: skip
def test_inverse_depths_that_are_none_are_refused(rho, message):
    with pytest.raises(ValueError, match=message):
        build_mesh(rho)


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
    before, behind = np.float32([CUT_QUAD_CONFIDENCE, FAR_BEHIND_CUT_CONFIDENCE])
    for quad, quarters in ((4, [before, behind] * 2), (9, [behind, before] * 2), (13, [before, behind] * 2)):
        np.testing.assert_allclose(mesh.surface_confidence[:, quad], [quarters] * 7)
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
