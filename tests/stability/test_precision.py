"""Single against double precision in geometry and renderer, and gradients that keep their sign at singularities."""

import numpy as np
import pytest
import torch
from numpy.typing import DTypeLike

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import direction_to_angles, linearised_arccos, pixel_directions
from omnisyn_cli.geometry.sweep import inverse_depth_from_parallax, parallax_from_inverse_depth
from omnisyn_cli.render.mesh import Cut, build_mesh
from omnisyn_cli.render.rasterize import rasterize
from omnisyn_cli.render.rasterize_torch import render_fragments
from reference_rasterizer import rasterize_reference
from render.render_samples import sphere

TOLERANCE = 1e-5  # Of inverse depth, relative.
# Around the epipoles parallax vanishes and says nothing about depth: 2° amplify rounding 30 times.
NEAR_EPIPOLE = np.radians(2.0)


@pytest.mark.parametrize("seed", range(4))
def test_the_renderer_in_single_precision_is_right_to_a_hundred_thousandth(seed: int) -> None:
    """A surface that fills the view has no silhouettes: every pixel of every target agrees with double precision."""
    rng = np.random.default_rng(seed)
    rho = sphere(rng.uniform(-0.3, 0.3, 3), 1.0, pixel_directions(12, 24)).astype(np.float32)
    pose = Pose(rotation_from_rotation_vector(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
    mesh = build_mesh(rho, Cut(relative=None))
    found = rasterize(mesh, pose, (32, 64))
    expected = rasterize_reference(mesh.triangles(), pose, (32, 64))
    seen = expected.visibility & found.visibility
    assert seen.mean() > 0.999
    np.testing.assert_allclose(found.inverse_depth[seen], expected.inverse_depth[seen], rtol=TOLERANCE)


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_the_renderer_is_as_exact_in_any_unit(factor: float) -> None:
    """Micrometres and thousands of kilometres: the unit changes nothing but the exponent."""
    rho = sphere(np.array([0.2, -0.1, 0.25]), 1.0, pixel_directions(12, 24))
    pose = Pose(rotation_from_rotation_vector(np.array([0.3, -0.7, 0.2])), np.array([0.2, 0.1, -0.3]))
    plain = rasterize(build_mesh(rho.astype(np.float32), Cut(relative=None)), pose, (32, 64)).inverse_depth
    scaled = Pose(pose.rotation, pose.position * factor)
    mesh = build_mesh((rho / factor).astype(np.float32), Cut(relative=None))
    np.testing.assert_allclose(rasterize(mesh, scaled, (32, 64)).inverse_depth * factor, plain, rtol=TOLERANCE)


def test_geometry_in_single_precision_is_right_to_a_few_roundings() -> None:
    """Angles of directions everywhere on the sphere, seam and poles included."""
    directions = pixel_directions(64, 128)
    for single, double in zip(
        direction_to_angles(directions.astype(np.float32)), direction_to_angles(directions), strict=True
    ):
        np.testing.assert_allclose(single, double, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_inverse_depth_survives_the_way_over_parallax_but_for_the_epipoles(dtype: DTypeLike) -> None:
    """ρ → parallax → ρ within 1e-5 at least 2° from the epipoles; nearer it stays finite and not negative."""
    polar = np.linspace(1e-4, np.pi - 1e-4, 400, dtype=dtype)[:, None]
    rho = np.geomspace(0.05, 0.9, 50, dtype=dtype)[None]
    back = inverse_depth_from_parallax(polar, parallax_from_inverse_depth(polar, rho))
    away = (polar[:, 0] > NEAR_EPIPOLE) & (polar[:, 0] < np.pi - NEAR_EPIPOLE)
    np.testing.assert_allclose(back[away], np.broadcast_to(rho, back.shape)[away], rtol=TOLERANCE)
    assert np.isfinite(back).all()
    assert (back >= 0).all()


PIXELS = {
    "zenith": (0, 5), "nadir": (15, 20), "seam, left": (8, 0), "seam, right": (7, 31), "forward epipole": (7, 16),
    "backward epipole": (8, 0), "anywhere": (5, 9),
}  # fmt: skip


def inverse_depth_seen(rho: torch.Tensor, pose: Pose) -> torch.Tensor:
    """At the size of a panorama, from elsewhere."""
    mesh, colour = build_mesh(rho.detach().numpy()), torch.rand(16, 32, 3, dtype=torch.float64)
    return render_fragments(rasterize(mesh, pose, (16, 32)), mesh, rho, colour, pose).inverse_depth


@pytest.mark.parametrize("place", PIXELS)
@pytest.mark.parametrize("motion", [(0.0, 0.0, 0.4), (0.0, 0.4, 0.0), (0.3, -0.2, 0.1)])
def test_a_nearer_world_looks_nearer_everywhere(place: str, motion: tuple[float, float, float]) -> None:
    """In a ball that shrinks every inverse depth grows: its gradient is finite and positive at epipoles and seam too.

    At the poles it is never negative: whoever moves towards one looks into a cap, whose depth is that of no pixel.
    """
    nearness = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
    pose = Pose(rotation_from_rotation_vector(np.array([0.0, 0.2, 0.0])), np.array(motion))
    seen = inverse_depth_seen(nearness.expand(16, 32), pose)
    seen[PIXELS[place]].backward()
    assert (0.0 if place in ("zenith", "nadir") else 0.2) <= float(nearness.grad) < 20


def test_gradients_do_not_jump_where_silhouettes_are() -> None:
    """A near ball before a far wall: raising its inverse depth raises what is seen of it, and nothing else falls."""
    directions = pixel_directions(16, 32)
    is_near = directions @ np.array([0.0, 0.0, -1.0]) > np.cos(0.6)
    near = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    rho = torch.where(torch.from_numpy(is_near), near, torch.tensor(0.2, dtype=torch.float64))
    seen = inverse_depth_seen(rho, Pose(np.eye(3), np.array([0.3, 0.1, 0.2])))
    found = [torch.autograd.grad(seen[row, col], near, retain_graph=True)[0] for row in range(16) for col in range(32)]
    gradients = torch.stack(found)
    assert torch.isfinite(gradients).all()
    assert (gradients > -1e-9).all()
    assert (gradients > 0.1).sum() > 20


def test_the_linearised_arccos_keeps_sign_and_bound_through_both_poles() -> None:
    cosine = torch.linspace(-1, 1, 4001, dtype=torch.float64, requires_grad=True)
    linearised_arccos(cosine).sum().backward()
    assert torch.isfinite(cosine.grad).all()
    assert (cosine.grad < 0).all()
    cap = np.radians(10)
    assert float(cosine.grad.abs().max()) == pytest.approx(cap / (1 - np.cos(cap)))
