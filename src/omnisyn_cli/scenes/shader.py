"""The colour of what a ray hits: material or photograph on it, sun with shadow, sky, lamps, gloss, haze."""

import math
from typing import NamedTuple

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, fast_subkernel
from omnisyn_cli.scenes.materials import PhotoMapping
from omnisyn_cli.scenes.noise import cell_hash, fractal_noise, smooth_noise
from omnisyn_cli.scenes.scene import Shape
from omnisyn_cli.scenes.textures import FacePoint, is_hole, pattern_at

PATCHES_PER_PHOTO = 0.6  # Patches of the ground whose texture is turned, per width of a photograph; chosen by eye
# How the footprint grows with the slant: 1 blurs a photograph to its long side, 0.5 to the mean of both sides.
SLANT_EXPONENT = 0.75
SHADOW_RAY_OFFSET = 1e-3  # Metres between a surface and the start of its shadow ray, so that it does not shadow itself


class Surfaces(NamedTuple):
    """Shapes, materials, and of each triangle its shape and axis (:data:`omnisyn_cli.scenes.scene.UNIT_SHAPES`)."""

    shapes: np.ndarray
    materials: np.ndarray
    owner: np.ndarray
    axis: np.ndarray


@fast_subkernel
def _to_unit(shape, px, py, pz):  # type: ignore[no-untyped-def]
    """A point of the world in the frame of the unit shape."""
    a, b, c = px - shape.centre[0], py - shape.centre[1], pz - shape.centre[2]
    r, half = shape.rotation, shape.half
    x = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / half[0]
    y = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / half[1]
    z = (r[0, 2] * a + r[1, 2] * b + r[2, 2] * c) / half[2]
    return x, y, z


@fast_subkernel
def _to_world(shape, x, y, z):  # type: ignore[no-untyped-def]
    """A vector of the shape's own frame, in metres, in the world."""
    r = shape.rotation
    return (
        r[0, 0] * x + r[0, 1] * y + r[0, 2] * z,
        r[1, 0] * x + r[1, 1] * y + r[1, 2] * z,
        r[2, 0] * x + r[2, 1] * y + r[2, 2] * z,
    )


@fast_subkernel
def _face_point(shape, axis, x, y, z):  # type: ignore[no-untyped-def]
    """Where a point of a unit shape lies on its face."""
    hx, hy, hz = shape.half[0], shape.half[1], shape.half[2]
    u, v, half_u, half_v = x * hx, (y + 1.0) * hy, hx, hy
    if axis == 1:
        v, half_v = (z + 1.0) * hz, hz
    elif shape.kind != Shape.BOX:
        u, half_u = math.atan2(x, z) * hx, math.pi * hx
    elif axis == 0:
        u, half_u = z * hz, hz
    return FacePoint(u, v, half_u, half_v, x * hx, y * hy, z * hz, shape.variation)


@fast_kernel
def find_holes(surfaces, face, points, is_open):  # type: ignore[no-untyped-def]
    """Whether rays pass between leaves or bars at points of faces; (n,) faces, (n, 3) points, (n,) results."""
    for i in range(len(face)):
        shape, axis = surfaces.shapes[surfaces.owner[face[i]]], surfaces.axis[face[i]]
        material = surfaces.materials[shape.material[1 if axis == 1 else 0]]
        x, y, z = _to_unit(shape, points[i, 0], points[i, 1], points[i, 2])
        is_open[i] = material.is_perforated and is_hole(material, _face_point(shape, axis, x, y, z))


@fast_kernel
def find_surfaces(surfaces, face, points, directions, starts, normals):  # type: ignore[no-untyped-def]
    """Fill the normals, towards the rays' origins, of shapes (what is round is round), and starts to the light."""
    for i in range(len(face)):
        if face[i] < 0:
            continue
        shape, axis = surfaces.shapes[surfaces.owner[face[i]]], surfaces.axis[face[i]]
        x, y, z = _to_unit(shape, points[i, 0], points[i, 1], points[i, 2])
        nx, ny, nz = x, y, z
        if shape.kind == Shape.BOX or axis == 1:
            nx = math.copysign(1.0, x) if axis == 0 else 0.0
            ny = math.copysign(1.0, y) if axis == 1 else 0.0
            nz = math.copysign(1.0, z) if axis == 2 else 0.0
        elif shape.kind == Shape.ELLIPSOID:
            grown = 1.0 / math.sqrt(x * x + y * y + z * z)
            x, y, z = x * grown, y * grown, z * grown
        else:
            radius, ny = (1.0, 0.0) if shape.kind == Shape.CYLINDER else (0.5 * (1.0 - y), 0.25 * (1.0 - y))
            grown = radius / max(math.sqrt(x * x + z * z), 1e-9)
            x, z = x * grown, z * grown
        half = shape.half
        nx, ny, nz = _to_world(shape, nx / half[0], ny / half[1], nz / half[2])
        px, py, pz = _to_world(shape, x * half[0], y * half[1], z * half[2])
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if nx * directions[i, 0] + ny * directions[i, 1] + nz * directions[i, 2] > 0.0:
            length = -length
        normals[i, 0], normals[i, 1], normals[i, 2] = nx / length, ny / length, nz / length
        starts[i, 0] = px + shape.centre[0] + SHADOW_RAY_OFFSET * normals[i, 0]
        starts[i, 1] = py + shape.centre[1] + SHADOW_RAY_OFFSET * normals[i, 1]
        starts[i, 2] = pz + shape.centre[2] + SHADOW_RAY_OFFSET * normals[i, 2]


@fast_subkernel
def _mirror_repeat(i, count):  # type: ignore[no-untyped-def]
    """The texel that index i means where a row of them is repeated, every second time backwards."""
    i %= 2 * count
    return i if i < count else 2 * count - 1 - i


@fast_subkernel
def _bilinear(texels, level, x, y):  # type: ignore[no-untyped-def]
    """Light at (x, y) of a mip level, both in its widths and heights."""
    first, height, width = level[0], level[1], level[2]
    x, y = x * width - 0.5, y * height - 0.5
    left, top = math.floor(x), math.floor(y)
    across, down = x - left, y - top
    light = (0.0, 0.0, 0.0)
    for row, of_row in ((0, 1.0 - down), (1, down)):
        begin = first + _mirror_repeat(int(top) + row, height) * width
        for column, of_column in ((0, 1.0 - across), (1, across)):
            texel, weight = begin + _mirror_repeat(int(left) + column, width), of_row * of_column / 255.0**2
            r, g, b = float(texels[texel, 0]), float(texels[texel, 1]), float(texels[texel, 2])
            light = (light[0] + weight * r * r, light[1] + weight * g * g, light[2] + weight * b * b)
    return light


@fast_subkernel
def _trilinear(texels, levels, x, y, lod):  # type: ignore[no-untyped-def]
    """The same between two mip levels; ``lod`` is the binary logarithm of the texels that a sample covers."""
    lod = min(max(lod, 0.0), len(levels) - 1.0)
    k = min(int(lod), len(levels) - 2)
    return _mixed(_bilinear(texels, levels[k], x, y), _bilinear(texels, levels[k + 1], x, y), lod - k)


@fast_subkernel
def _mixed(first, second, share):  # type: ignore[no-untyped-def]
    return (
        first[0] + (second[0] - first[0]) * share,
        first[1] + (second[1] - first[1]) * share,
        first[2] + (second[2] - first[2]) * share,
    )


@fast_subkernel
def photo_at(photos, material, point, footprint):  # type: ignore[no-untyped-def]
    """Linear colour of the photograph on a material at a :class:`FacePoint`; the footprint is in metres."""
    texels, levels = photos.texels, photos.levels[material.photo]
    seed, width = material.photo_seed, material.photo_width
    rows, columns = levels[0, 1], levels[0, 2]
    u, v = point.u, point.v
    if material.photo_mapping == PhotoMapping.FITTED:
        texel = max(2.0 * point.half_u / columns, 2.0 * point.half_v / rows)
        x, y = 0.5 + u / (texel * columns), 0.5 - (v - point.half_v) / (texel * rows)
    else:
        texel = width / columns
        x = u / width + 2.0 * cell_hash(point.variation, 1, seed)
        y = 2.0 * cell_hash(point.variation, 2, seed) - v / (texel * rows)
    lod = math.log2(max(footprint / texel, 1e-6))
    colour = _trilinear(texels, levels, x, y, lod)
    if material.has_patches:
        patch = smooth_noise(PATCHES_PER_PHOTO * u / width, PATCHES_PER_PHOTO * v / width, seed)
        turned = _trilinear(texels, levels, 0.37 - v / width, 0.71 - u / (texel * rows), lod)
        colour = _mixed(colour, turned, min(1.0, max(0.0, 0.5 + 6.0 * (patch - 0.5))))
    return colour


@fast_subkernel
def _sky(light, x, y, z, pixel):  # type: ignore[no-untyped-def]
    """Colour of the sky in a direction."""
    up = max(y, 0.0)
    near = 1.0 / (up + 0.12)
    scale, cover, sun = light.cloud_scale, light.cloud_cover, light.sun_direction
    # neighbouring rays meet the layer of clouds the farther apart the nearer they are to the horizon
    footprint = pixel * near * near * scale
    density = fractal_noise(x * near * scale + 31.7, z * near * scale + 11.3, light.seed, footprint, 5)
    cloud = min(1.0, max(0.0, 0.5 + 2.6 * (density + 1.1 * (cover - 0.5)))) * min(1.0, 0.25 + 6.0 * up)
    shadow = 1.0 - 0.35 * min(1.0, max(0.0, density * 1.6))
    glow = max(0.0, x * sun[0] + y * sun[1] + z * sun[2]) ** 4
    halo = 0.25 * glow * (1.0 - 0.5 * cover)
    glow = glow**8
    halo += 0.9 * glow * (1.0 - 0.8 * cover) + 6.0 * glow**8 * (1.0 - cloud)
    r, g, b = _mixed(_mixed(light.horizon, light.zenith, math.sqrt(up)), light.cloud, cloud)
    dark, halo = cloud * (1.0 - shadow), 0.3 * halo
    r += halo * light.sun[0] - dark * light.cloud[0]
    g += halo * light.sun[1] - dark * light.cloud[1]
    b += halo * light.sun[2] - dark * light.cloud[2]
    return r, g, b


@fast_subkernel
def _incident(light, lamps, point, normal, sunlit):  # type: ignore[no-untyped-def]
    """Light that falls on a point; ``sunlit`` is the cosine under which it sees the sun."""
    r, g, b = _mixed(light.bounce, light.sky, 0.5 + 0.5 * normal[1])
    r, g, b = r + light.sun[0] * sunlit, g + light.sun[1] * sunlit, b + light.sun[2] * sunlit
    for i in range(len(lamps)):
        x, y, z = lamps[i, 0] - point[0], lamps[i, 1] - point[1], lamps[i, 2] - point[2]
        squared = x * x + y * y + z * z
        facing = (normal[0] * x + normal[1] * y + normal[2] * z) / math.sqrt(squared + 1e-6)
        power = max(0.0, 0.15 + 0.85 * facing) / (0.6 + squared)
        r, g, b = r + lamps[i, 3] * power, g + lamps[i, 4] * power, b + lamps[i, 5] * power
    return r, g, b


@fast_subkernel
def _albedo(material, photos, point, footprint, blurred):  # type: ignore[no-untyped-def]
    """Linear colour, and factors on gloss and glow; footprints in metres, of patterns and of photographs."""
    second, third, lightness, gloss, glow = pattern_at(material, point, footprint)
    r, g, b = material.first[0], material.first[1], material.first[2]
    if material.photo >= 0:
        r, g, b = photo_at(photos, material, point, blurred)
        if material.photo_mapping != PhotoMapping.UNDER:
            second, third = 0.0, third if material.photo_mapping == PhotoMapping.FITTED else 0.0
            lightness = lightness if material.pattern == 0 else 1.0
    lightness = max(lightness, 0.02)
    r, g, b = _mixed(_mixed((r, g, b), material.second, second), material.third, third)
    return r * lightness, g * lightness, b * lightness, gloss, glow


@fast_subkernel
def _shade(scene, shape, axis, sun, ray, normal, sunlit, pixel):  # type: ignore[no-untyped-def]
    """Linear colour of a surface at distance t."""
    surfaces, photos, light, lamps = scene
    point, direction, t = ray
    material = surfaces.materials[shape.material[1 if axis == 1 else 0]]
    x, y, z = _to_unit(shape, point[0], point[1], point[2])
    place = _face_point(shape, axis, x, y, z)
    crease = 1.0 if axis == 1 else 1.0 - 0.3 / (1.0 + place.v * place.v * 60.0)  # dirt where things meet the floor
    facing = -(normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2])
    footprint = t * pixel / math.sqrt(max(facing, 0.01))  # mean of both sides of the slanted sample
    blurred = t * pixel / max(facing, 0.03) ** SLANT_EXPONENT
    ar, ag, ab, gloss, glow = _albedo(material, photos, place, footprint, blurred)
    r, g, b = _incident(light, lamps, point, normal, sunlit)
    glow *= material.glow
    tint = shape.tint
    r, g, b = ar * tint * (r * crease + glow), ag * tint * (g * crease + glow), ab * tint * (b * crease + glow)
    gloss *= material.gloss
    if gloss > 0.0:
        up = direction[1] + 2.0 * facing * normal[1]
        weight = gloss * (0.08 + 0.7 * (1.0 - facing) ** 3)  # as Fresnel: hardly any from above, most at grazing angles
        above = min(1.0, max(0.0, 0.5 + 2.0 * up))
        toward = direction[0] * sun[0] + direction[1] * sun[1] + direction[2] * sun[2]
        toward += 2.0 * facing * (normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2])
        shine = max(0.0, toward) ** 64 * 0.6 * gloss if sunlit > 0.0 else 0.0
        bright = (1.3 * light.sky[0], 1.3 * light.sky[1], 1.3 * light.sky[2])
        r, g, b = _mixed((r, g, b), _mixed(light.bounce, bright, above), weight)
        r, g, b = r + shine * light.sun[0], g + shine * light.sun[1], b + shine * light.sun[2]
    if light.haze > 0.0:
        r, g, b = _mixed((r, g, b), light.horizon, 1.0 - math.exp(-light.haze * t))
    return r, g, b


@fast_kernel
def shade_rays(scene, sun, hits, normals, sunlit, pixel, colours):  # type: ignore[no-untyped-def]
    """Fill the colours, (n, 3) in [0, 1], of rays.

    ``scene``: its ``(surfaces, photos, lighting, lamps)``; ``sun``: unit vector to its point that shines; ``hits``:
    ``(points, directions, face, distance)`` of all rays. Normals look towards the origins. ``sunlit``: cosine under
    which each point sees the sun, 0 in the shadow. ``pixel``: radians between samples.
    """
    points, directions, face, distance = hits
    surfaces, _, light, _ = scene
    for i in range(len(face)):
        direction = (directions[i, 0], directions[i, 1], directions[i, 2])
        if face[i] < 0:
            r, g, b = _sky(light, direction[0], direction[1], direction[2], pixel)
        else:
            shape, axis = surfaces.shapes[surfaces.owner[face[i]]], surfaces.axis[face[i]]
            ray = (points[i, 0], points[i, 1], points[i, 2]), direction, distance[i]
            normal = (normals[i, 0], normals[i, 1], normals[i, 2])
            r, g, b = _shade(scene, shape, axis, sun, ray, normal, sunlit[i], pixel)
        colours[i, 0], colours[i, 1], colours[i, 2] = _film(r, light), _film(g, light), _film(b, light)


@fast_subkernel
def _film(value, light):  # type: ignore[no-untyped-def]
    """Light as film shows it: highlights roll off; then the square root, as displays expect."""
    return math.sqrt(1.0 - math.exp(-light.exposure * max(value, 0.0)))
