"""Colours that a device looks up are those of the numba kernels, for the same fragments."""

import numpy as np
import pytest
import torch
from gpu_samples import CPU, POSES

from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import Mesh, build_mesh
from omnisyn_cli.render.rasterize import Fragments, rasterize
from omnisyn_cli.render.shade import Shader, make_confidence_map
from omnisyn_cli.render.texture import Texture, make_texture
from omnisyn_cli.synthesis.device.shading import confidence_on, shade, texture_on

SIZE = (40, 80)


def looked_up(fragments: Fragments, mesh: Mesh, texture: Texture, pose: str) -> np.ndarray:
    surface_confidence = confidence_on(make_confidence_map(mesh, texture), CPU)
    rho = torch.from_numpy(fragments.inverse_depth)
    rays = torch.from_numpy(pixel_directions(*rho.shape).astype(np.float32))
    return shade(rho, surface_confidence, rays, texture_on(texture, CPU), POSES[pose], len(rho)).numpy()


def by_kernels(fragments: Fragments, mesh: Mesh, texture: Texture, pose: str) -> np.ndarray:
    confidence = make_confidence_map(mesh, texture)
    return Shader(fragments.inverse_depth.shape)(fragments.inverse_depth, confidence, texture, POSES[pose])


@pytest.mark.parametrize("rows", [16, 40, 150, 321], ids=lambda rows: f"{rows} texel rows")
@pytest.mark.parametrize("pose", ["identity", "up", "any", "outside"])
@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_agrees_with_the_kernels(rows: int, pose: str, dtype: type) -> None:
    """Magnified, shrunk and an odd height; smooth noise, a mask, trust of cut quads and of confidence, holes."""
    rng = np.random.default_rng(rows)
    image = np.clip(0.5 + 0.5 * np.sin(pixel_directions(rows, 2 * rows) @ rng.normal(size=(3, 3)) * 9), 0, 1)
    image = np.rint(image * 255).astype(np.uint8) if dtype is np.uint8 else image.astype(np.float32)
    texture = make_texture(image, rng.random((rows, 2 * rows)) > 0.1)
    rho = (0.3 + 0.1 * rng.random((12, 24))).astype(np.float32)
    mesh = build_mesh(rho, mask=rng.random((12, 24)) > 0.1, confidence=rng.random((12, 24)))
    fragments = rasterize(mesh, POSES[pose], SIZE, threads=1)
    expected = by_kernels(fragments, mesh, texture, pose)
    found = looked_up(fragments, mesh, texture, pose)
    assert (found[fragments.face < 0] == 0.0).all()
    # A mip level that is all but whole may be rounded up by one and down by the other; the mixture is the same.
    # Kernels round places between samples of 8 bits, and what is read there.
    np.testing.assert_allclose(found, expected, atol=1 / 255 if dtype is np.uint8 else 2e-3)
    assert np.abs(found - expected).mean() < (0.1 / 255 if dtype is np.uint8 else 1e-4)


@pytest.mark.parametrize("rows", [100, 321, 600], ids=lambda rows: f"{rows} texel rows")
def test_rows_of_more_pixels_than_are_read_together_agree(rows: int) -> None:
    """The kernels find what several mip levels take for runs of 256 pixels; here a shorter one is left over."""
    rng, size = np.random.default_rng(rows), (150, 300)
    image = np.clip(0.5 + 0.5 * np.sin(pixel_directions(rows, 2 * rows) @ rng.normal(size=(3, 3)) * 9), 0, 1)
    texture, rho = make_texture(image.astype(np.float32)), (0.3 + 0.1 * rng.random((12, 24))).astype(np.float32)
    mesh = build_mesh(rho, confidence=rng.random((12, 24)))
    fragments = rasterize(mesh, POSES["any"], size, threads=1)
    expected = by_kernels(fragments, mesh, texture, "any")
    np.testing.assert_allclose(looked_up(fragments, mesh, texture, "any"), expected, atol=1e-4)
