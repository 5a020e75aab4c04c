"""What a device sees is what the oracle sees: every pixel against every triangle in plain loops."""

import numpy as np
import pytest
from gpu_samples import CPU, POSES, rough

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.mesh import Cut, Mesh, build_mesh
from omnisyn_cli.synthesis.device import raster
from omnisyn_cli.synthesis.device.quads import quads_of
from omnisyn_cli.synthesis.device.raster import GpuRasterizer
from reference_rasterizer import rasterize_reference

CUTS = {"whole": Cut(relative=None), "default": Cut(), "everywhere": Cut(relative=1e-9)}
TARGET = (24, 48)


def seen(mesh: Mesh, pose: Pose, target: tuple[int, int]) -> np.ndarray:
    return GpuRasterizer(target, CPU)(quads_of(mesh, CPU), pose).numpy()


def check(mesh: Mesh, pose: Pose, target: tuple[int, int]) -> None:
    rho, oracle = seen(mesh, pose, target), rasterize_reference(mesh.triangles(), pose, target)
    np.testing.assert_array_equal(rho >= 0.0, oracle.visibility)
    np.testing.assert_allclose(rho, oracle.inverse_depth, atol=1e-6)


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("pose", [name for name in POSES if name != "identity"])
def test_agrees_with_the_oracle(cut: str, pose: str) -> None:
    """Cut meshes with surfaces at infinity, from within and without; seam, both poles, turned about any axis."""
    check(build_mesh(rough(8, 16), CUTS[cut]), POSES[pose], TARGET)


@pytest.mark.parametrize("pose", ["forward", "up", "any"])
def test_agrees_for_masked_meshes_and_odd_sizes(pose: str) -> None:
    mask = np.random.default_rng(2).random((5, 10)) > 0.3
    check(build_mesh(rough(5, 10), Cut(0.4), mask), POSES[pose], (17, 34))


def test_nothing_is_seen_of_nothing() -> None:
    rho = seen(build_mesh(rough(4, 8), mask=np.zeros((4, 8), bool)), POSES["any"], TARGET)
    assert (rho == -1.0).all()


@pytest.mark.parametrize("pose", ["identity", "any", "poles on the horizon"])
@pytest.mark.parametrize("cut", ["whole", "everywhere"])
def test_from_its_own_place_a_surface_has_no_holes(pose: str, cut: str) -> None:
    """With the identity every ray passes through a vertex; otherwise through seam and poles of either image."""
    size = (32, 64)
    rho = seen(build_mesh(rough(*size), CUTS[cut]), Pose(POSES[pose].rotation, np.zeros(3)), size)
    assert (rho >= 0.0).all()
    if pose == "identity":
        np.testing.assert_allclose(rho, rough(*size), atol=1e-6)


def test_how_much_is_done_at_a_time_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = build_mesh(rough(8, 16))
    whole = seen(mesh, POSES["any"], TARGET)
    monkeypatch.setattr(raster, "QUADS_PER_STEP", 37)
    monkeypatch.setattr(raster, "CANDIDATES_PER_STEP", 101)
    np.testing.assert_array_equal(seen(mesh, POSES["any"], TARGET), whole)
