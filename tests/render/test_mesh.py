import math
import tracemalloc

import numpy as np
import pytest
from render_samples import CUTS, WHOLE, rough, smooth

from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render import mesh as mesh_module
from omnisyn_cli.render.mesh import Cut, build_mesh, mask_of_vertices
from omnisyn_cli.render.quad_blocks import CUT_EDGES, FACES_PER_QUAD

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


class TestCuts:
    def ring(self, *values: float) -> np.ndarray:
        """Two equal rows of the given inverse depths."""
        return np.array([values, values], np.float32)

    def cut_between(self, rho: np.ndarray, cut: Cut) -> list[bool]:
        return [bool(code & CUT_EDGES) for code in build_mesh(rho, cut).quads[0]]

    def test_relative_steps_are_measured_against_the_nearer_vertex(self):
        rho = self.ring(1.0, 0.96, 0.90, 0.90)
        assert self.cut_between(rho, Cut(relative=0.05)) == [False, True, False, True]

    def test_steps_in_metres_are_the_paper_s(self):
        rho = self.ring(1 / 3, 1 / 4.9, 1 / 7.1, 1 / 5.2)
        assert self.cut_between(rho, Cut(relative=None, metres=2.0)) == [False, True, False, True]

    def test_a_step_to_infinity_is_cut_and_infinity_itself_is_not(self):
        assert self.cut_between(self.ring(0.0, 0.0, 0.01, 0.01), Cut()) == [False, True, False, True]

    def test_columns_wrap(self):
        assert self.cut_between(self.ring(1.0, 1.0, 1.0, 0.5), Cut()) == [False, False, True, True]

    def test_no_criterion_cuts_nothing(self):
        assert not (build_mesh(rough(8, 16), WHOLE).quads & CUT_EDGES).any()


class TestMaskOfVertices:
    def test_keeps_a_mask_of_the_same_size(self):
        mask = np.random.default_rng(1).random((6, 8)) > 0.5
        np.testing.assert_array_equal(mask_of_vertices(mask, (6, 8)), mask)

    @pytest.mark.parametrize("size", [(3, 4), (4, 8), (5, 7), (12, 16), (9, 20)])
    def test_loses_no_usable_pixel(self, size):
        for row, col in np.ndindex(6, 8):
            mask = np.zeros((6, 8), bool)
            mask[row, col] = True
            found = mask_of_vertices(mask, size)
            assert found.shape == size
            if size[0] <= 6 and size[1] <= 8:
                assert found.sum() >= 1

    def test_no_mask_is_no_mask(self):
        assert mask_of_vertices(None, (4, 8)) is None


@pytest.mark.parametrize(
    ("rho", "message"),
    [
        (np.ones((1, 4)), "at least 2×2"),
        (np.ones(4), "at least 2×2"),
        (np.full((4, 8), np.nan), "finite"),
        (np.full((4, 8), np.inf), "finite"),
        (np.full((4, 8), -0.1), ">= 0"),
    ],
)
def test_inverse_depths_that_are_none_are_refused(rho, message):
    with pytest.raises(ValueError, match=message):
        build_mesh(rho)
