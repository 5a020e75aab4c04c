"""What a ray hits first and how far away it is; whether a point lies in the shadow.

Rays meet shapes in each shape's own frame, scaled so that it fills the cube [-1, 1]³. A shape is hit where a ray
*enters* it; a ray that starts inside misses. Distances are in the units of the direction, so a unit vector in the world
gives metres although the local frame is scaled.
"""

import math

import numpy as np

from omnisyn_cli.scenes.culling import LIGHT_GRID_CELLS
from omnisyn_cli.scenes.kernel_decorators import inlined, kernel
from omnisyn_cli.scenes.textures import FacePoint, is_hole
from omnisyn_cli.scenes.world import GROUND_ID, SKY_ID, AttributeColumn, Scalar, ShapeColumn

MISS_DISTANCE = 1e30
"""Instead of a distance, where a ray hits nothing."""

_MIN_HIT_DISTANCE = 1e-5
"""Metres; a hit nearer than this is the surface that the ray starts on."""

_MIN_DIRECTION = 1e-12
"""Components of directions are at least so large, so that divisions stay finite."""


@inlined
def _intersect_box(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    dx = dx if abs(dx) > _MIN_DIRECTION else _MIN_DIRECTION
    dy = dy if abs(dy) > _MIN_DIRECTION else _MIN_DIRECTION
    dz = dz if abs(dz) > _MIN_DIRECTION else _MIN_DIRECTION
    ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
    ax, ay, az = abs(ix), abs(iy), abs(iz)
    mx, my, mz = -ox * ix, -oy * iy, -oz * iz
    enters = max(mx - ax, my - ay, mz - az)
    leaves = min(mx + ax, my + ay, mz + az)
    return enters if enters < leaves and enters > _MIN_HIT_DISTANCE else MISS_DISTANCE


@inlined
def _intersect_ellipsoid(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz - 1.0
    q = b * b - a * c
    if q <= 0.0 or b >= 0.0:
        return MISS_DISTANCE
    t = (-b - math.sqrt(q)) / a
    return t if t > _MIN_HIT_DISTANCE else MISS_DISTANCE


@inlined
def exit_ellipsoid(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Distance at which a ray leaves the unit sphere, for leaves that are seen from behind."""
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    q = b * b - a * (ox * ox + oy * oy + oz * oz - 1.0)
    if q <= 0.0:
        return MISS_DISTANCE
    t = (-b + math.sqrt(q)) / a
    return t if t > _MIN_HIT_DISTANCE else MISS_DISTANCE


@inlined
def _intersect_cylinder(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    a = dx * dx + dz * dz
    a = a if a > _MIN_DIRECTION else _MIN_DIRECTION
    b = ox * dx + oz * dz
    q = b * b - a * (ox * ox + oz * oz - 1.0)
    if q <= 0.0:
        return MISS_DISTANCE
    root = math.sqrt(q)
    dy = dy if abs(dy) > _MIN_DIRECTION else _MIN_DIRECTION
    middle, reach = -oy / dy, abs(1.0 / dy)
    enters = max((-b - root) / a, middle - reach)
    leaves = min((-b + root) / a, middle + reach)
    return enters if enters < leaves and enters > _MIN_HIT_DISTANCE else MISS_DISTANCE


@kernel
def _intersect_cone(ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    # x² + z² = ((1 - y) / 2)² between y = -1 (the base, radius 1) and y = 1 (the tip)
    h, k = 0.5 * (1.0 - oy), -0.5 * dy
    a = dx * dx + dz * dz - k * k
    b = ox * dx + oz * dz - h * k
    c = ox * ox + oz * oz - h * h
    best = MISS_DISTANCE
    if abs(dy) > _MIN_DIRECTION:  # through the base, from below
        t = (-1.0 - oy) / dy
        x, z = ox + t * dx, oz + t * dz
        if t > _MIN_HIT_DISTANCE and dy > 0.0 and x * x + z * z < 1.0:
            best = t
    q = b * b - a * c
    if q > 0.0 and abs(a) > _MIN_DIRECTION:
        root = math.sqrt(q)
        for sign in (-1.0, 1.0):
            t = (-b + sign * root) / a
            y = oy + t * dy
            # outward normal · direction < 0: the ray enters here
            if t > _MIN_HIT_DISTANCE and t < best and y > -1.0 and y < 1.0 and a * t + b < 0.0:
                best = t
    return best


@inlined
def intersect_shape(shape, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Distance at which a ray enters a unit shape (a value of ``Shape``), ``MISS_DISTANCE`` if it does not."""
    if shape == 0:
        return _intersect_box(ox, oy, oz, dx, dy, dz)
    if shape == 1:
        return _intersect_ellipsoid(ox, oy, oz, dx, dy, dz)
    if shape == 2:
        return _intersect_cylinder(ox, oy, oz, dx, dy, dz)
    return _intersect_cone(ox, oy, oz, dx, dy, dz)


EYE, NEAR_COLUMN, HALF_COLUMN = int(ShapeColumn.EYE), int(ShapeColumn.NEAR), int(ShapeColumn.HALF)
SHAPE, SIDES, CAPS, VARIATION, PERFORATION_COLUMN = map(int, AttributeColumn)
PLANE, WORLD_EYE = int(Scalar.GROUND_PLANE), int(Scalar.EYE)
GRID_AXES, GRID_FRAME = int(Scalar.LIGHT_GRID_AXES), int(Scalar.LIGHT_GRID_FRAME)
"""Columns and rows of packed scenes as plain numbers, which kernels need."""


@kernel
def texture_coordinates(shapes, k, shape, x, y, z):  # type: ignore[no-untyped-def]
    """Where a point of a unit shape lies on its face: ``(u, v, hu, hv, axis)`` in metres; axis 1: faces up or down."""
    hx, hy, hz = shapes[k, HALF_COLUMN], shapes[k, HALF_COLUMN + 1], shapes[k, HALF_COLUMN + 2]
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
def surface_normal(shapes, k, shape, axis, x, y, z):  # type: ignore[no-untyped-def]
    """World normal at a point of a unit shape; ``axis`` as from :func:`texture_coordinates`."""
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
def _is_hole_at(world, k, x, y, z):  # type: ignore[no-untyped-def]
    shape = world.attributes[k, SHAPE]
    u, v, hu, hv, axis = texture_coordinates(world.shapes, k, shape, x, y, z)
    material = world.materials[world.attributes[k, CAPS if axis == 1 else SIDES]]
    x, y, z = (
        x * world.shapes[k, HALF_COLUMN],
        y * world.shapes[k, HALF_COLUMN + 1],
        z * world.shapes[k, HALF_COLUMN + 2],
    )
    return is_hole(material, world.noise, FacePoint(u, v, hu, hv, x, y, z, world.attributes[k, VARIATION]))


@kernel
def _first_solid_hit(world, k, origin, direction, t):  # type: ignore[no-untyped-def]
    """Distance of the first solid point of a shape with holes that is entered at t; leaves have a far side too."""
    (ox, oy, oz), (dx, dy, dz) = origin, direction
    if not _is_hole_at(world, k, ox + t * dx, oy + t * dy, oz + t * dz):
        return t
    if world.attributes[k, SHAPE] == 1:
        t = exit_ellipsoid(ox, oy, oz, dx, dy, dz)
        if t < MISS_DISTANCE and not _is_hole_at(world, k, ox + t * dx, oy + t * dy, oz + t * dz):
            return t
    return MISS_DISTANCE


@inlined
def first_hit(world, candidates, count, x, y, z):  # type: ignore[no-untyped-def]
    """Metres from the eye to the first hit along the unit vector (x, y, z), and its shape, ``GROUND_ID`` or ``SKY_ID``.

    Tries the first ``count`` of the ``candidates``, nearest first.
    """
    best, hit = MISS_DISTANCE, SKY_ID
    s, shapes = world.scalars, world.shapes
    slant = s[PLANE] * x + s[PLANE + 1] * y + s[PLANE + 2] * z
    if slant < -1e-9:
        height = (
            s[PLANE] * s[WORLD_EYE] + s[PLANE + 1] * s[WORLD_EYE + 1] + s[PLANE + 2] * s[WORLD_EYE + 2] - s[PLANE + 3]
        )
        if height > 0.0:
            best, hit = -height / slant, GROUND_ID
    for i in range(count):
        k = candidates[i]
        if shapes[k, NEAR_COLUMN] > best:
            break  # candidates are sorted by NEAR: none of the rest can be nearer
        dx = shapes[k, 0] * x + shapes[k, 1] * y + shapes[k, 2] * z
        dy = shapes[k, 3] * x + shapes[k, 4] * y + shapes[k, 5] * z
        dz = shapes[k, 6] * x + shapes[k, 7] * y + shapes[k, 8] * z
        ox, oy, oz = shapes[k, EYE], shapes[k, EYE + 1], shapes[k, EYE + 2]
        t = intersect_shape(world.attributes[k, SHAPE], ox, oy, oz, dx, dy, dz)
        if t < best:
            if world.attributes[k, PERFORATION_COLUMN]:
                t = _first_solid_hit(world, k, (ox, oy, oz), (dx, dy, dz), t)
                if t >= best:
                    continue
            best, hit = t, k
    return best, hit


@kernel
def is_shadowed(world, px, py, pz, x, y, z):  # type: ignore[no-untyped-def]
    """Whether something stands between a point and the light in direction (x, y, z)."""
    s, shapes = world.scalars, world.shapes
    i = math.floor(
        (s[GRID_AXES] * px + s[GRID_AXES + 1] * py + s[GRID_AXES + 2] * pz - s[GRID_FRAME]) * s[GRID_FRAME + 1]
    )
    j = math.floor(
        (s[GRID_AXES + 3] * px + s[GRID_AXES + 4] * py + s[GRID_AXES + 5] * pz - s[GRID_FRAME + 2]) * s[GRID_FRAME + 3]
    )
    if i < 0 or j < 0 or i >= LIGHT_GRID_CELLS or j >= LIGHT_GRID_CELLS:
        return False
    cell = int(i) * LIGHT_GRID_CELLS + int(j)
    ex, ey, ez = px - s[WORLD_EYE], py - s[WORLD_EYE + 1], pz - s[WORLD_EYE + 2]
    for item in range(world.grid_start[cell], world.grid_start[cell + 1]):
        k = world.grid_items[item]
        ox = shapes[k, EYE] + shapes[k, 0] * ex + shapes[k, 1] * ey + shapes[k, 2] * ez
        oy = shapes[k, EYE + 1] + shapes[k, 3] * ex + shapes[k, 4] * ey + shapes[k, 5] * ez
        oz = shapes[k, EYE + 2] + shapes[k, 6] * ex + shapes[k, 7] * ey + shapes[k, 8] * ez
        dx = shapes[k, 0] * x + shapes[k, 1] * y + shapes[k, 2] * z
        dy = shapes[k, 3] * x + shapes[k, 4] * y + shapes[k, 5] * z
        dz = shapes[k, 6] * x + shapes[k, 7] * y + shapes[k, 8] * z
        t = intersect_shape(world.attributes[k, SHAPE], ox, oy, oz, dx, dy, dz)
        if t < MISS_DISTANCE and world.attributes[k, PERFORATION_COLUMN]:
            t = _first_solid_hit(world, k, (ox, oy, oz), (dx, dy, dz), t)
        if t < MISS_DISTANCE:
            return True
    return False


@kernel
def cast_rays(world, directions, distance, hit):  # type: ignore[no-untyped-def]
    """Cast rays without any culling: (n, 3) unit vectors to (n,) metres (inf = sky) and (n,) shape numbers."""
    for i in range(len(directions)):
        t, k = first_hit(world, world.order, len(world.order), directions[i, 0], directions[i, 1], directions[i, 2])
        distance[i] = np.inf if k == SKY_ID else t
        hit[i] = k
