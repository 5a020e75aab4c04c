"""Where a ray meets a shape: closed forms in each shape's own frame, scaled so that it fills the cube [-1, 1]³.

A shape is hit where a ray *enters* it; a ray that starts inside misses. Distances are in the units of the direction,
so a unit vector in the world gives metres although the local frame is scaled.
"""

import math

from omnisyn_cli.scenes.jit import inlined, kernel

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
