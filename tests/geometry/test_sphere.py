import math

import numpy as np
import pytest
import torch
from geometry_samples import POLES, directions

from omnisyn_cli.geometry import sphere

SIZES = [(1, 2), (2, 4), (3, 5), (8, 16), (64, 128), (31, 7)]


def test_axes_are_where_the_convention_puts_them():
    expected = {"centre": (0, 0.5, [0, 0, -1]), "right": (0.5, 0.5, [1, 0, 0]), "up": (0, 0, [0, 1, 0])}
    for azimuth, polar_angle, direction in expected.values():
        found = sphere.angles_to_direction(np.float64(azimuth * math.pi), np.float64(polar_angle * math.pi))
        np.testing.assert_allclose(found, direction, atol=1e-15)


def test_pixel_centres_lie_half_a_pixel_inside_the_image():
    azimuth, polar_angle = sphere.pixel_to_angles(np.array([0.0, 7.0]), np.array([0.0, 15.0]), (8, 16))
    np.testing.assert_allclose(azimuth, [-math.pi + math.pi / 16, math.pi - math.pi / 16])
    np.testing.assert_allclose(polar_angle, [math.pi / 16, math.pi - math.pi / 16])


@pytest.mark.parametrize("size", SIZES)
def test_every_pixel_survives_the_way_to_directions_and_back(size):
    row, col = sphere.direction_to_pixel(sphere.pixel_directions(*size), size)
    expected_row, expected_col = np.mgrid[: size[0], : size[1]]
    np.testing.assert_allclose(row, expected_row, atol=1e-9)
    np.testing.assert_allclose(col, expected_col, atol=1e-9)


@pytest.mark.parametrize(("length", "tolerance"), [(1.0, 1e-15), (1e-6, 1e-14), (3.0, 1e-14), (1e6, 1e-14)])
def test_every_direction_survives_the_way_to_angles_and_back_even_at_the_singularities(length, tolerance):
    found = sphere.angles_to_direction(*sphere.direction_to_angles(length * directions()))
    np.testing.assert_allclose(found, directions(), atol=tolerance)


def test_the_polar_angle_keeps_its_digits_at_the_poles():
    angle = np.array([1e-12, 1e-9, 1e-3])
    np.testing.assert_allclose(
        sphere.direction_to_angles(sphere.angles_to_direction(0.3 + 0 * angle, angle))[1], angle, rtol=1e-12
    )
    assert (sphere.direction_to_angles(POLES)[1] == [0.0, math.pi]).all()


@pytest.mark.parametrize("size", SIZES)
def test_tables_and_scales_for_kernels_say_the_same_as_the_formulas(size):
    sin_polar, cos_polar, sin_azimuth, cos_azimuth = sphere.direction_tables(*size)
    x, z = sin_polar[:, None] * sin_azimuth, -sin_polar[:, None] * cos_azimuth
    y = np.broadcast_to(cos_polar[:, None], x.shape)
    np.testing.assert_allclose(np.stack([x, y, z], -1), sphere.pixel_directions(*size), atol=1e-15)
    row_scale, row_offset, col_scale, col_offset = sphere.pixel_scale(size)
    row, col = sphere.angles_to_pixel(1.3, 0.7, size)
    assert (0.7 * row_scale + row_offset, 1.3 * col_scale + col_offset) == pytest.approx((row, col))


@pytest.mark.parametrize("size", SIZES)
def test_solid_angles_sum_to_the_whole_sphere(size):
    weights = sphere.solid_angles(*size)
    assert weights.shape == size
    assert weights.sum() == pytest.approx(4 * math.pi)
    assert (weights > 0).all()


def test_the_mean_over_the_sphere_is_that_of_solid_angles():
    image = np.random.default_rng(5).random((64, 128, 3))
    assert sphere.mean_over_sphere(image) == pytest.approx(
        np.average(image.mean(axis=2), weights=sphere.solid_angles(64, 128)), rel=1e-3
    )
    image[:4] = 1e3
    assert sphere.mean_over_sphere(image) < image.mean() / 5  # rows at a pole are small


def test_solid_angles_are_those_of_random_points_on_the_sphere():
    vectors = sphere.normalize(np.random.default_rng(3).normal(size=(200_000, 3)))
    row, col = sphere.direction_to_pixel(vectors, (4, 6))
    counts = np.histogram2d(row, col, bins=(np.arange(5) - 0.5, np.arange(7) - 0.5))[0]
    np.testing.assert_allclose(counts / 200_000 * 4 * math.pi, sphere.solid_angles(4, 6), rtol=0.05)


def test_normalize_leaves_the_zero_vector_with_a_finite_gradient():
    vector = torch.tensor([[0.0, 0.0, 0.0], [3.0, 0.0, 4.0]], requires_grad=True)
    unit = sphere.normalize(vector)
    unit.sum().backward()
    assert unit.tolist() == [[0.0, 0.0, 0.0], pytest.approx([0.6, 0.0, 0.8])]
    assert torch.isfinite(vector.grad).all()


class TestLinearisedArccos:
    def test_equals_arccos_away_from_the_poles(self):
        cosine = np.cos(np.linspace(sphere.LINEARISED_CAP, math.pi - sphere.LINEARISED_CAP, 101))
        np.testing.assert_allclose(sphere.linearised_arccos(cosine), np.arccos(cosine), atol=1e-12)

    def test_is_exact_at_the_poles_and_symmetric(self):
        assert sphere.linearised_arccos(np.array([1.0, 0.0, -1.0])) == pytest.approx([0.0, math.pi / 2, math.pi])
        cosine = np.linspace(-1, 1, 501)
        np.testing.assert_allclose(
            sphere.linearised_arccos(-cosine), math.pi - sphere.linearised_arccos(cosine), atol=1e-12
        )

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_is_continuous_where_the_line_begins(self, sign):
        edge = sign * math.cos(sphere.LINEARISED_CAP)
        left, right = sphere.linearised_arccos(np.array([edge - 1e-12, edge + 1e-12]))
        assert left == pytest.approx(right, abs=1e-9)

    def test_gradient_is_bounded_and_always_negative(self):
        cosine = torch.cat([torch.linspace(-1.1, 1.1, 2001, dtype=torch.float64), torch.tensor([-1.0, 1.0])])
        cosine.requires_grad_()
        sphere.linearised_arccos(cosine).sum().backward()
        steepest = 1.0 / math.sin(sphere.LINEARISED_CAP) * 2.0
        assert ((cosine.grad < 0) & (cosine.grad > -steepest)).all()


def test_numpy_and_torch_agree():
    row, col = np.linspace(-1, 9, 11), np.linspace(-3, 20, 11)
    for function, *values in (
        (sphere.direction_to_angles, directions()), (sphere.normalize, directions()),
        (lambda *places: sphere.pixel_to_direction(*places, (8, 16)), row, col),
        (sphere.linearised_arccos, np.linspace(-1, 1, 101)),
    ):  # fmt: skip
        found = function(*map(torch.from_numpy, values))
        np.testing.assert_allclose(np.stack(list(found)), np.asarray(function(*values)), atol=1e-15)
