"""A scene as arrays: convex shapes, materials, one ground plane, a sky, a sun and lamps.

The frame is that of :mod:`omnisyn_cli.geometry.sphere` (y is up), lengths are metres. A shape is a unit shape in a
box of half sizes ``half`` that is rotated and moved. A generator collects the shapes in a :class:`SceneBuilder`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, Int64, UInt8

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes.materials import Material, pack_materials
from omnisyn_cli.scenes.palette import Colour

Point = tuple[float, float, float]
Turn: TypeAlias = float | Point | np.ndarray


class Shape(IntEnum):
    """The unit shapes: each fills the cube [-1, 1]³ as far as it can; axes of cylinder and cone are the local y."""

    BOX = 0
    ELLIPSOID = 1
    CYLINDER = 2
    CONE = 3


@dataclass(frozen=True)
class Lighting:
    """Where light comes from and what the sky looks like; colours are linear RGB.

    Attributes:
        sun_direction: unit vector towards the sun.
        sun: colour of direct sunlight.
        sky: colour of the light from above.
        bounce: colour of the light from below.
        softness: tangent of the half angle of the sun; makes penumbras.
        zenith, horizon, cloud: colours of the picture of the sky.
        cloud_cover: 0 (clear) to 1 (overcast).
        cloud_scale: size of the clouds.
        haze: 1/metres; how fast distance turns to the colour of the horizon.
        exposure: factor on all light before tone mapping.
        seed: of the clouds.
    """

    sun_direction: Point
    sun: Colour
    sky: Colour
    bounce: Colour
    softness: float = 0.005
    zenith: Colour = (0.15, 0.32, 0.68)
    horizon: Colour = (0.62, 0.72, 0.82)
    cloud: Colour = (0.9, 0.9, 0.9)
    cloud_cover: float = 0.5
    cloud_scale: float = 1.0
    haze: float = 0.0
    exposure: float = 1.0
    seed: int = 0


@dataclass(frozen=True)
class Walkway:
    """Where cameras may stand.

    Attributes:
        low, high: opposite corners of a box of camera positions, metres.
        heading: direction of motion in the horizontal plane (x, z), unit length; (0, 0) = any.
        baselines: shortest and longest usual distance between the first and the last camera.
        clearance: distance that cameras keep from everything, metres.
        max_baseline_in_depths: longest usual baseline in multiples of the nearest depth at its ends. Baselines are then
            drawn evenly in their logarithm and shortened until they fit. None: drawn evenly.
        slope: standard deviation of the climb of those paths that are not level, a tangent.
    """

    low: Point
    high: Point
    heading: tuple[float, float]
    baselines: tuple[float, float]
    clearance: float
    max_baseline_in_depths: float | None = None
    slope: float = 0.02


class PhotoTextures(NamedTuple):
    """Materials whose colours are photographs, see :mod:`omnisyn_cli.scenes.photos`; a tuple, for the kernels.

    Attributes:
        texels, levels: of :class:`omnisyn_cli.scenes.photos.Photos`.
        assignment: per material: photograph (-1 for none), mapping, width in metres, seed, and 1 where patches are
            turned.
    """

    texels: UInt8[np.ndarray, "texels 3"]
    levels: Int64[np.ndarray, "photos levels 3"]
    assignment: Float[np.ndarray, "m 5"]


NO_PHOTO_TEXTURES = PhotoTextures(np.zeros((1, 3), np.uint8), np.zeros((1, 1, 3), np.int64), np.zeros((0, 5)))
"""Of scenes without photographs: no material has one."""


@dataclass(frozen=True)
class Scene:
    """Everything that is seen, as arrays over the n shapes.

    Attributes:
        kind: name of the generator.
        shape: :class:`Shape` of each.
        centre: metres.
        rotation: world from local.
        half: half sizes, metres.
        material: row of ``materials`` for the sides and for the faces up and down (of boxes, cylinders and cones).
        tint: factor on the material's colours.
        variation: a number that makes two shapes of one material differ.
        casts_shadow: ceilings of lamp-lit rooms do not.
        materials: packed by :func:`omnisyn_cli.scenes.materials.pack_materials`.
        ground: unit normal and offset of the plane ``normal · x = offset``.
        ground_material: row of ``materials``.
        lamps: position and linear colour of lamps without shadows.
        lighting: sun and sky.
        walkways: where cameras may stand.
        photo_textures: photographs on its materials.
    """

    kind: str
    shape: Int[np.ndarray, " n"]
    centre: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 3 3"]
    half: Float[np.ndarray, "n 3"]
    material: Int[np.ndarray, "n 2"]
    tint: Float[np.ndarray, "n 3"]
    variation: Int[np.ndarray, " n"]
    casts_shadow: Bool[np.ndarray, " n"]
    materials: Float[np.ndarray, "m p"]
    ground: Float[np.ndarray, "4"]
    ground_material: int
    lamps: Float[np.ndarray, "l 6"]
    lighting: Lighting
    walkways: tuple[Walkway, ...]
    photo_textures: PhotoTextures = NO_PHOTO_TEXTURES


class _Added(NamedTuple):
    """One shape; ``turn`` is its yaw, or the direction of its y axis, or its rotation."""

    shape: int
    centre: Point
    turn: Turn
    half: Point
    material: tuple[int, int]
    tint: Colour
    casts_shadow: bool


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
    _shapes: list[_Added] = field(default_factory=list)

    def add(
        self, shape: Shape, centre: Point, half: Point, material: Material, *, cap: Material | None = None,
        yaw: float = 0.0, rotation: Float[np.ndarray, "3 3"] | None = None, tint: float = 1.0,
        casts_shadow: bool = True,
    ) -> None:  # fmt: skip
        """Add one shape; ``yaw`` turns it about the vertical, ``rotation`` replaces that by any rotation."""
        sides, ends = self._row(material), self._row(material if cap is None else cap)
        turn = yaw if rotation is None else rotation
        self._shapes.append(_Added(int(shape), centre, turn, half, (sides, ends), (tint, tint, tint), casts_shadow))

    def box(self, low: Point, high: Point, material: Material, *, casts_shadow: bool = True) -> None:
        """Add an axis-aligned box from corner to corner."""
        centre = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2]))
        half = (0.5 * abs(high[0] - low[0]), 0.5 * abs(high[1] - low[1]), 0.5 * abs(high[2] - low[2]))
        self.add(Shape.BOX, centre, half, material, casts_shadow=casts_shadow)

    def pole(self, bottom: Point, height: float, radius: float, material: Material) -> None:
        """Add a vertical cylinder that stands on ``bottom``."""
        centre = (bottom[0], bottom[1] + 0.5 * height, bottom[2])
        self.add(Shape.CYLINDER, centre, (radius, 0.5 * height, radius), material)

    def rod(self, start: Point, end: Point, radius: float, material: Material) -> None:
        """Add a cylinder between two points."""
        length = math.dist(start, end)
        axis = ((end[0] - start[0]) / length, (end[1] - start[1]) / length, (end[2] - start[2]) / length)
        centre = (0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]), 0.5 * (start[2] + end[2]))
        half = (radius, 0.5 * length, radius)
        row = self._row(material)
        self._shapes.append(_Added(int(Shape.CYLINDER), centre, axis, half, (row, row), (1.0, 1.0, 1.0), True))

    def ball(self, centre: Point, radius: float, material: Material) -> None:
        """Add a sphere."""
        self.add(Shape.ELLIPSOID, centre, (radius, radius, radius), material)

    def build(self, kind: str) -> Scene:
        """Freeze what was collected."""
        count = len(self._shapes)
        ground_material = self._row(self.ground_material)
        added = self._shapes
        return Scene(
            kind=kind,
            shape=np.array([a.shape for a in added], dtype=np.int64),
            centre=np.array([a.centre for a in added], dtype=np.float64).reshape(count, 3),
            rotation=_rotations([a.turn for a in added]),
            half=np.array([a.half for a in added], dtype=np.float64).reshape(count, 3),
            material=np.array([a.material for a in added], dtype=np.int64).reshape(count, 2),
            tint=np.array([a.tint for a in added], dtype=np.float64).reshape(count, 3),
            variation=self.rng.integers(1, 1 << 16, count),
            casts_shadow=np.array([a.casts_shadow for a in added], dtype=np.bool_),
            materials=pack_materials(list(self._materials)),
            ground=np.array(self.ground, dtype=np.float64),
            ground_material=ground_material,
            lamps=np.array(self.lamps, dtype=np.float64).reshape(-1, 6),
            lighting=self.lighting,
            walkways=tuple(self.walkways),
        )

    def _row(self, material: Material) -> int:
        return self._materials.setdefault(material, len(self._materials))


def _rotations(turns: Sequence[Turn]) -> Float[np.ndarray, "n 3 3"]:
    """World-from-local rotations, all at once: one by one they would cost more than the picture."""
    yaws = np.array([turn if isinstance(turn, float | int) else 0.0 for turn in turns], dtype=np.float64)
    vectors = np.zeros((len(turns), 3))
    vectors[:, 1] = yaws
    rotations = rotation_from_rotation_vector(vectors).reshape(-1, 3, 3)
    rods = [k for k, turn in enumerate(turns) if isinstance(turn, tuple)]
    if rods:
        axis = np.array([turns[k] for k in rods])
        side = np.cross(axis, np.where(np.abs(axis[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        rotations[rods] = np.stack([side, axis, np.cross(side, axis)], axis=2)
    for k, turn in enumerate(turns):
        if isinstance(turn, np.ndarray):
            rotations[k] = turn
    return rotations


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
