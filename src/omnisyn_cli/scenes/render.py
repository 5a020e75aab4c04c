"""The loop over tiles, pixels and samples.

Rays come as tables: a unit vector on the horizon for each column, and sine and cosine of the polar angle for each row.
"""

import math

import numpy as np

from omnisyn_cli.scenes.culling import list_tile, tile_planes
from omnisyn_cli.scenes.jit import kernel
from omnisyn_cli.scenes.raycast import first_hit
from omnisyn_cli.scenes.shading import shade, tone
from omnisyn_cli.scenes.world import SKY, Scalar

EXPOSURE = int(Scalar.EXPOSURE)


@kernel
def _render_tile(world, papers, tables, samples, rows, columns, listed, count, image, depth):  # type: ignore[no-untyped-def]
    """Render the pixels of rows[0] to rows[1] - 1 and columns[0] to columns[1] - 1; only the listed shapes can show."""
    sin_centre, cos_centre, horizon_centre, sin_sample, cos_sample, horizon, up = tables
    pixel = math.pi / (depth.shape[0] * samples)
    exposure = world.scalars[EXPOSURE]
    hits, distances = np.empty(samples * samples, np.int64), np.empty(samples * samples)
    rays = np.empty((samples * samples, 3))
    for row in range(rows[0], rows[1]):
        for column in range(columns[0], columns[1]):
            is_uniform = True
            for sample in range(-1, samples * samples):  # -1: the centre of the pixel, for the depth
                if sample < 0:
                    sine, cosine, ahead, j = sin_centre[row], cos_centre[row], horizon_centre, column
                else:
                    i, j = row * samples + sample // samples, column * samples + sample % samples
                    sine, cosine, ahead = sin_sample[i], cos_sample[i], horizon
                x = sine * ahead[j, 0] + cosine * up[0]
                y = sine * ahead[j, 1] + cosine * up[1]
                z = sine * ahead[j, 2] + cosine * up[2]
                t, hit = first_hit(world, listed, count, x, y, z)
                if sample < 0:
                    depth[row, column] = np.inf if hit == SKY else t
                else:
                    rays[sample, 0], rays[sample, 1], rays[sample, 2] = x, y, z
                    distances[sample], hits[sample] = t, hit
                    is_uniform = is_uniform and hit == hits[0]
            red, green, blue, shaded = 0.0, 0.0, 0.0, 0
            for sample in range(samples * samples):
                # within one surface the textures are filtered already: every other sample will do
                if is_uniform and (sample // samples + sample % samples) % 2 == 1:
                    continue
                x, y, z = rays[sample, 0], rays[sample, 1], rays[sample, 2]
                r, g, b = shade(world, papers, hits[sample], distances[sample], x, y, z, pixel, sample)
                red += tone(r, exposure)
                green += tone(g, exposure)
                blue += tone(b, exposure)
                shaded += 1
            image[row, column, 0] = math.sqrt(red / shaded)
            image[row, column, 1] = math.sqrt(green / shaded)
            image[row, column, 2] = math.sqrt(blue / shaded)


@kernel
def render_tiles(world, papers, bounds, tables, samples, tiles, bands, image, depth):  # type: ignore[no-untyped-def]
    """Render some bands of tiles.

    Args:
        world: the scene seen from one place.
        papers: its photographs.
        bounds: of its shapes.
        tables: ``(sin_polar, cos_polar, horizon)`` of the pixel centres and the same of the samples, then ``up``.
        samples: samples per pixel along each axis.
        tiles: pixels along the side of a large and of a small tile; shapes are chosen for the former, then for the
            latter.
        bands: first band of large tiles and one past the last.
        image: (H, W, 3) float32 output in [0, 1].
        depth: (H, W) float32 output, metres, inf for the sky.
    """
    sin_sample, cos_sample, horizon, up = tables[3], tables[4], tables[5], tables[6]
    height, width = depth.shape
    large, small = tiles
    coarse, fine = np.empty_like(bounds.order), np.empty_like(bounds.order)
    planes = np.zeros((4, 3))
    for top in range(bands[0] * large, min(height, bands[1] * large), large):
        for left in range(0, width, large):
            bottom, right = min(height, top + large), min(width, left + large)
            rows, columns = (top * samples, bottom * samples - 1), (left * samples, right * samples - 1)
            tile_planes(sin_sample, cos_sample, horizon, up, rows, columns, planes)
            listed = list_tile(bounds, bounds.order, len(bounds.order), planes, coarse)
            for row in range(top, bottom, small):
                for column in range(left, right, small):
                    last_row, last_column = min(bottom, row + small), min(right, column + small)
                    rows, columns = (
                        (row * samples, last_row * samples - 1),
                        (column * samples, last_column * samples - 1),
                    )
                    tile_planes(sin_sample, cos_sample, horizon, up, rows, columns, planes)
                    count = list_tile(bounds, coarse, listed, planes, fine)
                    rows, columns = (row, last_row), (column, last_column)
                    _render_tile(world, papers, tables, samples, rows, columns, fine, count, image, depth)
