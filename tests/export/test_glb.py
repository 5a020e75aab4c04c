"""GLB models as trimesh reads them: where things are, which way they face, what is painted on them."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from export_samples import CHAIN, exported, job_in, off_wall
from trimesh.ray.ray_pyembree import RayMeshIntersector

from interpolation_samples import tour_job
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.interpolation.export import glb
from omnisyn_cli.interpolation.export.formats import ExportJob, plan_export
from omnisyn_cli.interpolation.export.glb import MAX_FLATNESS, TexturedMesh, textured_mesh
from omnisyn_cli.interpolation.export.run import run_export
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.render.mesh import Cut, Mesh, build_mesh
from omnisyn_cli.render.quad_blocks import CUT_EDGES
from omnisyn_cli.scenes import generate_scene, sample_path
from omnisyn_cli.scenes.panorama import render_panorama
from synthesis_samples import RADIUS, SIZE, open_to_the_sky, posed, write_hall, write_mask


def scene_of(path: Path) -> trimesh.Scene:
    return trimesh.load_scene(path, process=False)


def document_of(path: Path) -> dict:
    data = path.read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sIIII", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), 0x4E4F534A)
    return json.loads(data[20 : 20 + length])


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The usual three panoramas as a model, with small textures."""
    folder = tmp_path_factory.mktemp("hall")
    exported(folder, "hall.glb", texture=32)
    return folder / "hall.glb"


def test_nodes_stand_where_panoramas_were_taken_and_surfaces_where_the_wall_is(hall: Path) -> None:
    scene = scene_of(hall)
    for index, pose in enumerate(CHAIN):
        node, name = scene.graph[f"p{index}.png"]
        np.testing.assert_allclose(node[:3, 3], pose.position, atol=1e-6)
        np.testing.assert_allclose(node[:3, :3], pose.rotation, atol=1e-6)
        mesh = scene.geometry[name].copy().apply_transform(node)
        assert off_wall(mesh.vertices).max() < 1.5 * MAX_FLATNESS * RADIUS
        assert mesh.area == pytest.approx(4 * np.pi * RADIUS**2, rel=0.01)


def test_a_vertex_has_the_texture_of_the_pixel_it_is_seen_at(hall: Path) -> None:
    """glTF's u grows with the column and v with the row, from the upper left corner; trimesh turns v over."""
    scene = scene_of(hall)
    for index in range(len(CHAIN)):
        _, name = scene.graph[f"p{index}.png"]
        mesh = scene.geometry[name]
        distance = np.linalg.norm(mesh.vertices[:, [0, 2]], axis=1)
        row, col = direction_to_pixel(mesh.vertices[distance > 0.05], SIZE)
        u, v = mesh.visual.uv[distance > 0.05].T
        aside = (u * SIZE[1] - 0.5 - col + 0.5 * SIZE[1]) % SIZE[1] - 0.5 * SIZE[1]
        np.testing.assert_allclose(aside, 0, atol=2e-3)
        np.testing.assert_allclose((1 - v) * SIZE[0] - 0.5, row, atol=2e-3)
        assert np.ptp(mesh.visual.uv[mesh.faces][..., 0], axis=1).max() < 0.3  # no triangle spans the whole picture


def test_materials_are_unlit_and_have_the_photograph(hall: Path) -> None:
    document = document_of(hall)
    assert document["extensionsUsed"] == ["KHR_materials_unlit"]
    assert all("KHR_materials_unlit" in material["extensions"] for material in document["materials"])
    for mesh in scene_of(hall).geometry.values():
        assert mesh.visual.material.baseColorTexture.size == (32, 16)


def stepped() -> Mesh:
    """A wall with a window into a second one, a slope, and a far part: cuts, merged quads and the seam."""
    rho = np.full((32, 64), 0.25, np.float32)
    rho[8:20, 58:] = rho[8:20, :9] = 0.5
    rho[22:30, 20:40] += np.linspace(0, 0.3, 20, dtype=np.float32)
    rho[:4] = 0.01
    return build_mesh(rho, Cut(0.2))


@pytest.mark.parametrize("texture_height", [8, 32, 256])
def test_every_ray_from_the_centre_meets_the_surface_once(texture_height: int) -> None:
    """Merged, split and stitched: no crack and no fold, so the signed solid angles sum to the whole sphere."""
    found = textured_mesh(stepped(), texture_height)
    signed = signed_solid_angles(found)
    assert signed.max() <= 1e-9
    assert signed.sum() == pytest.approx(-4 * np.pi, rel=1e-6)


def signed_solid_angles(mesh: TexturedMesh) -> np.ndarray:
    """Of triangles seen from the origin (Van Oosterom and Strackee, 1983)."""
    a, b, c = np.moveaxis(mesh.position[mesh.triangles], 1, 0)
    a, b, c = (corner / np.linalg.norm(corner, axis=1, keepdims=True) for corner in (a, b, c))
    triple = np.einsum("nx,nx->n", a, np.cross(b, c))
    return 2 * np.arctan2(triple, 1 + (a * b).sum(1) + (b * c).sum(1) + (c * a).sum(1))


@pytest.mark.parametrize("turn", [0, 4, 40])
def test_edges_meet_edges_whatever_their_lengths(turn: int) -> None:
    """Every edge has the same two ends in both triangles; small triangles lie beside large ones, at the seam too."""
    rho = (0.25 + 0.02 * np.abs(np.sin(np.arange(64) / 9.0))[None, :] * np.ones((32, 1))).astype(np.float32)
    rho[4:28, 50:60] += np.float32(0.01) * np.random.default_rng(0).random((24, 10), np.float32)
    rho = np.roll(rho, turn, axis=1)
    found = textured_mesh(build_mesh(rho, Cut(None)), 32)
    places = np.round(found.position, 4)  # caps are made in float32
    _, same = np.unique(places, axis=0, return_inverse=True)
    triangles = same.ravel()[found.triangles]
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    there, back = ({tuple(edge) for edge in some} for some in (edges.tolist(), edges[:, ::-1].tolist()))
    assert there == back
    assert len(there) == len(edges)
    assert len(found.triangles) < 0.6 * 2 * rho.size


def test_the_surface_is_where_the_depth_says_and_cuts_stay_open() -> None:
    mesh = stepped()
    found = textured_mesh(mesh, 32)
    row, col = (np.rint(k).astype(int) for k in direction_to_pixel(found.position, mesh.size))
    corner = np.linalg.norm(found.position, axis=1)
    at_vertex = np.linalg.norm(
        found.position / corner[:, None] - pixel_directions(*mesh.size)[row.clip(0, 31), col % 64], axis=1
    )
    kept = at_vertex < 1e-7
    truth = 1 / mesh.inverse_depth[row.clip(0, 31), col % 64]
    np.testing.assert_allclose(corner[kept], truth[kept], rtol=1e-5)
    lengths = np.ptp(np.linalg.norm(found.position[found.triangles], axis=2), axis=1)
    assert ((mesh.quads & CUT_EDGES) != 0).any()
    assert lengths[np.linalg.norm(found.position[found.triangles], axis=2).max(axis=1) < 5].max() < 1.5


def test_the_picture_is_shifted_by_no_more_than_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a floor that runs to the horizon a linear interpolation over large quads would be pixels aside."""
    directions = pixel_directions(64, 128)
    rho = np.maximum(-directions[..., 1] / 1.6, 0.02).astype(np.float32)
    mesh = build_mesh(rho, Cut(None))

    def widest(found: TexturedMesh) -> float:
        corners, texture = found.position[found.triangles], found.texture[found.triangles]
        row, col = direction_to_pixel(corners.mean(axis=1), mesh.size)
        u, v = texture.mean(axis=1).T
        aside = (u * 128 - 0.5 - col + 64) % 128 - 64
        sine = np.linalg.norm(corners.mean(axis=1)[:, [0, 2]], axis=1) / np.linalg.norm(corners.mean(axis=1), axis=1)
        inside = (np.abs(v - 0.5) < 0.48) & (np.abs(v - 0.5) > 0.03)  # neither caps nor the bend to the horizon
        return float(np.hypot(aside * sine, v * 64 - 0.5 - row)[inside].max())

    assert widest(textured_mesh(mesh, 256)) < 0.15
    few = textured_mesh(mesh, 64)
    monkeypatch.setattr(glb, "SHIFT", 10.0)
    assert widest(few) < 0.5 * widest(textured_mesh(mesh, 64))


def test_the_sky_is_a_node_of_its_own_on_the_dome(tmp_path: Path) -> None:
    job = job_in(tmp_path, "sky.glb", chain=CHAIN[:2], dome=30.0)
    open_to_the_sky(tmp_path, 20)
    run_export(plan_export(job))
    scene = scene_of(tmp_path / "sky.glb")
    for index, pose in enumerate(CHAIN[:2]):
        node, name = scene.graph[f"p{index}.png sky"]
        np.testing.assert_allclose(node[:3, 3], pose.position, atol=1e-6)
        distance = np.linalg.norm(scene.geometry[name].vertices, axis=1)
        np.testing.assert_allclose(distance, 30.0 * (1 + 0.01 * index), rtol=2e-4)
        assert scene.geometry[name].vertices[:, 1].min() > 0
    assert np.isfinite(scene.bounds).all()


def test_masked_parts_have_no_surface(tmp_path: Path) -> None:
    mask = write_mask(tmp_path / "not below.png", 40)
    exported(tmp_path, "hall.glb", chain=CHAIN[:2], masks=(mask, mask))
    for mesh in scene_of(tmp_path / "hall.glb").geometry.values():
        row, _ = direction_to_pixel(mesh.vertices, SIZE)
        assert row.max() <= 39.5 + 1e-6


@pytest.mark.parametrize("size", [(2, 4), (4, 8)])
def test_the_smallest_panoramas_become_models(tmp_path: Path, size: tuple[int, int]) -> None:
    job = job_in(tmp_path, "small.glb", chain=CHAIN[:2])
    write_hall(tmp_path, CHAIN[:2], size)
    run_export(plan_export(job))
    for mesh in scene_of(tmp_path / "small.glb").geometry.values():
        assert signed_solid_angles(TexturedMesh(mesh.vertices, mesh.visual.uv, mesh.faces)).sum() == pytest.approx(
            -4 * np.pi, rel=1e-5
        )


def test_more_vertices_than_sixteen_bits_count(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    job = job_in(tmp_path, "many.glb", chain=[posed((0, 0, 0)), posed((0.1, 0, 0))])
    for index in (0, 1):
        write_depth(tmp_path / f"p{index}_depth.exr", rng.uniform(1, 30, (128, 256)))
    run_export(plan_export(job))
    document = document_of(tmp_path / "many.glb")
    kinds = {document["accessors"][mesh["primitives"][0]["indices"]]["componentType"] for mesh in document["meshes"]}
    assert kinds == {5125}
    for mesh in scene_of(tmp_path / "many.glb").geometry.values():
        assert mesh.faces.max() == len(mesh.vertices) - 1


def test_a_room_seen_from_between_has_the_distances_of_the_room(tmp_path: Path) -> None:
    """A ray caster of others looks at both meshes from a third place, along rays that hit no vertex exactly."""
    scene, size = generate_scene("room", 3), (128, 256)
    path, entries, images = sample_path(scene, 3, 3, baseline=1.0), {}, []
    for k in (0, 2):
        image, depth = render_panorama(scene, path[k], size)
        images.append(tmp_path / f"room {k}.png")
        write_image(images[-1], image)
        write_depth(tmp_path / f"room {k}.exr", depth)
        entries[images[-1].name] = PosedPanorama(path[k], tmp_path / f"room {k}.exr")
    write_poses(tmp_path / "poses.json", entries)
    run_export(plan_export(tour_job(ExportJob, tmp_path, images, "room.glb")))
    middle = Pose(path[1].rotation @ rotation_from_heading(0.003, 0.002, 0.001), path[1].position)
    truth = render_panorama(scene, middle, size)[1]
    found = nearest_front(scene_of(tmp_path / "room.glb"), middle, size)
    both = np.isfinite(found) & np.isfinite(truth)
    error = np.abs(found[both] / truth[both] - 1)
    assert both.mean() > 0.9 * np.isfinite(truth).mean()
    assert np.median(error) < 2e-3
    assert (error < 0.02).mean() > 0.85


def nearest_front(scene: trimesh.Scene, pose: Pose, size: tuple[int, int]) -> np.ndarray:
    """Distances to the nearest face that looks at a camera; infinite where there is none."""
    rays = (pixel_directions(*size) @ pose.rotation.T).reshape(-1, 3)
    nearest = np.full(len(rays), np.inf)
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name].copy().apply_transform(transform)
        normals = np.cross(*np.diff(mesh.triangles, axis=1).transpose(1, 0, 2))
        hit = RayMeshIntersector(mesh, scale_to_box=False).intersects_first(
            np.broadcast_to(pose.position, rays.shape), rays
        )
        seen = np.flatnonzero(hit >= 0)
        normal, corner = normals[hit[seen]], mesh.triangles[hit[seen], 0]
        along = (normal * rays[seen]).sum(1)
        distance = ((corner - pose.position) * normal).sum(1) / along
        nearest[seen] = np.minimum(nearest[seen], np.where(along < 0, distance, np.inf))
    return nearest.reshape(size)
