"""The colour of a photograph that lies on a face, at one point: mirrored, turned, as coarse as the sample is wide."""

import math

from omnisyn_cli.scenes.jit import kernel
from omnisyn_cli.scenes.noise import cell_hash, smooth_noise

UNDER, FITTED = 1.0, 2.0
"""As in :class:`omnisyn_cli.scenes.photos.Use`."""

PATCHES = 0.6
"""Patches of the ground that are turned, per width of a photograph."""


@kernel
def _mirrored(i, count):  # type: ignore[no-untyped-def]
    """The texel that index i means where a row of them is repeated, every second time backwards."""
    i %= 2 * count
    return i if i < count else 2 * count - 1 - i


@kernel
def _bilinear(texels, level, x, y):  # type: ignore[no-untyped-def]
    """Light at (x, y) of a mip level, both in its widths and heights."""
    first, height, width = level[0], level[1], level[2]
    x, y = x * width - 0.5, y * height - 0.5
    left, top = math.floor(x), math.floor(y)
    across, down = x - left, y - top
    a, b = _mirrored(int(left), width), _mirrored(int(left) + 1, width)
    upper, lower = first + _mirrored(int(top), height) * width, first + _mirrored(int(top) + 1, height) * width
    wa, wb = (1.0 - across) * (1.0 - down), across * (1.0 - down)
    wc, wd = (1.0 - across) * down, across * down
    light = (0.0, 0.0, 0.0)
    for weight, texel in ((wa, upper + a), (wb, upper + b), (wc, lower + a), (wd, lower + b)):
        r, g, b_ = texels[texel, 0] / 255.0, texels[texel, 1] / 255.0, texels[texel, 2] / 255.0
        light = (light[0] + weight * r * r, light[1] + weight * g * g, light[2] + weight * b_ * b_)
    return light


@kernel
def _between_levels(texels, levels, x, y, lod):  # type: ignore[no-untyped-def]
    """The same between two mip levels; ``lod`` is the binary logarithm of the texels that a sample covers."""
    lod = min(max(lod, 0.0), len(levels) - 1.0)
    k = min(int(lod), len(levels) - 2)
    share = lod - k
    r, g, b = _bilinear(texels, levels[k], x, y)
    if share > 0.0:
        cr, cg, cb = _bilinear(texels, levels[k + 1], x, y)
        r, g, b = r + (cr - r) * share, g + (cg - g) * share, b + (cb - b) * share
    return r, g, b


@kernel
def photo_at(texels, photos, chosen, table, u, v, hu, hv, fp, variation):  # type: ignore[no-untyped-def]
    """Linear colour at (u, v) of a face.

    Args:
        texels: of :class:`omnisyn_cli.scenes.photos.Photos`.
        photos: their levels.
        chosen: of the material, see :class:`omnisyn_cli.scenes.scene.Papering`.
        table: the noise.
        u: metres across the face, 0 in its middle.
        v: metres up, 0 at its foot.
        hu: half size of the face, metres.
        hv: the same upwards.
        fp: footprint of the sample, metres.
        variation: number of the shape.
    """
    levels, use, wide, seed = photos[int(chosen[0])], chosen[1], chosen[2], int(chosen[3])
    high, broad = levels[0, 1], levels[0, 2]
    if use == FITTED:
        texel = max(2.0 * hu / broad, 2.0 * hv / high)
        x, y = 0.5 + u / (texel * broad), 0.5 - (v - hv) / (texel * high)
    else:
        texel = wide / broad
        x = u / wide + 2.0 * cell_hash(variation, 1, seed)
        y = 2.0 * cell_hash(variation, 2, seed) - v / (texel * high)
    lod = math.log2(max(fp / texel, 1e-6))
    r, g, b = _between_levels(texels, levels, x, y, lod)
    if chosen[4] > 0.0:
        patch = smooth_noise(table, PATCHES * u / wide, PATCHES * v / wide, seed)
        share = min(1.0, max(0.0, 0.5 + 6.0 * (patch - 0.5)))
        if share > 0.0:
            cr, cg, cb = _between_levels(texels, levels, 0.37 - v / wide, 0.71 - u / (texel * high), lod)
            r, g, b = r + (cr - r) * share, g + (cg - g) * share, b + (cb - b) * share
    return r, g, b
