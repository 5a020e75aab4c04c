"""Points and discs as readers of others see them: on the wall, in its colours, lying in it."""

from dataclasses import replace
from pathlib import Path

import gsply
import numpy as np
import pytest
import trimesh
from export_samples import CHAIN, OPENCV, exported, job_in, off_wall, wall_colour

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, rotation_from_quaternion
from omnisyn_cli.geometry.sphere import pixel_directions, pixel_scale
from omnisyn_cli.interpolation.export.datasets import DISC_RADIUS_SHARE, points_of
from omnisyn_cli.interpolation.export.formats import plan_export
from omnisyn_cli.interpolation.export.run import run_export
from omnisyn_cli.render.mesh import Cut, build_mesh
from synthesis_samples import RADIUS, SIZE, open_to_the_sky, posed


def test_points_lie_on_the_wall_in_its_colours(tmp_path: Path) -> None:
    """The hall is a ball about the world's origin: a wrong axis, unit, order or origin would leave it."""
    summary = exported(tmp_path, "hall.ply")
    cloud = trimesh.load(tmp_path / "hall.ply")
    assert len(cloud.vertices) == summary.results["points"]
    assert off_wall(cloud.vertices).max() < 1e-4
    np.testing.assert_allclose(cloud.colors[:, :3], wall_colour(cloud.vertices), atol=2)


def test_a_reader_of_ply_finds_all_properties(tmp_path: Path) -> None:
    plyfile = pytest.importorskip("plyfile")
    exported(tmp_path, "hall.ply", stride=4)
    vertices = plyfile.PlyData.read(tmp_path / "hall.ply")["vertex"]
    points, normals = (np.stack([vertices[name] for name in names], -1) for names in ("xyz", ("nx", "ny", "nz")))
    assert off_wall(points).max() < 1e-4
    np.testing.assert_allclose((points * normals).sum(-1), -RADIUS, atol=0.05)
    np.testing.assert_allclose(vertices["confidence"], 1)


def test_points_are_as_dense_at_the_poles_as_at_the_equator(tmp_path: Path) -> None:
    exported(tmp_path, "hall.ply", chain=[CHAIN[0]] * 2)
    seen = trimesh.load(tmp_path / "hall.ply").vertices - CHAIN[0].position
    height = seen[:, 1] / np.linalg.norm(seen, axis=1)
    counts, _ = np.histogram(height, bins=8, range=(-1, 1))  # zones of equal height have equal areas
    assert counts.min() > 0.9 * counts.mean()


def test_a_stride_leaves_out_points_in_both_directions(tmp_path: Path) -> None:
    all_points = exported(tmp_path, "all.ply").results["points"]
    assert exported(tmp_path, "some.ply", stride=4).results["points"] == pytest.approx(all_points / 16, rel=0.05)


def test_discs_lie_in_the_wall_and_turn_to_the_panorama(tmp_path: Path) -> None:
    exported(tmp_path, "hall.ply", format="splats")
    discs = gsply.plyread(tmp_path / "hall.ply")
    places = discs.means @ OPENCV
    assert off_wall(places).max() < 1e-4
    axes = OPENCV @ rotation_from_quaternion(discs.quats.astype(np.float64))
    np.testing.assert_allclose((axes[..., 2] * places).sum(-1), -RADIUS, atol=0.05)
    radius = np.exp(discs.scales)
    assert (radius[:, 2] < 0.02 * radius[:, :2].min(axis=1)).all()
    np.testing.assert_allclose(0.5 + 0.28209479 * discs.sh0, wall_colour(places) / 255, atol=0.01)
    np.testing.assert_allclose(1 / (1 + np.exp(-discs.opacities)), 0.99, atol=1e-6)


def test_a_disc_covers_its_pixel_on_a_slanted_floor() -> None:
    """Across the line of sight as wide as pixels are apart there, along it longer by the slant."""
    height = 1.6
    rho = np.maximum(-pixel_directions(*SIZE)[..., 1] / height, 0.05).astype(np.float32)
    pose = posed((1, 2, 3), 0.7, 0.2, -0.1)
    picture = np.zeros((*SIZE, 3), np.uint8)
    points = points_of(build_mesh(rho, Cut(0.5)), np.ones(SIZE), picture, pose, 1)
    local = pose.inverse().transform(points.position)
    distance = np.linalg.norm(local, axis=1)
    floor = (local[:, 1] < -height + 1e-4) & (distance < 4.0) & (local[:, 1] / distance > -0.99)
    spacing = distance[floor] / pixel_scale(SIZE)[0]
    cosine = height / distance[floor]
    np.testing.assert_allclose(points.radius[floor, 1], DISC_RADIUS_SHARE * spacing, rtol=1e-5)
    np.testing.assert_allclose(points.radius[floor, 0], DISC_RADIUS_SHARE * spacing / cosine, rtol=0.02)
    axes = rotation_from_quaternion(points.turn[floor])
    np.testing.assert_allclose(axes[..., 2], np.broadcast_to(pose.rotation[:, 1], axes[..., 2].shape), atol=0.02)
    away = (points.position - pose.position)[floor]
    away -= (away @ pose.rotation[:, 1])[:, None] * pose.rotation[:, 1]
    along = np.abs((axes[..., 0] * away).sum(-1)) / np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(along, 1, atol=0.01)


def test_normals_do_not_reach_across_cuts() -> None:
    rho = np.full(SIZE, 0.25, np.float32)
    rho[:, 40:80] = 1.0
    rho[10, 10] = rho[:, 20] = rho[30, :] = 2.0  # a point and lines of their own look back along their rays
    points = points_of(build_mesh(rho, Cut(0.1)), np.ones(SIZE), np.zeros((*SIZE, 3), np.uint8), Pose.identity(), 1)
    toward = -points.position / np.linalg.norm(points.position, axis=1, keepdims=True)
    assert (points.normal * toward).sum(-1).min() > 0.98


def test_the_sky_is_left_out_or_lies_on_the_dome(tmp_path: Path) -> None:
    job = job_in(tmp_path, "sky.ply", chain=CHAIN[:2], dome=50.0)
    open_to_the_sky(tmp_path, 20)
    run_export(plan_export(job))
    assert off_wall(trimesh.load(tmp_path / "sky.ply").vertices).max() < 1e-4
    run_export(plan_export(replace(job, output=tmp_path / "discs.ply", format="splats")))
    places = gsply.plyread(tmp_path / "discs.ply").means @ OPENCV
    is_sky = off_wall(places) > 1.0
    distances = [np.linalg.norm(places[is_sky] - pose.position, axis=1) for pose in CHAIN[:2]]
    np.testing.assert_allclose(np.min(np.abs(np.array(distances) - 50.0), axis=0), 0, atol=1e-3)
    assert is_sky.any()


def test_nothing_but_sky_is_an_error_where_it_is_left_out(tmp_path: Path) -> None:
    job = job_in(tmp_path, "sky.ply", chain=CHAIN[:2], dome=50.0)
    open_to_the_sky(tmp_path, SIZE[0])
    with pytest.raises(InputError, match="nearer than 50 m, got sky or masks everywhere"):
        run_export(plan_export(job))
    assert not (tmp_path / "sky.ply").exists()


def test_equal_jobs_make_equal_files(tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply"):
        exported(tmp_path, name, format="splats", stride=3)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
