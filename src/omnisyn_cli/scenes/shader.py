"""The colour of what a ray hits: material or photograph on it, sun with shadow, sky, lamps, gloss, haze."""

import math

from omnisyn_cli.scenes.intersection import is_shadowed, surface_normal, texture_coordinates
from omnisyn_cli.scenes.kernel_decorators import kernel
from omnisyn_cli.scenes.materials import MaterialColumn
from omnisyn_cli.scenes.noise import cell_hash, fractal_noise, smooth_noise
from omnisyn_cli.scenes.photos import PhotoMapping
from omnisyn_cli.scenes.textures import FacePoint, pattern_at
from omnisyn_cli.scenes.world import GROUND_ID, SKY_ID, AttributeColumn, Scalar, ShapeColumn

UNDER_MAPPING, FITTED_MAPPING = float(PhotoMapping.UNDER), float(PhotoMapping.FITTED)
"""As a packed material has them, in floats."""

PATCHES_PER_PHOTO = 0.6
"""Patches of the ground whose texture is turned, per width of a photograph; chosen by eye."""


@kernel
def _mirror_repeat(i, count):  # type: ignore[no-untyped-def]
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
    a, b = _mirror_repeat(int(left), width), _mirror_repeat(int(left) + 1, width)
    upper, lower = (
        first + _mirror_repeat(int(top), height) * width,
        first + _mirror_repeat(int(top) + 1, height) * width,
    )
    wa, wb = (1.0 - across) * (1.0 - down), across * (1.0 - down)
    wc, wd = (1.0 - across) * down, across * down
    light = (0.0, 0.0, 0.0)
    for weight, texel in ((wa, upper + a), (wb, upper + b), (wc, lower + a), (wd, lower + b)):
        r, g, b_ = texels[texel, 0] / 255.0, texels[texel, 1] / 255.0, texels[texel, 2] / 255.0
        light = (light[0] + weight * r * r, light[1] + weight * g * g, light[2] + weight * b_ * b_)
    return light


@kernel
def _trilinear(texels, levels, x, y, lod):  # type: ignore[no-untyped-def]
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
def photo_at(photos, row, noise, point, footprint):  # type: ignore[no-untyped-def]
    """Linear colour of the photograph on the material ``row`` at a :class:`FacePoint`; the footprint is in metres."""
    photo, mapping, width, seed, has_patches = photos.assignment[row]
    texels, levels, seed = photos.texels, photos.levels[int(photo)], int(seed)
    rows, columns = levels[0, 1], levels[0, 2]
    u, v = point.u, point.v
    if mapping == FITTED_MAPPING:
        texel = max(2.0 * point.half_u / columns, 2.0 * point.half_v / rows)
        x, y = 0.5 + u / (texel * columns), 0.5 - (v - point.half_v) / (texel * rows)
    else:
        texel = width / columns
        x = u / width + 2.0 * cell_hash(point.variation, 1, seed)
        y = 2.0 * cell_hash(point.variation, 2, seed) - v / (texel * rows)
    lod = math.log2(max(footprint / texel, 1e-6))
    r, g, b = _trilinear(texels, levels, x, y, lod)
    if has_patches > 0.0:
        patch = smooth_noise(noise, PATCHES_PER_PHOTO * u / width, PATCHES_PER_PHOTO * v / width, seed)
        share = min(1.0, max(0.0, 0.5 + 6.0 * (patch - 0.5)))
        if share > 0.0:
            cr, cg, cb = _trilinear(texels, levels, 0.37 - v / width, 0.71 - u / (texel * rows), lod)
            r, g, b = r + (cr - r) * share, g + (cg - g) * share, b + (cb - b) * share
    return r, g, b


PATTERN, FIRST_COLOUR, SECOND_COLOUR, THIRD_COLOUR, _, _, _, _, _, _, GLOSS, GLOW, _, _, _ = map(int, MaterialColumn)
EYE, HALF_COLUMN, TINT = int(ShapeColumn.EYE), int(ShapeColumn.HALF), int(ShapeColumn.TINT)
SHAPE, SIDES, CAPS, VARIATION, _ = map(int, AttributeColumn)
SUN, SKY_LIGHT_COLUMN, BOUNCE_COLUMN, ZENITH = (
    int(Scalar.SUN),
    int(Scalar.SKY_LIGHT),
    int(Scalar.BOUNCE),
    int(Scalar.ZENITH),
)
HORIZON, CLOUD, CLOUD_COVER = int(Scalar.HORIZON), int(Scalar.CLOUD), int(Scalar.CLOUD_COVER)
CLOUD_SCALE, CLOUD_SEED, HAZE = int(Scalar.CLOUD_SCALE), int(Scalar.CLOUD_SEED), int(Scalar.HAZE)
SUN_DIRECTIONS, PLANE = int(Scalar.SUN_DIRECTIONS), int(Scalar.GROUND_PLANE)
WORLD_EYE, GROUND_MATERIAL = int(Scalar.EYE), int(Scalar.GROUND_MATERIAL)
SLANT_EXPONENT = 0.75
"""How the footprint grows with the slant: 1 blurs a photograph to its long side, 0.5 to the mean of both sides."""

SHADOW_RAY_OFFSET = 1e-3
"""Metres between a surface and the start of its shadow ray, so that it does not shadow itself."""


@kernel
def _sky(s, noise, x, y, z, pixel):  # type: ignore[no-untyped-def]
    """Colour of the sky in a direction."""
    up = max(y, 0.0)
    near = 1.0 / (up + 0.12)
    scale, cover = s[CLOUD_SCALE], s[CLOUD_COVER]
    # neighbouring rays meet the layer of clouds the farther apart the nearer they are to the horizon
    footprint = pixel * near * near * scale
    density = fractal_noise(noise, x * near * scale + 31.7, z * near * scale + 11.3, int(s[CLOUD_SEED]), footprint, 5)
    cloud = min(1.0, max(0.0, 0.5 + 2.6 * (density + 1.1 * (cover - 0.5)))) * min(1.0, 0.25 + 6.0 * up)
    shadow = 1.0 - 0.35 * min(1.0, max(0.0, density * 1.6))
    toward = max(0.0, x * s[SUN_DIRECTIONS] + y * s[SUN_DIRECTIONS + 1] + z * s[SUN_DIRECTIONS + 2])
    glow = toward**4
    halo = 0.25 * glow * (1.0 - 0.5 * cover)
    glow = glow**8
    halo += 0.9 * glow * (1.0 - 0.8 * cover) + 6.0 * glow**8 * (1.0 - cloud)
    height = math.sqrt(up)
    r = s[HORIZON] + (s[ZENITH] - s[HORIZON]) * height
    g = s[HORIZON + 1] + (s[ZENITH + 1] - s[HORIZON + 1]) * height
    b = s[HORIZON + 2] + (s[ZENITH + 2] - s[HORIZON + 2]) * height
    r += (s[CLOUD] * shadow - r) * cloud + halo * s[SUN] * 0.3
    g += (s[CLOUD + 1] * shadow - g) * cloud + halo * s[SUN + 1] * 0.3
    b += (s[CLOUD + 2] * shadow - b) * cloud + halo * s[SUN + 2] * 0.3
    return r, g, b


@kernel
def _incident(world, px, py, pz, nx, ny, nz, sun):  # type: ignore[no-untyped-def]
    """Light that falls on a point, and how much of the sun, whose direction is at ``sun`` in the scalars, it sees."""
    s = world.scalars
    above = 0.5 + 0.5 * ny
    r = s[SKY_LIGHT_COLUMN] * above + s[BOUNCE_COLUMN] * (1.0 - above)
    g = s[SKY_LIGHT_COLUMN + 1] * above + s[BOUNCE_COLUMN + 1] * (1.0 - above)
    b = s[SKY_LIGHT_COLUMN + 2] * above + s[BOUNCE_COLUMN + 2] * (1.0 - above)
    x, y, z = s[sun], s[sun + 1], s[sun + 2]
    facing = nx * x + ny * y + nz * z
    sunlit = 0.0
    if facing > 0.0 and s[SUN] > 0.0:
        off = SHADOW_RAY_OFFSET
        if not is_shadowed(world, px + off * nx, py + off * ny, pz + off * nz, x, y, z):
            sunlit = 1.0
            r += s[SUN] * facing
            g += s[SUN + 1] * facing
            b += s[SUN + 2] * facing
    lamps = world.lamps
    for i in range(len(lamps)):
        x, y, z = lamps[i, 0] - px, lamps[i, 1] - py, lamps[i, 2] - pz
        squared = x * x + y * y + z * z
        facing = (nx * x + ny * y + nz * z) / math.sqrt(squared + 1e-6)
        power = max(0.0, 0.15 + 0.85 * facing) / (0.6 + squared)
        r += lamps[i, 3] * power
        g += lamps[i, 4] * power
        b += lamps[i, 5] * power
    return r, g, b, sunlit


@kernel
def shade(world, photos, hit, t, direction, pixel, sample):  # type: ignore[no-untyped-def]
    """Linear colour of what a ray hits.

    ``hit`` is the shape (or ``GROUND_ID``, ``SKY_ID``) and ``t`` its distance along ``direction``. ``pixel`` is the
    angle between neighbouring samples in radians. ``sample``, its index in the pixel, chooses a point on the sun.
    """
    x, y, z = direction
    s, shapes, attributes = world.scalars, world.shapes, world.attributes
    if hit == SKY_ID:
        return _sky(s, world.noise, x, y, z, pixel)
    sun = SUN_DIRECTIONS + 3 * (sample & 3)
    px, py, pz = s[WORLD_EYE] + t * x, s[WORLD_EYE + 1] + t * y, s[WORLD_EYE + 2] + t * z
    crease, tr, tg, tb = 1.0, 1.0, 1.0, 1.0
    if hit == GROUND_ID:
        nx, ny, nz = s[PLANE], s[PLANE + 1], s[PLANE + 2]
        u, v, hu, hv, qx, qy, qz, variation = px, pz, 1e3, 1e3, px, py, pz, 0
        row = int(s[GROUND_MATERIAL])
    else:
        shape = attributes[hit, SHAPE]
        qx = shapes[hit, EYE] + t * (shapes[hit, 0] * x + shapes[hit, 1] * y + shapes[hit, 2] * z)
        qy = shapes[hit, EYE + 1] + t * (shapes[hit, 3] * x + shapes[hit, 4] * y + shapes[hit, 5] * z)
        qz = shapes[hit, EYE + 2] + t * (shapes[hit, 6] * x + shapes[hit, 7] * y + shapes[hit, 8] * z)
        u, v, hu, hv, axis = texture_coordinates(shapes, hit, shape, qx, qy, qz)
        nx, ny, nz = surface_normal(shapes, hit, shape, axis, qx, qy, qz)
        qx, qy, qz = qx * shapes[hit, HALF_COLUMN], qy * shapes[hit, HALF_COLUMN + 1], qz * shapes[hit, HALF_COLUMN + 2]
        variation = attributes[hit, VARIATION]
        tr, tg, tb = shapes[hit, TINT], shapes[hit, TINT + 1], shapes[hit, TINT + 2]
        row = attributes[hit, CAPS if axis == 1 else SIDES]
        if axis != 1:  # dirt and missing light where things meet the floor
            crease = 1.0 - 0.3 / (1.0 + v * v * 60.0)
    material = world.materials[row]
    facing = -(nx * x + ny * y + nz * z)
    if facing < 0.0:
        nx, ny, nz, facing = -nx, -ny, -nz, -facing
    footprint = t * pixel / math.sqrt(max(facing, 0.01))  # mean of both sides of the slanted sample
    point = FacePoint(u, v, hu, hv, qx, qy, qz, variation)
    second, third, lightness, gloss, glow = pattern_at(material, world.noise, point, footprint)
    cr, cg, cb = material[FIRST_COLOUR], material[FIRST_COLOUR + 1], material[FIRST_COLOUR + 2]
    if row < len(photos.assignment) and photos.assignment[row, 0] >= 0.0:
        mapping, blurred = photos.assignment[row, 1], t * pixel / max(facing, 0.03) ** SLANT_EXPONENT
        cr, cg, cb = photo_at(photos, row, world.noise, point, blurred)
        if mapping != UNDER_MAPPING:
            second, third = 0.0, third if mapping == FITTED_MAPPING else 0.0
            lightness = lightness if material[PATTERN] == 0.0 else 1.0
    lightness = max(lightness, 0.02)
    first, second = (1.0 - second) * (1.0 - third) * lightness, second * (1.0 - third) * lightness
    third *= lightness
    ar = (cr * first + material[SECOND_COLOUR] * second + material[THIRD_COLOUR] * third) * tr
    ag = (cg * first + material[SECOND_COLOUR + 1] * second + material[THIRD_COLOUR + 1] * third) * tg
    ab = (cb * first + material[SECOND_COLOUR + 2] * second + material[THIRD_COLOUR + 2] * third) * tb
    r, g, b, sunlit = _incident(world, px, py, pz, nx, ny, nz, sun)
    glow *= material[GLOW]
    r, g, b = ar * (r * crease + glow), ag * (g * crease + glow), ab * (b * crease + glow)
    gloss *= material[GLOSS]
    if gloss > 0.0:
        rx, ry, rz = x + 2.0 * facing * nx, y + 2.0 * facing * ny, z + 2.0 * facing * nz
        weight = gloss * (0.08 + 0.7 * (1.0 - facing) ** 3)  # as Fresnel: hardly any from above, most at grazing angles
        above = min(1.0, max(0.0, 0.5 + 2.0 * ry))
        shine = max(0.0, rx * s[sun] + ry * s[sun + 1] + rz * s[sun + 2]) ** 64 * 0.6 * gloss * sunlit
        r += weight * (s[BOUNCE_COLUMN] + (s[SKY_LIGHT_COLUMN] * 1.3 - s[BOUNCE_COLUMN]) * above - r) + shine * s[SUN]
        g += (
            weight * (s[BOUNCE_COLUMN + 1] + (s[SKY_LIGHT_COLUMN + 1] * 1.3 - s[BOUNCE_COLUMN + 1]) * above - g)
            + shine * s[SUN + 1]
        )
        b += (
            weight * (s[BOUNCE_COLUMN + 2] + (s[SKY_LIGHT_COLUMN + 2] * 1.3 - s[BOUNCE_COLUMN + 2]) * above - b)
            + shine * s[SUN + 2]
        )
    if s[HAZE] > 0.0:
        haze = 1.0 - math.exp(-s[HAZE] * t)
        r += (s[HORIZON] - r) * haze
        g += (s[HORIZON + 1] - g) * haze
        b += (s[HORIZON + 2] - b) * haze
    return r, g, b


@kernel
def tone(value, exposure):  # type: ignore[no-untyped-def]
    """Compress light to [0, 1) as film does: highlights roll off."""
    return 1.0 - math.exp(-exposure * max(value, 0.0))
