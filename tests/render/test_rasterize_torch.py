import numpy as np
import pytest
import torch
from render_samples import CUTS, POSES, moved, random_pose, rough, smooth, turn

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_bilinear_at
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import Cut, build_mesh
from omnisyn_cli.render.rasterize import rasterize
from omnisyn_cli.render.rasterize_torch import TorchLayer, _source_pixels, render_fragments


def rasterize_torch(
    rho: torch.Tensor, image: torch.Tensor, pose: Pose, size: tuple[int, int], cut: Cut | None = None
) -> TorchLayer:
    mesh = build_mesh(rho.detach().numpy(), cut)
    return render_fragments(rasterize(mesh, pose, size), mesh, rho, image, pose)


def colours(height: int, width: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(30).random((height, width, 3))).to(dtype)


def untied(rho: np.ndarray) -> np.ndarray:
    """No two values the same: a median and a minimum have no gradient where they are."""
    return np.asarray(rho + 1e-3 * np.random.default_rng(31).random(rho.shape), np.float32)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
@pytest.mark.parametrize("cut", ["whole", "default"])
def test_equals_the_renderer_of_numpy(cut, pose, dtype):
    rho, image, size = rough(8, 16), colours(8, 16, dtype), (23, 46)
    mesh = build_mesh(rho, CUTS[cut])
    fragments = rasterize(mesh, pose, size)
    found = rasterize_torch(torch.from_numpy(rho).to(dtype), image, pose, size, CUTS[cut])
    np.testing.assert_array_equal(found.visibility, fragments.visibility)
    np.testing.assert_allclose(found.inverse_depth, fragments.inverse_depth, rtol=1e-3, atol=1e-5)
    rays = pixel_directions(*size) - fragments.inverse_depth[..., None] * pose.position
    expected = sample_bilinear(image.numpy(), rays @ pose.rotation)
    magnified = fragments.visibility & (np.linalg.norm(rays, axis=-1) > 8 / 23)
    np.testing.assert_allclose(found.colour[magnified], expected[magnified], atol=2e-3)
    assert found.colour.dtype == found.inverse_depth.dtype == dtype


def test_single_precision_does_not_cancel_on_fine_meshes():
    rho, pose = smooth(256, 512), random_pose(31, 0.8)
    single = rasterize_torch(torch.from_numpy(rho), colours(4, 8), pose, (20, 40)).inverse_depth
    double = rasterize_torch(torch.from_numpy(rho).double(), colours(4, 8).double(), pose, (20, 40)).inverse_depth
    np.testing.assert_allclose(single, double, rtol=2e-5)


@pytest.mark.parametrize("cut", ["whole", "default"])
@pytest.mark.parametrize("seed", range(2))
def test_gradients_are_those_of_finite_differences(cut, seed):
    """With the faces fixed, colour and inverse depth of every pixel are smooth in all vertices and texels."""
    rho = torch.from_numpy(0.1 + untied(rough(4, 8, seed))).double().requires_grad_()
    mesh, pose = build_mesh(rho.detach().numpy(), CUTS[cut]), random_pose(seed, 0.6)
    fragments = rasterize(mesh, pose, (5, 9))
    directions = (pixel_directions(5, 9) - fragments.inverse_depth[..., None] * pose.position) @ pose.rotation
    off_poles = np.hypot(directions[..., 0], directions[..., 2]) > np.linalg.norm(directions, axis=-1) * np.pi / 24

    def render(rho: torch.Tensor, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        found = render_fragments(fragments, mesh, rho, image, pose)
        return found.colour[torch.from_numpy(off_poles)], found.inverse_depth

    assert (fragments.visibility & off_poles).mean() > 0.5
    assert torch.autograd.gradcheck(lambda rho: render(rho, colours(24, 48, torch.float64)), rho)
    texels = colours(3, 6, torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda image: render(rho.detach(), image)[0], texels)


def test_the_gradient_of_a_pixel_is_the_change_of_the_numba_renderer():
    """End to end, visibility included: raising all inverse depths raises what the target sees by the same rule."""
    rho, pose, size = smooth(16, 32).astype(np.float64), random_pose(33, 0.5), (12, 24)
    leaf = torch.from_numpy(rho).requires_grad_()
    rasterize_torch(leaf, colours(4, 8).double(), pose, size).inverse_depth.sum().backward()
    step = 1e-3
    above, below = (rasterize(build_mesh(rho + s), pose, size).inverse_depth.sum(dtype=float) for s in (step, -step))
    assert leaf.grad.sum() == pytest.approx((above - below) / (2 * step), rel=2e-2)


SINGULAR = {
    "a pole of the source in the middle of a pixel": (
        np.full((8, 16), 0.3),
        moved(0, 0, 0, rotation=turn(np.pi / 2, 0, 0)),
    ),
    "moving along the axis": (np.full((8, 16), 0.3), moved(0.0, 1.0, 0.0)),
    "silhouettes": (rough(8, 16), moved(0.5, 0.2, 0.9)),
    "all at infinity": (np.zeros((8, 16)), moved(1.0, 2.0, 3.0)),
    "partly at infinity": (rough(8, 16) * (np.arange(16) % 2), moved(0.3, 0.0, 0.0)),
    "on the surface": (np.full((8, 16), 0.5), Pose(np.eye(3), -2.0 * pixel_directions(8, 16)[3, 4])),
    "outside, edge-on": (np.full((8, 16), 0.5), moved(0.0, 0.0, -2.0000001)),
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("case", SINGULAR)
def test_gradients_are_finite_everywhere(case, dtype):
    rho, pose = SINGULAR[case]
    leaf, image = torch.from_numpy(rho).to(dtype).requires_grad_(), colours(8, 16, dtype).requires_grad_()
    for size in ((9, 15), (8, 16)):
        found = rasterize_torch(leaf, image, pose, size)
        (found.colour.square().sum() + found.inverse_depth.square().sum()).backward()
        assert torch.isfinite(found.colour).all()
        assert torch.isfinite(leaf.grad).all()
        assert torch.isfinite(image.grad).all()


def test_what_is_not_seen_gets_no_gradient_and_no_colour():
    rho, image = torch.from_numpy(rough(8, 16)).requires_grad_(), colours(8, 16).requires_grad_()
    found = rasterize_torch(rho, image, random_pose(34, 12.0), (16, 32))
    assert not found.visibility.all()
    assert (found.colour[~found.visibility] == 0).all()
    assert (found.inverse_depth[~found.visibility] == -1).all()
    (found.inverse_depth * ~found.visibility).sum().backward()
    assert (rho.grad == 0).all()


@pytest.mark.parametrize("up", [1, -1])
def test_the_polar_caps_have_the_gradient_of_finite_differences(up):
    """A target that looks into a cap sees a function of the row around the pole, whether the ring is whole or cut."""
    for name, rho in (("whole", smooth(4, 8)), ("default", rough(4, 8))):
        leaf = torch.from_numpy(0.1 + untied(rho)[::up].copy()).double().requires_grad_()
        mesh, pose = build_mesh(leaf.detach().numpy(), CUTS[name]), moved(0.05, 0.3 * up, 0.02)
        fragments = rasterize(mesh, pose, (24, 48))
        in_cap = fragments.face >= 8 * mesh.quads.size
        assert in_cap.sum() > 50

        def render(rho, fragments=fragments, mesh=mesh, pose=pose, in_cap=in_cap):
            found = render_fragments(fragments, mesh, rho, colours(4, 8, torch.float64), pose)
            return found.inverse_depth[torch.from_numpy(in_cap)]

        seen = fragments.inverse_depth[in_cap]
        np.testing.assert_allclose(render(leaf).detach(), seen, rtol=1e-3)
        assert torch.autograd.gradcheck(render, leaf)
        (gradient,) = torch.autograd.grad(render(leaf).sum(), leaf)
        assert (gradient[0 if up == 1 else -1] != 0).any()


def test_colour_at_a_pole_of_the_source_follows_the_polar_angle():
    """Half a row around the pole the gradient is that of the linearised arccos: its mean over the cap is the truth."""
    image = torch.linspace(0.0, 1.0, 16, dtype=torch.float64)[:, None, None].expand(16, 32, 1)
    cap = 0.5 * np.pi / 16
    angles = torch.linspace(0.0, 0.999, 40, dtype=torch.float64) * cap
    x = torch.sin(angles).requires_grad_()
    directions = torch.stack([x, torch.cos(angles), torch.zeros_like(angles)], dim=-1)
    row, _ = _source_pixels(directions, (16, 32))
    assert torch.allclose(row, angles * 16 / np.pi - 0.5, atol=1e-9)
    (slope,) = torch.autograd.grad(row.sum(), x)
    assert (slope >= 0).all()
    assert slope.max() < 2.1 * 16 / np.pi
    assert slope.mean() == pytest.approx(16 / np.pi, rel=0.02)
    (gradient,) = torch.autograd.grad(sample_bilinear_at(image, *_source_pixels(directions, (16, 32))).sum(), x)
    assert torch.isfinite(gradient).all()
