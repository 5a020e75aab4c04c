"""What a panorama says about points, against scenes in which everything is known."""

import numpy as np
import pytest
from render_samples import make_renderer

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.render.reprojection import Reprojector
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture

SIZE = (64, 128)
POSE = Pose(rotation_from_heading(0.7, 0.1, -0.2), np.array([0.3, -0.1, 0.4]))


def picture(size=SIZE):
    """Smooth, so that how it is read between pixels hardly matters."""
    return (0.5 + 0.4 * np.sin(3.0 * pixel_directions(*size) + 0.3)).astype(np.float32)


def towards(points, size=SIZE):
    """Directions in the panorama's frame of points around the target: ``Rᵀ(r − ρ·t)``, not of length 1."""
    away = pixel_directions(*size) - points[..., None] * POSE.position
    return away @ POSE.rotation


def source_sampler(rho=0.2):
    surface = np.full((32, 64), rho)
    return Reprojector(lambda: make_texture(picture()), surface, Shader(SIZE, 1)).sampler(POSE)


@pytest.mark.parametrize("size", [SIZE, (32, 64)])
def test_a_point_has_the_colour_that_the_photograph_shows_in_its_direction(size):
    points = np.random.default_rng(0).uniform(0.0, 1.0, size).astype(np.float32)
    points[3:6, 5:50] = -1.0
    found = source_sampler().sample(points)
    expected = sample_bilinear(picture().astype(float), towards(points, size))
    is_asked = points >= 0
    np.testing.assert_allclose(found[is_asked, :3], expected[is_asked], atol=0.02)
    np.testing.assert_allclose(found[..., 3], is_asked, atol=1e-6)
    assert not found[~is_asked].any()


def test_rows_are_those_of_the_whole():
    points = np.random.default_rng(1).uniform(-0.3, 1.0, SIZE).astype(np.float32)
    asked, out = source_sampler(), np.empty((20, SIZE[1], 4), np.float32)
    asked.sample_rows(points[10:30], 10, out)
    np.testing.assert_array_equal(out, asked.sample(points)[10:30])


def test_a_surface_is_nearer_or_farther_than_points():
    """Of a surface that differs everywhere, written out in NumPy; at the seam and at the poles as well."""
    rng = np.random.default_rng(2)
    surface, points = rng.uniform(0.05, 1.0, (32, 64)), rng.uniform(-0.2, 1.0, SIZE).astype(np.float32)
    asked = Reprojector(lambda: make_texture(picture()), surface, Shader(SIZE, 1)).sampler(POSE)
    found = asked.occlusion(points, 0.1)
    moved = towards(np.maximum(points, 0))
    expected = np.maximum(points, 0) / np.linalg.norm(moved, axis=-1)
    seen = sample_nearest(surface, moved)
    share = (seen - expected) / np.maximum(np.maximum(seen, expected), 0.1)
    assert (np.abs(found - np.where(points >= 0, share, 0)) < 1e-3).mean() > 0.995  # the rest lies between two pixels
    assert not found[points < 0].any()


def test_what_nobody_sees_far_away_does_not_count():
    points = np.zeros(SIZE, np.float32)
    assert np.abs(source_sampler(1e-6).occlusion(points, 1e-3)).max() < 2e-3
    assert source_sampler(1.0).occlusion(points, 1e-3).min() == 1.0


@pytest.mark.parametrize("name", RENDERERS)
def test_every_renderer_can_be_asked(name):
    surface = np.full((32, 64), 0.25)
    shown = make_renderer(name, picture(), None, surface, None, SIZE, threads=1)(POSE)
    points = np.full(SIZE, 0.5, np.float32)
    np.testing.assert_allclose(shown.source_sampler.sample(points), source_sampler().sample(points), atol=1e-6)
    assert np.median(shown.source_sampler.occlusion(shown.inverse_depth, 1e-3)) == pytest.approx(0.0, abs=0.01)
