"""Scenes made for tests, and an oracle that is slow and obviously right."""

import math

import numpy as np

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes.materials import Material
from omnisyn_cli.scenes.scene import Lighting, Scene, SceneBuilder, Shape

DAY = Lighting(sun_direction=(0.0, 1.0, 0.0), sun=(1.0, 1.0, 1.0), sky=(0.3, 0.3, 0.3), bounce=(0.2, 0.2, 0.2))


def make(*arguments: object) -> tuple[object, ...]:
    """What ``omnisyn`` is called with to make a small scene."""
    return "scenes", "make", *arguments, "--size", "64x32", "--threads", 1, "-q"


def builder(ground: float = -1e6) -> SceneBuilder:
    """A scene with nothing in it, its ground far below."""
    build = SceneBuilder(np.random.default_rng(0), lighting=DAY)
    build.ground = (0.0, 1.0, 0.0, ground)
    return build


def one(shape: Shape, centre: tuple[float, ...], half: tuple[float, ...], **turn: object) -> Scene:
    build = builder()
    build.add(shape, centre, half, Material(), **turn)
    return build.build("test")


def random_shapes(seed: int, count: int = 40) -> Scene:
    """Shapes of every kind, turned any way, with the space around the origin left free."""
    rng = np.random.default_rng(seed)
    build = SceneBuilder(rng, lighting=DAY, ground=(0.0, 1.0, 0.0, -9.0))
    for k in range(count):
        direction = rng.normal(size=3)
        centre = direction / np.linalg.norm(direction) * rng.uniform(5.0, 8.0)
        half = tuple(float(h) for h in np.exp(rng.uniform(math.log(0.05), math.log(1.6), 3)))
        if k % 4 == Shape.CYLINDER or k % 4 == Shape.CONE:
            half = (half[0], half[1], half[0])
        rotation = rotation_from_rotation_vector(rng.normal(size=3)) if k % 3 else None
        build.add(Shape(k % 4), tuple(centre), half, Material(), rotation=rotation)
    return build.build("test")


def unit_directions(seed: int, count: int) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def oracle_distance(scene: Scene, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int]:
    """Try every surface of every shape, one after the other; where a ray first meets one, it is hit."""
    best, hit = math.inf, -1
    for k, shape in enumerate(scene.shapes):
        o = shape["rotation"].T @ (origin - shape["centre"]) / shape["half"]
        d = shape["rotation"].T @ direction / shape["half"]
        for t in _surface_hits(Shape(shape["kind"]), o, d):
            if 0.0 < t < best:
                best, hit = t, k
    return best, hit


def _surface_hits(shape: Shape, o: np.ndarray, d: np.ndarray) -> list[float]:
    if shape is Shape.BOX:
        return _faces(o, d, (0, 1, 2), lambda p, axis: np.all(np.abs(np.delete(p, axis)) <= 1.0))
    if shape is Shape.ELLIPSOID:
        return _roots(d @ d, 2 * o @ d, o @ o - 1.0)
    x, y, z = o
    dx, dy, dz = d
    caps = _faces(o, d, (1,), lambda p, _: p[0] ** 2 + p[2] ** 2 <= 1.0)
    if shape is Shape.CYLINDER:
        sides = _roots(dx * dx + dz * dz, 2 * (x * dx + z * dz), x * x + z * z - 1.0)
        return caps + [t for t in sides if abs(y + t * dy) <= 1.0]
    base = [t for t in caps if y + t * dy < 0.0]
    h, k = (1.0 - y) / 2.0, -dy / 2.0
    sides = _roots(dx * dx + dz * dz - k * k, 2 * (x * dx + z * dz - h * k), x * x + z * z - h * h)
    return base + [t for t in sides if abs(y + t * dy) <= 1.0]


def _faces(o, d, axes, is_on):  # type: ignore[no-untyped-def]
    hits = []
    for axis in axes:
        for side in (-1.0, 1.0):
            if d[axis] != 0.0:
                t = (side - o[axis]) / d[axis]
                if is_on(o + t * d, axis):
                    hits.append(t)
    return hits


def _roots(a: float, b: float, c: float) -> list[float]:
    inside = b * b - 4 * a * c
    if inside < 0 or a == 0:
        return []
    return [(-b - math.sqrt(inside)) / (2 * a), (-b + math.sqrt(inside)) / (2 * a)]


def clearance(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Lower bound in metres of the distance to the nearest surface, of shapes as oriented boxes; negative inside."""
    local = np.einsum("nji,pnj->pni", scene.shapes["rotation"], positions[:, None, :] - scene.shapes["centre"])
    beyond = np.abs(local) - scene.shapes["half"]
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return (outside + np.minimum(beyond.max(axis=-1), 0.0)).min(axis=1)
