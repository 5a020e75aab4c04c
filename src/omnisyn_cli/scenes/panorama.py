"""Scenes to panoramas: one call per set of positions that share a rotation.

Kernels get rays as tables: a unit vector on the horizon for each column, and sine and cosine of the polar angle for
each row.
"""

import math
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import angles_to_direction, direction_tables
from omnisyn_cli.scenes.culling import cull_tile, tile_planes
from omnisyn_cli.scenes.intersection import cast_rays, first_hit
from omnisyn_cli.scenes.kernel_decorators import kernel
from omnisyn_cli.scenes.scene import Scene
from omnisyn_cli.scenes.shader import shade, tone
from omnisyn_cli.scenes.world import SKY_ID, Scalar, pack_scene, seen_from

EXPOSURE = int(Scalar.EXPOSURE)
"""Its place in a packed world."""

TILE_SIDES = (16, 4)
"""Pixels along the side of a large and of a small tile; chosen by timing."""


class RayTables(NamedTuple):
    """Directions of the rays of a panorama, in the world.

    Attributes:
        sin_centre, cos_centre: of the polar angle of the pixel centres, by row.
        horizon_centre: unit vectors on the horizon, by column of pixels.
        sin_sample, cos_sample, horizon_sample: the same by row and column of samples.
        up: unit vector to the zenith of the picture.
        supersample: samples per pixel along each axis.
    """

    sin_centre: np.ndarray
    cos_centre: np.ndarray
    horizon_centre: np.ndarray
    sin_sample: np.ndarray
    cos_sample: np.ndarray
    horizon_sample: np.ndarray
    up: np.ndarray
    supersample: int


@kernel
def _render_tile(world, photos, rays, rows, columns, candidates, count, output):  # type: ignore[no-untyped-def]
    """Render the pixels of rows[0] to rows[1] - 1 and columns[0] to columns[1] - 1; only ``candidates`` can be hit."""
    (image, depth), samples, up = output, rays.supersample, rays.up
    pixel = math.pi / (depth.shape[0] * samples)
    exposure = world.scalars[EXPOSURE]
    hits, distances = np.empty(samples * samples, np.int64), np.empty(samples * samples)
    directions = np.empty((samples * samples, 3))
    for row in range(rows[0], rows[1]):
        for column in range(columns[0], columns[1]):
            is_uniform = True
            for sample in range(-1, samples * samples):  # -1: the centre of the pixel, for the depth
                if sample < 0:
                    sine, cosine, ahead, j = rays.sin_centre[row], rays.cos_centre[row], rays.horizon_centre, column
                else:
                    i, j = row * samples + sample // samples, column * samples + sample % samples
                    sine, cosine, ahead = rays.sin_sample[i], rays.cos_sample[i], rays.horizon_sample
                x = sine * ahead[j, 0] + cosine * up[0]
                y = sine * ahead[j, 1] + cosine * up[1]
                z = sine * ahead[j, 2] + cosine * up[2]
                t, hit = first_hit(world, candidates, count, x, y, z)
                if sample < 0:
                    depth[row, column] = np.inf if hit == SKY_ID else t
                else:
                    directions[sample, 0], directions[sample, 1], directions[sample, 2] = x, y, z
                    distances[sample], hits[sample] = t, hit
                    is_uniform = is_uniform and hit == hits[0]
            red, green, blue, tonal_material = 0.0, 0.0, 0.0, 0
            for sample in range(samples * samples):
                # within one surface the textures are filtered already: every other sample will do
                if is_uniform and (sample // samples + sample % samples) % 2 == 1:
                    continue
                direction = (directions[sample, 0], directions[sample, 1], directions[sample, 2])
                r, g, b = shade(world, photos, hits[sample], distances[sample], direction, pixel, sample)
                red += tone(r, exposure)
                green += tone(g, exposure)
                blue += tone(b, exposure)
                tonal_material += 1
            image[row, column, 0] = math.sqrt(red / tonal_material)
            image[row, column, 1] = math.sqrt(green / tonal_material)
            image[row, column, 2] = math.sqrt(blue / tonal_material)


@kernel
def render_tiles(world, photos, bounds, rays, tiles, output, begin, end):  # type: ignore[no-untyped-def]
    """Render bands ``begin`` to ``end`` of large tiles.

    Shapes are culled for each large tile, then for each small tile in it. ``output`` is the image, (H, W, 3) float32 in
    [0, 1], and the depth, (H, W) float32 in metres, inf for the sky.
    """
    samples, (height, width) = rays.supersample, output[1].shape
    large, small = tiles
    coarse, fine = np.empty_like(bounds.order), np.empty_like(bounds.order)
    planes = np.zeros((4, 3))
    for top in range(begin * large, min(height, end * large), large):
        for left in range(0, width, large):
            bottom, right = min(height, top + large), min(width, left + large)
            rows, columns = (top * samples, bottom * samples - 1), (left * samples, right * samples - 1)
            tile_planes(rays.sin_sample, rays.cos_sample, rays.horizon_sample, rays.up, rows, columns, planes)
            coarse_count = cull_tile(bounds, bounds.order, len(bounds.order), planes, coarse)
            for row in range(top, bottom, small):
                for column in range(left, right, small):
                    last_row, last_column = min(bottom, row + small), min(right, column + small)
                    rows = (row * samples, last_row * samples - 1)
                    columns = (column * samples, last_column * samples - 1)
                    tile_planes(rays.sin_sample, rays.cos_sample, rays.horizon_sample, rays.up, rows, columns, planes)
                    count = cull_tile(bounds, coarse, coarse_count, planes, fine)
                    rows, columns = (row, last_row), (column, last_column)
                    _render_tile(world, photos, rays, rows, columns, fine, count, output)


def render_panorama(
    scene: Scene, pose: Pose, size: tuple[int, int], *, supersample: int = 2, threads: int | None = None
) -> tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width"]]:
    """Render one panorama: RGB in [0, 1], and metres along the ray of each pixel's centre, inf where there is only sky.

    ``pose`` is world from camera and ``size`` (height, width). A pixel has ``supersample``² colour samples. The result
    does not depend on ``threads`` (None: one per core).
    """
    images, depths = render_views(
        scene, pose.rotation, pose.position[None], size, supersample=supersample, threads=threads
    )
    return images[0], depths[0]


def render_views(
    scene: Scene, rotation: Float[np.ndarray, "3 3"], positions: Float[np.ndarray, "views 3"], size: tuple[int, int], *,
    supersample: int = 2, threads: int | None = None,
) -> tuple[Float[np.ndarray, "views height width 3"], Float[np.ndarray, "views height width"]]:  # fmt: skip
    """Images and depths, as of :func:`render_panorama`, from several positions in one rotated frame.

    ``rotation`` is world from camera, for example with the epipoles at the poles; ``positions`` are in metres.
    """
    height, width = size
    if height < 1 or width < 1 or supersample < 1:
        raise ValueError(f"expected a positive size and supersample, got size {size} and supersample {supersample}")
    rays = _ray_tables(np.asarray(rotation, dtype=np.float64), size, supersample)
    static = pack_scene(scene)
    images = np.empty((len(positions), height, width, 3), dtype=np.float32)
    depths = np.empty((len(positions), height, width), dtype=np.float32)
    for position, image, depth in zip(np.asarray(positions, dtype=np.float64), images, depths, strict=True):
        world, bounds = seen_from(static, scene, position)
        kernel = partial(render_tiles, world, scene.photo_textures, bounds, rays, TILE_SIDES, (image, depth))
        run_ranges(kernel, -(-height // TILE_SIDES[0]), threads)
    return images, depths


def trace_rays(
    scene: Scene, position: Float[np.ndarray, "3"], directions: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Cast single rays (unit vectors) from a position.

    Returns metres (inf for the sky) and what is hit: the index of a shape, ``GROUND_ID`` or ``SKY_ID``.
    """
    world, _ = seen_from(pack_scene(scene), scene, np.asarray(position, dtype=np.float64))
    distance, hit = np.empty(len(directions)), np.empty(len(directions), dtype=np.int64)
    cast_rays(world, np.ascontiguousarray(directions, dtype=np.float64), distance, hit)
    return distance, hit


@lru_cache(maxsize=8)
def _unrotated_tables(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    sin_polar, cos_polar, sin_azimuth, cos_azimuth = direction_tables(height, width)
    horizon = angles_to_direction(np.arctan2(sin_azimuth, cos_azimuth), np.full(width, 0.5 * np.pi))
    return sin_polar, cos_polar, horizon


def _ray_tables(rotation: Float[np.ndarray, "3 3"], size: tuple[int, int], supersample: int) -> RayTables:
    height, width = size
    up = rotation @ angles_to_direction(np.array(0.0), np.array(0.0))
    centres, samples = (
        (sine, cosine, np.ascontiguousarray(horizon @ rotation.T))
        for sine, cosine, horizon in (_unrotated_tables(height * k, width * k) for k in (1, supersample))
    )
    return RayTables(*centres, *samples, up, supersample)
