"""A scene as arrays: shapes and their triangles, materials, a ground, a sky, a sun and lamps.

The frame is that of :mod:`omnisyn_cli.geometry.sphere` (y is up), lengths are metres. A shape is a unit shape,
which fills the cube [-1, 1]³ as far as it can, in a box of half sizes ``half`` that is rotated and moved.
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int32, Int64

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes.materials import NO_PHOTOS, Material, Photos, pack_materials
from omnisyn_cli.scenes.palette import Colour, mixed

Point = tuple[float, float, float]

SEGMENTS = 24  # Around what is round; a radius is at most 0.9 % too short between them


class Shape(IntEnum):
    """Of what kind a shape is; the axes of cylinder and cone are the local y."""

    BOX = 0
    ELLIPSOID = 1
    CYLINDER = 2
    CONE = 3


# One shape of a scene. ``rotation`` is world from local, ``half`` the half sizes in metres; ``material`` has the rows
# of the materials of the sides and of the faces up and down (boxes, cylinders and cones). ``tint`` is a factor on the
# colours, ``variation`` makes two shapes of one material differ.
PACKED_SHAPE = np.dtype([
    ("kind", "i8"), ("centre", "f8", 3), ("rotation", "f8", (3, 3)), ("half", "f8", 3), ("material", "i8", 2),
    ("tint", "f8"), ("casts_shadow", "?"), ("variation", "i8"),
])  # fmt: skip


def _box() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    quads = np.array([(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)])
    return corners, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), np.repeat([0, 1, 2], 4)


def _lathe(radii: np.ndarray, heights: np.ndarray, axes: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rings around y from the bottom to the top, and the axes of what lies between them."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    x, z, y = radii[:, None] * np.sin(angle), radii[:, None] * np.cos(angle), np.repeat(heights, SEGMENTS)
    ring = np.arange(len(radii) * SEGMENTS).reshape(-1, SEGMENTS)
    a, b, c, d = ring[:-1], np.roll(ring, -1, axis=1)[:-1], ring[1:], np.roll(ring, -1, axis=1)[1:]
    faces = np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)
    return np.stack([x.ravel(), y, z.ravel()], axis=1), faces, np.repeat(axes, 2 * SEGMENTS)


_LATITUDES = np.linspace(np.pi, 0.0, SEGMENTS // 2 + 1)
# Vertices, faces and the axis of each face: the local axis that it faces, 1 up and down; 0 where it is curved.
UNIT_SHAPES = {
    Shape.BOX: _box(),
    Shape.ELLIPSOID: _lathe(np.sin(_LATITUDES), np.cos(_LATITUDES), [0] * (SEGMENTS // 2)),
    Shape.CYLINDER: _lathe(np.array([0.0, 1.0, 1.0, 0.0]), np.array([-1.0, -1.0, 1.0, 1.0]), [1, 0, 1]),
    Shape.CONE: _lathe(np.array([0.0, 1.0, 0.0]), np.array([-1.0, -1.0, 1.0]), [1, 0]),
}


def triangles(
    shapes: np.ndarray,
) -> tuple[
    Float32[np.ndarray, "vertices 3"], Int32[np.ndarray, "faces 3"],
    Int64[np.ndarray, " faces"], Int64[np.ndarray, " faces"],
]:  # fmt: skip
    """Vertices (metres) and faces of records of :data:`PACKED_SHAPE`, and the shape and the axis of each face."""
    vertices, faces, owners, axes, count = [], [], [], [], 0
    for kind, (corners, corner_faces, face_axes) in UNIT_SHAPES.items():
        members = np.flatnonzero(shapes["kind"] == kind)
        of_kind = shapes[members]
        placed = (corners * of_kind["half"][:, None]) @ np.swapaxes(of_kind["rotation"], 1, 2)
        vertices.append((placed + of_kind["centre"][:, None]).reshape(-1, 3))
        first = count + len(corners) * np.arange(len(members))
        faces.append((corner_faces + first[:, None, None]).reshape(-1, 3))
        owners.append(np.repeat(members, len(corner_faces)))
        axes.append(np.tile(face_axes, len(members)))
        count += vertices[-1].shape[0]
    points, corners, owner, axis = (np.concatenate(parts) for parts in (vertices, faces, owners, axes))
    return points.astype(np.float32), corners.astype(np.int32), owner, axis


GROUND_REACH = 1000.0  # Metres from the origin to the edge of the ground


class Lighting(NamedTuple):
    """Where light comes from and what the sky looks like; colours are linear RGB. A tuple, for the kernels."""

    sun_direction: Point  # unit vector towards the sun
    sun: Colour  # colour of direct sunlight
    sky: Colour  # colour of the light from above
    bounce: Colour  # colour of the light from below
    softness: float = 0.005  # tangent of the half angle of the sun; makes penumbras
    # colours of the picture of the sky
    zenith: Colour = (0.15, 0.32, 0.68)
    horizon: Colour = (0.62, 0.72, 0.82)
    cloud: Colour = (0.9, 0.9, 0.9)
    cloud_cover: float = 0.5  # 0 (clear) to 1 (overcast)
    cloud_scale: float = 1.0  # size of the clouds
    haze: float = 0.0  # 1/metres; how fast distance turns to the colour of the horizon
    exposure: float = 1.0  # factor on all light before tone mapping
    seed: int = 0  # of the clouds


@dataclass(frozen=True)
class Walkway:
    """Where cameras may stand."""

    # opposite corners of a box of camera positions, metres; heights count from the ground
    low: Point
    high: Point
    heading: tuple[float, float]  # direction of motion in the horizontal plane (x, z), unit length; (0, 0) = any
    baselines: tuple[float, float]  # shortest and longest usual distance between the first and the last camera
    clearance: float  # distance that cameras keep from everything, metres
    # longest usual baseline in multiples of the nearest depth at its ends. Baselines are then drawn evenly in their
    # logarithm and shortened until they fit. None: drawn evenly.
    max_baseline_in_depths: float | None = None
    slope: float = 0.02  # standard deviation of the climb of those paths that are not level, a tangent


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that is seen."""

    kind: str  # name of the generator
    shapes: np.ndarray  # records of :data:`omnisyn_cli.scenes.scene.PACKED_SHAPE`; the first is the ground
    materials: np.ndarray  # records of :data:`omnisyn_cli.scenes.materials.PACKED_MATERIAL`
    ground: Float[np.ndarray, "4"]  # unit normal and offset of the plane ``normal · x = offset``
    lamps: Float[np.ndarray, "l 6"]  # position and linear colour of lamps without shadows
    lighting: Lighting
    walkways: tuple[Walkway, ...]
    photos: Photos = NO_PHOTOS  # photographs that some materials show


@dataclass
class SceneBuilder:
    """Collects shapes; every ``add`` method takes metres, radians and a :class:`Material`."""

    rng: np.random.Generator
    lighting: Lighting
    ground: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 0.0)
    ground_material: Material = field(default_factory=Material)
    lamps: list[tuple[float, ...]] = field(default_factory=list)
    walkways: list[Walkway] = field(default_factory=list)
    _materials: dict[Material, int] = field(default_factory=dict)
    _shapes: list[tuple[object, ...]] = field(default_factory=list)

    def add(
        self, shape: Shape, centre: Point, half: Point, material: Material, *, cap: Material | None = None,
        yaw: float = 0.0, rotation: Float[np.ndarray, "3 3"] | None = None, tint: float = 1.0,
        casts_shadow: bool = True,
    ) -> None:  # fmt: skip
        """Add one shape; ``yaw`` turns it about the vertical, ``rotation`` replaces that by any rotation."""
        if rotation is None:
            c, s = math.cos(yaw), math.sin(yaw)
            rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        rows = self._row(material), self._row(material if cap is None else cap)
        self._shapes.append((shape, centre, rotation, half, rows, tint, casts_shadow))

    def box(self, low: Point, high: Point, material: Material, *, casts_shadow: bool = True) -> None:
        """Add an axis-aligned box from corner to corner."""
        a, b = np.array(low), np.array(high)
        self.add(Shape.BOX, tuple(0.5 * (a + b)), tuple(0.5 * np.abs(b - a)), material, casts_shadow=casts_shadow)

    def pole(self, bottom: Point, height: float, radius: float, material: Material) -> None:
        """Add a vertical cylinder that stands on ``bottom``."""
        centre = (bottom[0], bottom[1] + 0.5 * height, bottom[2])
        self.add(Shape.CYLINDER, centre, (radius, 0.5 * height, radius), material)

    def rod(self, start: Point, end: Point, radius: float, material: Material) -> None:
        """Add a cylinder between two points."""
        a, b = np.array(start), np.array(end)
        half = 0.5 * math.dist(start, end)
        self.add(Shape.CYLINDER, tuple(0.5 * (a + b)), (radius, half, radius), material, rotation=_upright_to(b - a))

    def ball(self, centre: Point, radius: float, material: Material) -> None:
        """Add a sphere."""
        self.add(Shape.ELLIPSOID, centre, (radius, radius, radius), material)

    def build(self, kind: str) -> Scene:
        """Freeze what was collected."""
        *normal, offset = self.ground
        row = self._row(self.ground_material)
        centre = np.array(normal) * (offset - 1.0)
        half = (GROUND_REACH, 1.0, GROUND_REACH)
        ground = (Shape.BOX, centre, _upright_to(np.array(normal)), half, (row, row), 1.0, False)
        shapes = np.zeros(len(self._shapes) + 1, PACKED_SHAPE)
        for name, values in zip(PACKED_SHAPE.names or (), zip(ground, *self._shapes, strict=True), strict=False):
            shapes[name] = values
        shapes["variation"][1:] = self.rng.integers(1, 1 << 16, len(self._shapes))
        return Scene(
            kind, shapes, pack_materials(list(self._materials)), np.array(self.ground),
            np.array(self.lamps, dtype=np.float64).reshape(-1, 6), self.lighting, tuple(self.walkways),
        )  # fmt: skip

    def _row(self, material: Material) -> int:
        return self._materials.setdefault(material, len(self._materials))


def _upright_to(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The shortest rotation of the y axis to an axis of any length."""
    across = math.hypot(axis[0], axis[2])
    angle = math.atan2(across, axis[1])
    turn = np.array([axis[2], 0.0, -axis[0]]) / across if across > 0.0 else np.array([1.0, 0.0, 0.0])
    return rotation_from_rotation_vector(angle * turn)


@dataclass(frozen=True)
class LocalFrame:
    """Adds shapes in local coordinates: y is up, the local z axis is turned by ``yaw`` about it."""

    build: SceneBuilder
    base: Point
    yaw: float

    def place(self, x: float, y: float, z: float) -> Point:
        """World coordinates of a local point."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.base[0] + c * x + s * z, self.base[1] + y, self.base[2] - s * x + c * z

    def box(
        self, centre: Point, half: Point, material: Material, *, cap: Material | None = None, tint: float = 1.0,
        turn: float = 0.0,
    ) -> None:  # fmt: skip
        """Add a box; ``turn`` turns it further about its own middle."""
        self.build.add(Shape.BOX, self.place(*centre), half, material, cap=cap, yaw=self.yaw + turn, tint=tint)

    def rod(self, start: Point, end: Point, radius: float, material: Material) -> None:
        """Add a cylinder between two points."""
        self.build.rod(self.place(*start), self.place(*end), radius, material)

    def ellipsoid(self, centre: Point, half: Point, material: Material) -> None:
        """Add an ellipsoid."""
        self.build.add(Shape.ELLIPSOID, self.place(*centre), half, material, yaw=self.yaw)


def sun_at(bearing: float, elevation: float) -> Point:
    """Unit vector to a sun at a height above the horizon (radians); the bearing turns it about the vertical."""
    flat = math.cos(elevation)
    return flat * math.sin(bearing), math.sin(elevation), flat * math.cos(bearing)


def daylight(rng: np.random.Generator) -> Lighting:
    """Draw a day: clear, cloudy or overcast, at any hour."""
    cover = float(rng.choice([0.15, 0.4, 0.6, 0.95], p=[0.2, 0.3, 0.25, 0.25])) + rng.uniform(-0.1, 0.05)
    elevation = rng.uniform(0.25, 1.25)
    warmth = max(0.0, 1.0 - elevation / 0.8)
    direct = max(0.0, 1.0 - max(0.0, cover - 0.55) * 2.4)
    sun = times((1.0, 0.93 - 0.18 * warmth, 0.82 - 0.38 * warmth), direct * rng.uniform(1.9, 2.6))
    grey = min(1.0, cover)
    fill = 0.75 + 0.55 * grey
    sky = times(mixed((0.50, 0.62, 0.82), (0.80, 0.82, 0.85), grey), fill)
    bounce = times(mixed((0.42, 0.38, 0.33), (0.45, 0.45, 0.45), grey), 0.55 * fill)
    blue = rng.uniform(0.85, 1.2)
    zenith = mixed((0.13 * blue, 0.30 * blue, 0.62), (0.42, 0.48, 0.56), 0.5 * grey)
    horizon = mixed(mixed((0.62, 0.74, 0.86), (0.95, 0.76, 0.56), 0.6 * warmth), (0.78, 0.80, 0.83), grey)
    return Lighting(
        sun_direction=sun_at(rng.uniform(0, 2 * math.pi), elevation), sun=sun, sky=sky, bounce=bounce,
        softness=0.006 + 0.05 * max(0.0, cover - 0.5), zenith=times(zenith, 1.25), horizon=times(horizon, 1.35),
        cloud=times(mixed((1.0, 0.98, 0.95), (0.8, 0.82, 0.85), grey), rng.uniform(1.3, 1.9)), cloud_cover=cover,
        cloud_scale=float(rng.uniform(0.35, 1.1)), haze=float(rng.choice([0.0004, 0.001, 0.003], p=[0.5, 0.35, 0.15])),
        exposure=float(rng.uniform(0.85, 1.35)) * (1.0 + 0.25 * (1.0 - direct)), seed=int(rng.integers(1, 1000)),
    )  # fmt: skip


def times(colour: Colour, factor: float) -> Colour:
    """Light times a factor; other than colours of surfaces it may exceed 1."""
    return colour[0] * factor, colour[1] * factor, colour[2] * factor
