"""How long a view takes compared with Embree, which only traces the rays.

``python tests/benchmarks/bench_renderer.py [depth.exr]``: a 1024×512 mesh (of a street, with ``--room`` of an empty
room, or of a file's depth) drawn at 2048×1024 and 4096×2048 with a photograph of the same size, everything on one
thread, in turn with Embree on the same triangles and rays. ``adaptive`` is the mesh with its flat parts merged for the
way from the panorama to the target. Times are the thread's own (what it computed, not what it waited), the best of the
rounds counts. Only the ratios mean anything on a machine that does other work as well.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io.depth_files import read_inverse_depth
from omnisyn_cli.render.mesh import Mesh, build_mesh
from omnisyn_cli.render.rasterize import Rasterizer
from omnisyn_cli.render.shade import Shader, make_confidence_map
from omnisyn_cli.render.simplify import simplify
from omnisyn_cli.render.texture import make_texture

MESH, TARGETS = (512, 1024), ((1024, 2048), (2048, 4096))
POSE = Pose(np.eye(3), np.array([0.0, 0.0, 1.5]))
FARTHEST = 1e6  # Metres; Embree knows no infinity.


def synthetic() -> np.ndarray:
    """A street: ground, two walls with pillars in front of them, and sky."""
    directions = pixel_directions(*MESH)
    ground = np.maximum(0.0, -directions[..., 1]) / 1.6
    walls = np.abs(directions[..., 0]) / 6.0 * (directions[..., 1] < 0.6 * np.abs(directions[..., 0]))
    azimuth = np.arctan2(directions[..., 0], -directions[..., 2])
    pillars = 0.25 * (np.sin(12 * azimuth) > 0.9) * (np.abs(directions[..., 1]) < 0.4)
    return np.maximum(np.maximum(ground, walls), pillars).astype(np.float32)


def room() -> np.ndarray:
    """An empty room of 5×2.7×7 metres."""
    directions = pixel_directions(*MESH)
    return np.maximum(directions / [3.0, 1.1, 4.0], directions / [-2.0, -1.6, -3.0]).max(axis=-1).astype(np.float32)


def from_file(path: Path) -> np.ndarray:
    """Inverse depth of a depth file, every n-th pixel of it, so that it has the mesh's size."""
    inverse_depth = read_inverse_depth(path)
    return inverse_depth[:: max(1, inverse_depth.shape[0] // MESH[0]), :: max(1, inverse_depth.shape[1] // MESH[1])]


def embree(mesh: Mesh, size: tuple[int, int]) -> Callable[[], object]:
    """Traces the rays of the target; building the scene is not counted."""
    triangles = mesh.triangles()
    depth = 1.0 / np.maximum(triangles.inverse_depth, 1.0 / FARTHEST)
    points = POSE.transform(triangles.direction * depth[..., None])
    scene = EmbreeScene()
    TriangleMesh(scene, points.astype(np.float32))
    rays = pixel_directions(*size).reshape(-1, 3).astype(np.float32)
    origins = np.zeros_like(rays)
    return lambda: scene.run(origins, rays)


def renderer(mesh: Mesh, size: tuple[int, int], blocks: Any) -> Callable[[], object]:
    """Rasterises blocks of quads and shades one view with as many samples of 8 bits as a photograph of the size has."""
    texture = make_texture(np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8))
    rasterizer, shader = Rasterizer(size, threads=1), Shader(size, threads=1)
    surface_confidence = make_confidence_map(mesh, texture)
    return lambda: shader(rasterizer(blocks, POSE), surface_confidence, texture, POSE)


def adaptive(mesh: Mesh, size: tuple[int, int]) -> Callable[[], object]:
    """The same view of the simplified mesh; simplifying it, once for a pair, is not counted."""
    quads, kept = simplify(mesh, -POSE.position, size[0], threads=1)
    print(f"{size[1]}×{size[0]}  {kept} of {mesh.face_count()} triangles kept")
    return renderer(mesh, size, quads)


def best_of(contestants: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Computing time of the fastest of ``rounds`` runs of each, in turn, in seconds; the first run is not counted."""
    best = dict.fromkeys(contestants, float("inf"))
    for number in range(rounds + 1):
        for name, run in contestants.items():
            begin = time.thread_time()
            run()
            if number:
                best[name] = min(best[name], time.thread_time() - begin)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("depth", type=Path, nargs="?", help="an EXR with depths in metres")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--room", action="store_true", help="an empty room instead of a street")
    options = parser.parse_args()
    scene = room() if options.room else synthetic()
    mesh = build_mesh(scene if options.depth is None else from_file(options.depth))
    print(f"{MESH[1]}×{MESH[0]} mesh, {len(mesh.cut_quads)} of {mesh.quads.size} quads cut")
    for size in TARGETS:
        contestants = {
            "embree, rays only": embree(mesh, size),
            "mesh": renderer(mesh, size, mesh.blocks),
            "adaptive": adaptive(mesh, size),
        }
        best = best_of(contestants, options.rounds)
        for name, seconds in best.items():
            share = seconds / best["embree, rays only"]
            print(f"{size[1]}×{size[0]}  {name:20} {seconds * 1e3:8.1f} ms   {share:6.1%} of embree")


if __name__ == "__main__":
    main()
