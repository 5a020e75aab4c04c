"""Scenes to panoramas: one call per set of positions that share a rotation."""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import angles_to_direction, direction_tables
from omnisyn_cli.scenes.raycast import cast_rays
from omnisyn_cli.scenes.render import render_tiles
from omnisyn_cli.scenes.scene import Scene
from omnisyn_cli.scenes.world import pack, papers_of, seen_from

_TILES = (16, 4)  # pixels; chosen by timing


def render_panorama(
    scene: Scene, pose: Pose, size: tuple[int, int], *, supersample: int = 2, threads: int | None = None
) -> tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width"]]:
    """Render one panorama.

    Args:
        scene: what to render.
        pose: world from camera.
        size: ``(height, width)`` in pixels.
        supersample: colour samples per pixel along each axis.
        threads: how many to use; None = one per core. The result does not depend on it.

    Returns:
        ``(image, depth)``: RGB in [0, 1] and Euclidean metres along the ray of the pixel's centre, inf where there is
        only sky.
    """
    images, depths = render_views(
        scene, pose.rotation, pose.position[None], size, supersample=supersample, threads=threads
    )
    return images[0], depths[0]


def render_views(
    scene: Scene,
    rotation: Float[np.ndarray, "3 3"],
    positions: Float[np.ndarray, "views 3"],
    size: tuple[int, int],
    *,
    supersample: int = 2,
    threads: int | None = None,
) -> tuple[Float[np.ndarray, "views height width 3"], Float[np.ndarray, "views height width"]]:
    """Render panoramas from several positions in one rotated frame, e.g. the one whose poles are the epipoles.

    Args:
        scene: what to render.
        rotation: world from camera, shared by all views.
        positions: optical centres in the world, metres.
        size: ``(height, width)`` in pixels.
        supersample: colour samples per pixel along each axis.
        threads: how many to use; None = one per core.

    Returns:
        ``(images, depths)``.
    """
    height, width = size
    if height < 1 or width < 1 or supersample < 1:
        raise ValueError(f"expected a positive size and supersample, got size {size} and supersample {supersample}")
    tables = _ray_tables(np.asarray(rotation, dtype=np.float64), size, supersample)
    packed = pack(scene)
    images = np.empty((len(positions), height, width, 3), dtype=np.float32)
    depths = np.empty((len(positions), height, width), dtype=np.float32)
    bands = -(-height // _TILES[0])
    workers = min(bands, threads or os.cpu_count() or 1)
    for position, image, depth in zip(np.asarray(positions, dtype=np.float64), images, depths, strict=True):
        world, bounds = seen_from(packed, scene, position)
        fixed = (world, papers_of(scene), bounds, tables, supersample, _TILES)
        if workers == 1:
            render_tiles(*fixed, (0, bands), image, depth)
            continue
        render_band = partial(_render_band, fixed, image, depth)
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(render_band, range(bands)))
    return images, depths


def _render_band(fixed: tuple[Any, ...], image: np.ndarray, depth: np.ndarray, band: int) -> None:
    render_tiles(*fixed, (band, band + 1), image, depth)


def distances(
    scene: Scene, position: Float[np.ndarray, "3"], directions: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Cast single rays from one position.

    Args:
        scene: what to look at.
        position: where the rays start, metres.
        directions: unit vectors.

    Returns:
        Metres (inf = sky), and what is hit: the number of a shape, -1 for the ground, -2 for the sky.
    """
    world, _ = seen_from(pack(scene), scene, np.asarray(position, dtype=np.float64))
    distance, hit = np.empty(len(directions)), np.empty(len(directions), dtype=np.int64)
    cast_rays(world, np.ascontiguousarray(directions, dtype=np.float64), distance, hit)
    return distance, hit


@lru_cache(maxsize=8)
def _unrotated_tables(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    sin_polar, cos_polar, sin_azimuth, cos_azimuth = direction_tables(height, width)
    horizon = angles_to_direction(np.arctan2(sin_azimuth, cos_azimuth), np.full(width, 0.5 * np.pi))
    return sin_polar, cos_polar, horizon


def _ray_tables(rotation: Float[np.ndarray, "3 3"], size: tuple[int, int], supersample: int) -> tuple[np.ndarray, ...]:
    height, width = size
    up = rotation @ angles_to_direction(np.array(0.0), np.array(0.0))
    centres = _unrotated_tables(height, width)
    samples = _unrotated_tables(height * supersample, width * supersample)
    return (
        *centres[:2],
        np.ascontiguousarray(centres[2] @ rotation.T),
        *samples[:2],
        np.ascontiguousarray(samples[2] @ rotation.T),
        up,
    )
