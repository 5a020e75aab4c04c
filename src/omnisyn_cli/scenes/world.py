"""A scene packed for the kernels: few flat arrays, because each array costs time at every call."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from omnisyn_cli.scenes.culling import light_grid
from omnisyn_cli.scenes.materials import Column
from omnisyn_cli.scenes.noise import lattice
from omnisyn_cli.scenes.scene import Scene

GROUND = -1
"""Number of the ground among the shapes."""
SKY = -2
"""Number of the sky among the shapes."""

_SHADOW_REACH = 6.0  # metres that a penumbra grows over
_SUN_CORNERS = ((-0.5, -0.5), (0.5, -0.2), (-0.2, 0.5), (0.4, 0.4))  # points on the sun, in half angles


class Packed(IntEnum):
    """Columns of :attr:`World.shapes`."""

    TO_UNIT = 0  # row-major 3×3: world vectors to the frame of the unit shape
    EYE = 9  # the eye in that frame
    NEAR = 12  # a lower bound of the distance from the eye, metres
    HALF = 13
    TINT = 16
    COUNT = 19


class Kind(IntEnum):
    """Columns of :attr:`World.kinds`."""

    SHAPE = 0
    SIDES = 1
    CAPS = 2
    VARIATION = 3
    OPEN = 4


class Scalar(IntEnum):
    """Places in :attr:`World.scalars`."""

    SUN = 0
    SKY = 3
    BOUNCE = 6
    GROUND_MATERIAL = 9
    ZENITH = 10
    HORIZON = 13
    CLOUD = 16
    CLOUD_COVER = 19
    CLOUD_SCALE = 20
    HAZE = 21
    EXPOSURE = 22
    CLOUD_SEED = 23
    GROUND = 24  # normal, offset
    EYE = 28
    SUNS = 31  # directions of four points on the sun
    ACROSS = 43  # axes of the light grid
    GRID = 49  # its origin and scale, for each axis


class World(NamedTuple):
    """What the kernels see.

    Attributes:
        shapes: (n, 19) laid out as :class:`Packed`.
        kinds: (n, 5) laid out as :class:`Kind`.
        order: (n,) shapes, nearest first.
        materials: as in :class:`omnisyn_cli.scenes.scene.Scene`.
        scalars: laid out as :class:`Scalar`.
        lamps: as in Scene.
        grid_start, grid_items: of :func:`omnisyn_cli.scenes.culling.light_grid`.
        noise: of :func:`omnisyn_cli.scenes.noise.lattice`.
    """

    shapes: np.ndarray
    kinds: np.ndarray
    order: np.ndarray
    materials: np.ndarray
    scalars: np.ndarray
    lamps: np.ndarray
    grid_start: np.ndarray
    grid_items: np.ndarray
    noise: np.ndarray


class Papers(NamedTuple):
    """Photographs on materials, apart from the world because only shading sees them; fields as in Papering."""

    texels: np.ndarray
    levels: np.ndarray
    chosen: np.ndarray


class Bounds(NamedTuple):
    """What tells which tiles a shape may show in.

    Attributes:
        shape: (n,) kinds.
        offset: (n, 3) centres seen from the eye.
        axes: (n, 3, 3) scaled axes as rows.
        order: (n,) shapes, nearest first.
    """

    shape: np.ndarray
    offset: np.ndarray
    axes: np.ndarray
    order: np.ndarray


@dataclass(frozen=True)
class Pack:
    """The part of a world that does not depend on the eye; fields as in :class:`World` and :class:`Bounds`."""

    to_unit: Float[np.ndarray, "n 3 3"]
    axes: Float[np.ndarray, "n 3 3"]
    kinds: Int[np.ndarray, "n 5"]
    scalars: Float[np.ndarray, " s"]
    grid_start: Int[np.ndarray, " c"]
    grid_items: Int[np.ndarray, " i"]


def pack(scene: Scene) -> Pack:
    """Pack what all eyes share: frames, materials, light, the grid of shadows."""
    light = scene.lighting
    sun = np.asarray(light.sun_direction, dtype=np.float64)
    side = np.cross(sun, [0.0, 0.0, 1.0] if abs(sun[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    across = np.stack([side, np.cross(sun, side)])
    suns = np.stack([sun + light.softness * (a * across[0] + b * across[1]) for a, b in _SUN_CORNERS])
    suns /= np.linalg.norm(suns, axis=1, keepdims=True)
    axes = np.ascontiguousarray(np.swapaxes(scene.rotation * scene.half[:, None, :], 1, 2))
    casters = np.flatnonzero(scene.casts_shadow)
    start, items, frame = light_grid(scene.centre, axes, casters, across, light.softness * _SHADOW_REACH)
    is_open = scene.materials[scene.material[:, 0], Column.OPEN] > 0.0
    return Pack(
        to_unit=axes / scene.half[:, :, None] ** 2,
        axes=axes,
        kinds=np.column_stack([scene.shape, scene.material, scene.variation, is_open]).astype(np.int64),
        scalars=np.concatenate(
            [_light_scalars(scene), scene.ground, np.zeros(3), suns.ravel(), across.ravel(), frame.ravel()]
        ),
        grid_start=start,
        grid_items=items,
    )


def papers_of(scene: Scene) -> Papers:
    """The photographs of a scene; nothing is chosen where there are none."""
    if scene.papering is None:
        return Papers(np.zeros((1, 3), np.uint8), np.zeros((1, 1, 3), np.int64), np.zeros((0, 5)))
    return Papers(scene.papering.texels, scene.papering.levels, scene.papering.chosen)


def _light_scalars(scene: Scene) -> Float[np.ndarray, "24"]:
    light = scene.lighting
    colours = [
        *light.sun,
        *light.sky,
        *light.bounce,
        scene.ground_material,
        *light.zenith,
        *light.horizon,
        *light.cloud,
    ]
    return np.array(
        [*colours, light.cloud_cover, light.cloud_scale, light.haze, light.exposure, light.seed], dtype=np.float64
    )


def seen_from(packed: Pack, scene: Scene, eye: Float[np.ndarray, "3"]) -> tuple[World, Bounds]:
    """Finish a pack for one place of the eye."""
    offset = scene.centre - eye
    unit = -np.squeeze(packed.to_unit @ offset[:, :, None], -1)
    near = np.linalg.norm(np.maximum(np.abs(unit) - 1.0, 0.0) * scene.half, axis=1) * (1.0 - 1e-9)
    order = np.argsort(near, kind="stable")
    scalars = packed.scalars.copy()
    scalars[Scalar.EYE : Scalar.EYE + 3] = eye
    shapes = np.concatenate([packed.to_unit.reshape(-1, 9), unit, near[:, None], scene.half, scene.tint], axis=1)
    world = World(
        shapes=shapes,
        kinds=packed.kinds,
        order=order,
        materials=scene.materials,
        scalars=scalars,
        lamps=scene.lamps,
        grid_start=packed.grid_start,
        grid_items=packed.grid_items,
        noise=lattice(),
    )
    return world, Bounds(scene.shape, offset, packed.axes, order)
