"""What a ray hits first and how far away it is; whether a point lies in the shadow.

Rays meet shapes in each shape's own frame, scaled so that it fills the cube [-1, 1]³. A shape is hit where a ray
*enters* it; a ray that starts inside misses. Distances are in the units of the direction, so a unit vector in the world
gives metres although the local frame is scaled.
"""

import math

import numpy as np

from omnisyn_cli.scenes.culling import GRID
from omnisyn_cli.scenes.jit import inlined, kernel
from omnisyn_cli.scenes.textures import is_hole
from omnisyn_cli.scenes.world import GROUND, SKY, Kind, Packed, Scalar

MISS = 1e30
_NEAR = 1e-5
_TINY = 1e-12


@inlined
def _enter_box(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    dx = dx if abs(dx) > _TINY else _TINY
    dy = dy if abs(dy) > _TINY else _TINY
    dz = dz if abs(dz) > _TINY else _TINY
    ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
    ax, ay, az = abs(ix), abs(iy), abs(iz)
    mx, my, mz = -ox * ix, -oy * iy, -oz * iz
    enters = max(mx - ax, my - ay, mz - az)
    leaves = min(mx + ax, my + ay, mz + az)
    return enters if enters < leaves and enters > _NEAR else MISS


@inlined
def _enter_ellipsoid(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz - 1.0
    q = b * b - a * c
    if q <= 0.0 or b >= 0.0:
        return MISS
    t = (-b - math.sqrt(q)) / a
    return t if t > _NEAR else MISS


@inlined
def leave_ellipsoid(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Return the distance at which a ray comes out of the unit sphere, for leaves that are seen from behind."""
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    q = b * b - a * (ox * ox + oy * oy + oz * oz - 1.0)
    if q <= 0.0:
        return MISS
    t = (-b + math.sqrt(q)) / a
    return t if t > _NEAR else MISS


@inlined
def _enter_cylinder(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    a = dx * dx + dz * dz
    a = a if a > _TINY else _TINY
    b = ox * dx + oz * dz
    q = b * b - a * (ox * ox + oz * oz - 1.0)
    if q <= 0.0:
        return MISS
    root = math.sqrt(q)
    dy = dy if abs(dy) > _TINY else _TINY
    middle, reach = -oy / dy, abs(1.0 / dy)
    enters = max((-b - root) / a, middle - reach)
    leaves = min((-b + root) / a, middle + reach)
    return enters if enters < leaves and enters > _NEAR else MISS


@kernel
def _enter_cone(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    # x² + z² = ((1 - y) / 2)² between y = -1 (the base, radius 1) and y = 1 (the tip)
    h, k = 0.5 * (1.0 - oy), -0.5 * dy
    a = dx * dx + dz * dz - k * k
    b = ox * dx + oz * dz - h * k
    c = ox * ox + oz * oz - h * h
    best = MISS
    if abs(dy) > _TINY:  # through the base, from below
        t = (-1.0 - oy) / dy
        x, z = ox + t * dx, oz + t * dz
        if t > _NEAR and dy > 0.0 and x * x + z * z < 1.0:
            best = t
    q = b * b - a * c
    if q > 0.0 and abs(a) > _TINY:
        root = math.sqrt(q)
        for sign in (-1.0, 1.0):
            t = (-b + sign * root) / a
            y = oy + t * dy
            # outward normal · direction < 0: the ray enters here
            if t > _NEAR and t < best and y > -1.0 and y < 1.0 and a * t + b < 0.0:
                best = t
    return best


@inlined
def enter(shape, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Return the distance at which a ray enters a unit shape (a value of ``Shape``), ``MISS`` if it does not."""
    if shape == 0:
        return _enter_box(ox, oy, oz, dx, dy, dz)
    if shape == 1:
        return _enter_ellipsoid(ox, oy, oz, dx, dy, dz)
    if shape == 2:
        return _enter_cylinder(ox, oy, oz, dx, dy, dz)
    return _enter_cone(ox, oy, oz, dx, dy, dz)


EYE, NEAR, HALF = int(Packed.EYE), int(Packed.NEAR), int(Packed.HALF)
SHAPE, SIDES, CAPS, VARIATION, OPEN = (int(k) for k in (Kind.SHAPE, Kind.SIDES, Kind.CAPS, Kind.VARIATION, Kind.OPEN))
PLANE, WORLD_EYE, ACROSS, CELLS = int(Scalar.GROUND), int(Scalar.EYE), int(Scalar.ACROSS), int(Scalar.GRID)


@kernel
def place_on(shapes, k, shape, x, y, z):  # type: ignore[no-untyped-def]
    """Texture place of a point of a unit shape: ``(u, v, hu, hv, axis)`` in metres; axis 1 means a face up or down."""
    hx, hy, hz = shapes[k, HALF], shapes[k, HALF + 1], shapes[k, HALF + 2]
    if shape == 0:
        ax, ay, az = abs(x), abs(y), abs(z)
        if ay >= ax and ay >= az:
            return x * hx, (z + 1.0) * hz, hx, hz, 1
        if ax >= az:
            return z * hz, (y + 1.0) * hy, hz, hy, 0
        return x * hx, (y + 1.0) * hy, hx, hy, 2
    radial = math.sqrt(x * x + z * z)
    if (shape == 2 and abs(y) > radial) or (shape == 3 and radial < 0.5 * (1.0 - y) - 1e-6):
        return x * hx, (z + 1.0) * hz, hx, hz, 1
    return math.atan2(x, z) * hx, (y + 1.0) * hy, math.pi * hx, hy, 0


@kernel
def normal_at(shapes, k, shape, axis, x, y, z):  # type: ignore[no-untyped-def]
    """World normal at a point of a unit shape; ``axis`` as from :func:`place_on`."""
    if shape == 0:
        nx = (1.0 if x > 0.0 else -1.0) if axis == 0 else 0.0
        ny = (1.0 if y > 0.0 else -1.0) if axis == 1 else 0.0
        nz = (1.0 if z > 0.0 else -1.0) if axis == 2 else 0.0
    elif shape == 1:
        nx, ny, nz = x, y, z
    elif axis == 1:
        nx, ny, nz = 0.0, y, 0.0
    elif shape == 2:
        nx, ny, nz = x, 0.0, z
    else:
        nx, ny, nz = x, 0.25 * (1.0 - y), z
    a = shapes[k, 0] * nx + shapes[k, 3] * ny + shapes[k, 6] * nz
    b = shapes[k, 1] * nx + shapes[k, 4] * ny + shapes[k, 7] * nz
    c = shapes[k, 2] * nx + shapes[k, 5] * ny + shapes[k, 8] * nz
    length = 1.0 / math.sqrt(a * a + b * b + c * c)
    return a * length, b * length, c * length


@kernel
def _is_open_at(world, k, x, y, z):  # type: ignore[no-untyped-def]
    shape = world.kinds[k, SHAPE]
    u, v, _, hv, axis = place_on(world.shapes, k, shape, x, y, z)
    material = world.materials[world.kinds[k, CAPS if axis == 1 else SIDES]]
    x, y, z = x * world.shapes[k, HALF], y * world.shapes[k, HALF + 1], z * world.shapes[k, HALF + 2]
    return is_hole(material, world.noise, u, v, hv, x, y, z, world.kinds[k, VARIATION])


@kernel
def _enter_open(world, k, ox, oy, oz, dx, dy, dz, t):  # type: ignore[no-untyped-def]
    """Distance of the first solid point of a shape with holes that is entered at t; leaves have a far side too."""
    if not _is_open_at(world, k, ox + t * dx, oy + t * dy, oz + t * dz):
        return t
    if world.kinds[k, SHAPE] == 1:
        t = leave_ellipsoid(ox, oy, oz, dx, dy, dz)
        if t < MISS and not _is_open_at(world, k, ox + t * dx, oy + t * dy, oz + t * dz):
            return t
    return MISS


@inlined
def first_hit(world, listed, count, x, y, z):  # type: ignore[no-untyped-def]
    """Metres along the unit vector (x, y, z) from the eye to the first thing, and its number.

    Tries the first ``count`` of the ``listed`` shapes, nearest first.
    """
    best, hit = MISS, SKY
    s, shapes = world.scalars, world.shapes
    slant = s[PLANE] * x + s[PLANE + 1] * y + s[PLANE + 2] * z
    if slant < -1e-9:
        height = (
            s[PLANE] * s[WORLD_EYE] + s[PLANE + 1] * s[WORLD_EYE + 1] + s[PLANE + 2] * s[WORLD_EYE + 2] - s[PLANE + 3]
        )
        if height > 0.0:
            best, hit = -height / slant, GROUND
    for i in range(count):
        k = listed[i]
        if shapes[k, NEAR] > best:
            break
        dx = shapes[k, 0] * x + shapes[k, 1] * y + shapes[k, 2] * z
        dy = shapes[k, 3] * x + shapes[k, 4] * y + shapes[k, 5] * z
        dz = shapes[k, 6] * x + shapes[k, 7] * y + shapes[k, 8] * z
        ox, oy, oz = shapes[k, EYE], shapes[k, EYE + 1], shapes[k, EYE + 2]
        t = enter(world.kinds[k, SHAPE], ox, oy, oz, dx, dy, dz)
        if t < best:
            if world.kinds[k, OPEN]:
                t = _enter_open(world, k, ox, oy, oz, dx, dy, dz, t)
                if t >= best:
                    continue
            best, hit = t, k
    return best, hit


@kernel
def is_shadowed(world, px, py, pz, x, y, z):  # type: ignore[no-untyped-def]
    """Whether something stands between a point and the light in direction (x, y, z)."""
    s, shapes = world.scalars, world.shapes
    i = math.floor((s[ACROSS] * px + s[ACROSS + 1] * py + s[ACROSS + 2] * pz - s[CELLS]) * s[CELLS + 1])
    j = math.floor((s[ACROSS + 3] * px + s[ACROSS + 4] * py + s[ACROSS + 5] * pz - s[CELLS + 2]) * s[CELLS + 3])
    if i < 0 or j < 0 or i >= GRID or j >= GRID:
        return False
    cell = int(i) * GRID + int(j)
    ex, ey, ez = px - s[WORLD_EYE], py - s[WORLD_EYE + 1], pz - s[WORLD_EYE + 2]
    for item in range(world.grid_start[cell], world.grid_start[cell + 1]):
        k = world.grid_items[item]
        ox = shapes[k, EYE] + shapes[k, 0] * ex + shapes[k, 1] * ey + shapes[k, 2] * ez
        oy = shapes[k, EYE + 1] + shapes[k, 3] * ex + shapes[k, 4] * ey + shapes[k, 5] * ez
        oz = shapes[k, EYE + 2] + shapes[k, 6] * ex + shapes[k, 7] * ey + shapes[k, 8] * ez
        dx = shapes[k, 0] * x + shapes[k, 1] * y + shapes[k, 2] * z
        dy = shapes[k, 3] * x + shapes[k, 4] * y + shapes[k, 5] * z
        dz = shapes[k, 6] * x + shapes[k, 7] * y + shapes[k, 8] * z
        t = enter(world.kinds[k, SHAPE], ox, oy, oz, dx, dy, dz)
        if t < MISS and world.kinds[k, OPEN]:
            t = _enter_open(world, k, ox, oy, oz, dx, dy, dz, t)
        if t < MISS:
            return True
    return False


@kernel
def cast_rays(world, directions, distance, hit):  # type: ignore[no-untyped-def]
    """Cast rays without any culling: (n, 3) unit vectors to (n,) metres (inf = sky) and (n,) shape numbers."""
    for i in range(len(directions)):
        t, k = first_hit(world, world.order, len(world.order), directions[i, 0], directions[i, 1], directions[i, 2])
        distance[i] = np.inf if k == SKY else t
        hit[i] = k
