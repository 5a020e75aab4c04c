"""The patterns: what a material looks like at one point of a face.

A pattern returns five numbers: how much of the material's second and third colour lies over the first, and factors on
brightness, gloss and glow. Arguments are those of :class:`FacePoint`, ``m`` for the packed material, ``noise`` for the
noise lattice and ``fp`` for the footprint of the sample in metres. Detail smaller than the footprint fades to its mean.
Sizes and strengths inside the patterns were chosen by eye.
"""

import math
from typing import NamedTuple

from omnisyn_cli.compute.jit import fast_subkernel
from omnisyn_cli.scenes.materials import Pattern
from omnisyn_cli.scenes.noise import cell_hash, fractal_noise, pulse, smooth_noise, smooth_noise_3d


class FacePoint(NamedTuple):
    """A point on a face of a shape; lengths in metres; for ``variation`` see PACKED_SHAPE.

    ``u``, ``v``: place across, 0 in the middle, and up, 0 at the bottom; ``half_u``, ``half_v``: half sizes of the
    face; ``x``, ``y``, ``z``: place in the shape's own frame.
    """

    u: float
    v: float
    half_u: float
    half_v: float
    x: float
    y: float
    z: float
    variation: int


@fast_subkernel
def _visible(size, footprint):  # type: ignore[no-untyped-def]
    """How much of the variation between cells of a size survives a footprint."""
    return min(1.0, max(0.0, 1.7 - 1.6 * footprint / size))


@fast_subkernel
def _step(x, footprint):  # type: ignore[no-untyped-def]
    """Share of the footprint around x that is above zero."""
    return min(1.0, max(0.0, 0.5 + x / max(footprint, 1e-4)))


@fast_subkernel
def _inside(u, v, u0, v0, u1, v1, footprint):  # type: ignore[no-untyped-def]
    """Share of the footprint within a rectangle."""
    across = _step(u - u0, footprint) * _step(u1 - u, footprint)
    return across * _step(v - v0, footprint) * _step(v1 - v, footprint)


@fast_subkernel
def _masonry(m, u, v, fp, is_brick):  # type: ignore[no-untyped-def]
    """Bricks of any tone, each second row half a cell further on; or tiles of one tone or the other."""
    cu, cv, line = m.cell[0], m.cell[1], m.line
    row = math.floor(v / cv)
    across = u / cu + 0.5 * (row & 1) if is_brick else u / cu
    column = math.floor(across)
    joint = 1.0 - (1.0 - pulse(across, line / cu, fp / cu)) * (1.0 - pulse(v / cv, line / cv, fp / cv))
    visible = _visible(min(cu, cv), fp)
    chance = cell_hash(int(column), int(row), m.seed)
    tone = chance if is_brick else (1.0 if chance < m.detail else 0.0)
    contrast = (0.28 if is_brick else 0.14) * visible
    lightness = 1.0 + contrast * (cell_hash(int(column), int(row), m.seed + 1) - 0.5)
    return m.detail + (tone - m.detail) * visible, joint, lightness, 1.0 - joint, 1.0


@fast_subkernel
def _checker(m, u, v, fp):  # type: ignore[no-untyped-def]
    cu, cv = m.cell[0], m.cell[1]
    a = pulse(0.5 * u / cu, 0.5, 0.5 * fp / cu)
    b = pulse(0.5 * v / cv, 0.5, 0.5 * fp / cv)
    joint = 1.0 - (1.0 - pulse(u / cu, m.line / cu, fp / cu)) * (1.0 - pulse(v / cv, m.line / cv, fp / cv))
    return a + b - 2.0 * a * b, joint * 0.6, 1.0, 1.0, 1.0


@fast_subkernel
def _planks(m, u, v, fp):  # type: ignore[no-untyped-def]
    cu, cv, line, seed = m.cell[0], m.cell[1], m.line, m.seed
    row = math.floor(v / cv)
    shifted = u / cu + cell_hash(int(row), 3, seed)
    column = math.floor(shifted)
    joint = 1.0 - (1.0 - pulse(v / cv, line / cv, fp / cv)) * (1.0 - pulse(shifted, line / cu, fp / cu))
    visible = _visible(cv, fp)
    grain = fractal_noise(u * 1.5 + 17.0 * row, v * 22.0, seed + int(column), fp * 12.0, 3)
    other = 0.5 + visible * (cell_hash(int(column), int(row), seed) - 0.5) + 0.9 * grain
    return min(1.0, max(0.0, other)), joint * 0.8, 1.0 + 0.5 * grain, 1.0, 1.0


@fast_subkernel
def _facade(m, u, v, hu, hv, fp):  # type: ignore[no-untyped-def]
    cu, cv, line, seed = m.cell[0], m.cell[1], m.line, m.seed
    columns = math.floor(2.0 * hu / cu)
    column, row = math.floor(u / cu + 0.5 * columns), math.floor(v / cv)
    x, y = u / cu + 0.5 * columns - column, v - row * cv
    shop = row == 0 and m.detail > 0.4
    ledge = pulse(v / cv, 0.12 / cv, fp / cv) * (0.7 if row > 0 else 0.0)
    if column < 0 or column >= columns or (row + 1) * cv > 2.0 * hv + 0.1:
        return 0.0, ledge, 1.0, 0.0, 1.0
    pick = cell_hash(int(column), int(row), seed)
    wide = 0.25 + 0.23 * cell_hash(seed, 5, 1)
    low, high = 0.1 + 0.25 * cell_hash(seed, 6, 1), 0.78 + 0.12 * cell_hash(seed, 7, 1)
    if shop:
        wide, low, high = 0.44, (0.02 if pick < 0.3 else 0.14), 0.8
    u0, u1, v0, v1 = (0.5 - wide) * cu, (0.5 + wide) * cu, low * cv, high * cv
    x *= cu
    frame = _inside(x, y, u0, v0, u1, v1, fp)
    glass = _inside(x, y, u0 + line, v0 + line, u1 - line, v1 - line, fp)
    middle = 0.5 * cu
    bar = _inside(x, y, middle - 0.5 * line, v0, middle + 0.5 * line, v1, fp)
    if cell_hash(seed, 8, 1) < 0.5:
        bar = max(bar, _inside(x, y, u0, v1 - 0.4, u1, v1 - 0.4 + line, fp))
    sill = _inside(x, y, u0 - 0.08, v0 - 0.1, u1 + 0.08, v0, fp)
    glass *= 1.0 - bar
    curtain = pick > 0.55 and y > v1 - (v1 - v0) * (pick - 0.5) * 2.2
    behind = cell_hash(int(column), int(row), seed + 1)
    lightness = 0.45 + 1.1 * behind if not curtain else 2.2 + behind
    tone = 1.0 - 0.45 * glass * _step(y - (v1 - line - 0.18), 0.25)
    fade = _visible(0.5 * cu, fp)
    lightness = 1.0 + glass * (1.0 + (lightness - 1.0) * fade - 1.0)
    trim = max((frame - glass) * 0.95, max(sill, ledge * (1.0 - frame)))
    return glass, trim, lightness * tone, glass, 1.0


@fast_subkernel
def _stripes(m, u, v, fp):  # type: ignore[no-untyped-def]
    slope = 2.0 * m.detail - 1.0
    return pulse((u + slope * v) / m.cell[0], 0.5, fp * 1.2 / m.cell[0]), 0.0, 1.0, 1.0, 1.0


@fast_subkernel
def _collage(m, u, v, fp, variation):  # type: ignore[no-untyped-def]
    other, third, lightness, seed = 0.0, 0.0, 1.0, m.seed + variation
    scale = 1.0
    for level in range(4):
        cu, cv = m.cell[0] * scale, m.cell[1] * scale
        x, y = u / cu + 0.37 * level, v / cv + 0.61 * level
        column, row = math.floor(x), math.floor(y)
        chance = cell_hash(int(column), int(row), seed + level)
        if chance < 0.35 + 0.4 * m.detail and fp < 0.8 * min(cu, cv):
            a, b = cell_hash(int(column), int(row), seed + 31), cell_hash(int(row), int(column), seed + 47)
            x, y = x - column, y - row
            cover = _inside(x * cu, y * cv, 0.4 * a * cu, 0.4 * b * cv, (0.6 + 0.4 * b) * cu, (0.55 + 0.4 * a) * cv, fp)
            cover *= _visible(min(cu, cv), 2.0 * fp)
            other += (b - other) * cover
            third += ((a if chance < 0.2 else 0.0) - third) * cover
            lightness += (0.55 + 0.8 * cell_hash(int(column), int(row), seed + 61) - lightness) * cover
        scale *= 0.47
    return other, third, lightness, 1.0, 1.0


@fast_subkernel
def _road(m, u, v, fp):  # type: ignore[no-untyped-def]
    half, period, line, seed = m.cell[0], m.cell[1], m.line, m.seed
    across = abs(u)
    patch = fractal_noise(u * 0.22, v * 0.07, seed, fp * 0.22, 3)
    worn = 1.0 + 0.55 * fractal_noise(u * 5.0, v * 5.0, seed + 9, fp * 5.0, 3)
    speck = fractal_noise(u * 21.0, v * 21.0, seed + 5, fp * 21.0, 2)
    track = 0.06 * math.cos(across * 4.2)
    crack = abs(smooth_noise(u * 0.45 + 0.3 * patch, v * 0.3, seed + 3) - 0.5)
    crack = (1.0 - _step(crack - 0.006, 0.008 + fp)) * 0.35 * _visible(0.05, fp)
    edge = _inside(across, 0.0, half - 0.35 - line, -1.0, half - 0.35, 1.0, fp) * (0.8 if m.detail > 0.3 else 0.0)
    dash = _step(0.5 * line - across, fp) * pulse(v / period, 0.42, fp / period)
    if m.detail > 0.75:
        dash = _inside(across, 0.0, 0.07, -1.0, 0.07 + line, 1.0, fp)
    if half > 6.0:  # two lanes each way
        dash = max(
            dash,
            _inside(across, 0.0, 0.5 * half, -1.0, 0.5 * half + line, 1.0, fp) * pulse(v / period, 0.42, fp / period),
        )
    paint = max(dash, edge) * min(1.0, max(0.0, worn * 1.1))
    on_paint = 1.0 - paint
    lightness = 1.0 + on_paint * (0.35 * patch + 0.55 * speck + 0.2 * (worn - 1.0) + track - crack)
    return (paint, 0.0, lightness, 1.0, 1.0) if m.detail <= 0.75 or across > 1.0 else (0.0, paint, lightness, 1.0, 1.0)


@fast_subkernel
def _grass_material(m, u, v, fp):  # type: ignore[no-untyped-def]
    seed = m.seed
    large = fractal_noise(u * 0.3, v * 0.3, seed, fp * 0.3, 4)
    blades = fractal_noise(u * 9.0, v * 9.0, seed + 4, fp * 9.0, 4)
    dry = min(1.0, max(0.0, 0.25 + 1.1 * large + 0.4 * (m.detail - 0.5)))
    return min(1.0, max(0.0, 0.5 + blades)), dry * 0.6, 1.0 + 0.7 * blades, 1.0, 1.0


@fast_subkernel
def _wallpaper(m, u, v, fp):  # type: ignore[no-untyped-def]
    cu, cv, seed = m.cell[0], m.cell[1], m.seed
    row = math.floor(v / cv)
    x, y = u / cu + 0.5 * (row & 1), v / cv
    x, y = abs(x - math.floor(x) - 0.5), abs(y - row - 0.5)
    kind = cell_hash(seed, 1, 1)
    blur = fp / min(cu, cv) + 0.02
    if kind < 0.35:
        motif = _step(0.3 - math.sqrt(x * x + y * y), blur)
    elif kind < 0.7:
        motif = _step(0.36 - (x + y), blur)
    else:
        motif = _step(abs(x - 0.25) - 0.13, blur) * 0.7
    dot = _step(0.1 - math.sqrt(x * x + y * y), blur)
    visible = _visible(min(cu, cv), fp)
    return 0.35 + (motif - 0.35) * visible, dot * visible * 0.8, 1.0, 1.0, 1.0


@fast_subkernel
def _panels(m, u, v, fp):  # type: ignore[no-untyped-def]
    cu, cv, line = m.cell[0], m.cell[1], m.line
    column, row = math.floor(u / cu), math.floor(v / cv)
    joint = 1.0 - (1.0 - pulse(u / cu, line / cu, fp / cu)) * (1.0 - pulse(v / cv, line / cv, fp / cv))
    lit = (int(column) % 4 == 1 and int(row) % 3 == 1) and cell_hash(int(column), int(row), m.seed) < m.detail
    x, y = u - column * cu, v - row * cv
    lamp = _inside(x, y, 0.06, 0.06, cu - 0.06, cv - 0.06, fp) if lit else 0.0
    return joint * (1.0 - lamp), lamp, 1.0, 1.0 - joint, lamp


@fast_subkernel
def _ribs(m, u, v, fp):  # type: ignore[no-untyped-def]
    wave = math.cos(u / m.cell[0] * 2.0 * math.pi) * _visible(m.cell[0], 1.6 * fp)
    seam = pulse(v / m.cell[1], m.line / m.cell[1], fp / m.cell[1])
    return 0.5 + 0.5 * wave, seam * 0.7, 1.0 + 0.16 * wave, 1.0, 1.0


@fast_subkernel
def _picture(m, u, v, hu, hv, fp, variation):  # type: ignore[no-untyped-def]
    line, seed = m.line, m.seed + variation
    frame = 1.0 - _inside(u, v, -hu + line, line, hu - line, 2.0 * hv - line, fp)
    mount = 1.0 - _inside(u, v, -hu + 2.4 * line, 2.4 * line, hu - 2.4 * line, 2.0 * hv - 2.4 * line, fp)
    x, y = u / hu, v / hv
    ridge = 0.9 + 0.9 * fractal_noise(1.3 * x, 0.0, seed, fp / hu, 4)
    paint = fractal_noise(2.0 * x, 2.5 * y, seed + 8, 2.0 * fp / hu, 4)
    land = _step(ridge - y, 0.05 + fp / hv)
    other = min(1.0, max(0.0, land + 0.6 * paint))
    lightness = 0.75 + 0.5 * y * (1.0 - land) + 0.9 * paint
    if cell_hash(seed, 4, 4) < 0.45:
        other, _, lightness, _, _ = _collage(m, u, v, fp, variation)
    if mount > 0.0:
        lightness += (1.5 - lightness) * mount
        other *= 1.0 - mount
    return other, frame, lightness + (1.0 - lightness) * frame, 1.0, 1.0


@fast_subkernel
def _books(m, u, v, hv, fp, variation):  # type: ignore[no-untyped-def]
    seed = m.seed + variation
    cell = math.floor(u / m.cell[0])
    shift = cell_hash(int(cell), 9, seed) * 0.5
    inner = math.floor(u / m.cell[0] + shift)
    a, b = cell_hash(int(inner), 1, seed), cell_hash(int(inner), 2, seed)
    top = 2.0 * hv * (0.68 + 0.3 * a)
    gap = 1.0 - _step(top - v, fp)
    side = pulse(u / m.cell[0] + shift, 0.1, fp / m.cell[0])
    title = _inside(0.0, v, -1.0, 0.55 * top, 1.0, (0.62 + 0.2 * b) * top, fp) * (1.0 if a < 0.6 else 0.0)
    visible = _visible(m.cell[0], fp)
    third = 0.3 + visible * ((1.0 if b > 0.7 else 0.0) - 0.3)
    lightness = 1.0 + visible * (0.45 + 1.1 * cell_hash(int(inner), 3, seed) - 1.0) + 0.5 * title * visible
    lightness *= (1.0 - 0.85 * gap) * (1.0 - 0.5 * side)
    return 0.5 + visible * (b - 0.5), third * (1.0 - gap), lightness, 1.0 - gap, 1.0


@fast_subkernel
def _rug(m, u, v, hu, hv, fp):  # type: ignore[no-untyped-def]
    margin = min(hu - abs(u), hv - abs(v - hv))
    outer = _step(0.06 - margin, fp)
    band = _step(margin - 0.14, fp) * _step(0.24 - margin, fp)
    other, dot, _, _, _ = _wallpaper(m, u, v, fp)
    inner = _step(margin - 0.24, fp)
    return max(band, other * inner), max(outer, dot * inner), 1.0, 1.0, 1.0


@fast_subkernel
def _window(m, u, v, hu, hv, fp, variation):  # type: ignore[no-untyped-def]
    line, cu, cv = m.line, m.cell[0], m.cell[1]
    glass = _inside(u, v, -hu + line, line, hu - line, 2.0 * hv - line, fp)
    bars = 1.0 - (1.0 - pulse(u / cu + 0.5 * line / cu, line / cu, fp / cu)) * (1.0 - pulse(v / cv, line / cv, fp / cv))
    glass *= 1.0 - bars
    drawn = cell_hash(variation, 5, m.seed)
    lightness = 0.7 + 0.6 * v / (2.0 * hv) + (0.6 if drawn > 0.6 else 0.0)
    return glass, 1.0 - glass, 1.0 + glass * (lightness - 1.0), glass, 1.0


@fast_subkernel
def _leaves(x, y, z, fp, variation):  # type: ignore[no-untyped-def]
    clump = smooth_noise_3d(x * 1.3, y * 1.3, z * 1.3, variation) - 0.5
    twig = (smooth_noise_3d(x * 7.0, y * 7.0, z * 7.0, variation + 3) - 0.5) * _visible(0.12, fp)
    leaf = 0.0
    if fp < 0.05:
        leaf = (smooth_noise_3d(x * 23.0, y * 23.0, z * 23.0, variation + 5) - 0.5) * _visible(0.04, fp)
    fine = 0.6 * twig + 0.8 * leaf
    return min(1.0, max(0.0, 0.5 + clump + fine)), 0.0, 1.05 + 0.7 * clump + fine, 1.0, 1.0


@fast_subkernel
def pattern_at(m, point, fp):  # type: ignore[no-untyped-def]  # noqa: C901
    """Shares of the second and third colour at a :class:`FacePoint`, and factors on brightness, gloss and glow."""
    u, v, hu, hv, x, y, z, variation = point
    # one flat list: numba compiles every level of calls again for the level above
    pattern = m.pattern
    result = (0.0, 0.0, 1.0, 1.0, 1.0)
    if pattern in (Pattern.BRICK, Pattern.TILES):
        result = _masonry(m, u, v, fp, pattern == Pattern.BRICK)
    elif pattern == Pattern.CHECKER:
        result = _checker(m, u, v, fp)
    elif pattern == Pattern.PLANKS:
        result = _planks(m, u, v, fp)
    elif pattern == Pattern.FACADE:
        result = _facade(m, u, v, hu, hv, fp)
    elif pattern == Pattern.STRIPES:
        result = _stripes(m, u, v, fp)
    elif pattern == Pattern.COLLAGE:
        result = _collage(m, u, v, fp, variation)
    elif pattern == Pattern.ROAD:
        return _road(m, u, v, fp)
    elif pattern == Pattern.GRASS:
        return _grass_material(m, u, v, fp)
    elif pattern == Pattern.WALLPAPER:
        result = _wallpaper(m, u, v, fp)
    elif pattern == Pattern.LEAVES:
        return _leaves(x, y, z, fp, variation)
    elif pattern == Pattern.PANELS:
        result = _panels(m, u, v, fp)
    elif pattern == Pattern.RIBS:
        result = _ribs(m, u, v, fp)
    elif pattern == Pattern.PICTURE:
        result = _picture(m, u, v, hu, hv, fp, variation)
    elif pattern == Pattern.BOOKS:
        result = _books(m, u, v, hv, fp, variation)
    elif pattern == Pattern.RUG:
        result = _rug(m, u, v, hu, hv, fp)
    elif pattern == Pattern.WINDOW:
        result = _window(m, u, v, hu, hv, fp, variation)
    second, third, lightness, gloss, glow = result
    if m.grain > 0.0:
        size, seed = m.grain_size, m.seed + variation
        grain = fractal_noise((u + variation) / size, v / size, seed, fp / size, 5)
        if pattern == Pattern.PLAIN:  # stains
            second = min(1.0, max(0.0, (grain + m.detail - 0.5) * 1.6))
        lightness *= 1.0 + 2.0 * m.grain * grain
    return second, third, lightness, gloss, glow


@fast_subkernel
def is_hole(m, point):  # type: ignore[no-untyped-def]
    """Whether a ray passes between leaves or bars at a :class:`FacePoint`."""
    u, v, _, hv, x, y, z, variation = point
    pattern = m.pattern
    if pattern == Pattern.LEAVES:
        size = m.cell[0]
        return smooth_noise_3d(x / size, y / size, z / size, m.seed + variation) > 1.0 - 0.62 * m.detail
    rail = v < m.line or v > 2.0 * hv - m.line or abs(v - 0.18 * hv) < 0.5 * m.line
    fence = u / m.cell[0]
    return not rail and abs(fence - math.floor(fence) - 0.5) * m.cell[0] > 0.5 * m.line
