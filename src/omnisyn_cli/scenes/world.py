"""A scene packed for the kernels: few flat arrays, because each array costs time at every call."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from omnisyn_cli.scenes.culling import light_grid
from omnisyn_cli.scenes.materials import MaterialColumn
from omnisyn_cli.scenes.noise import noise_lattice
from omnisyn_cli.scenes.scene import Scene

GROUND_ID = -1
"""In place of the index of a shape, for the ground plane."""

SKY_ID = -2
"""In place of the index of a shape, for the sky."""

_PENUMBRA_REACH = 6.0
"""Metres from a caster over which the light grid makes room for a growing penumbra; chosen by eye."""

_SUN_SAMPLE_OFFSETS = ((-0.5, -0.5), (0.5, -0.2), (-0.2, 0.5), (0.4, 0.4))
"""Points on the disc of the sun, in half angles: one for each of the 2×2 samples of a pixel."""


class ShapeColumn(IntEnum):
    """Columns of :attr:`World.shapes`."""

    TO_UNIT = 0  # row-major 3×3: world vectors to the frame of the unit shape
    EYE = 9  # the eye in that frame
    NEAR = 12  # a lower bound of the distance from the eye, metres
    HALF = 13
    TINT = 16
    COUNT = 19


class AttributeColumn(IntEnum):
    """Columns of :attr:`World.attributes`."""

    SHAPE = 0
    SIDES = 1
    CAPS = 2
    VARIATION = 3
    PERFORATED = 4


class Scalar(IntEnum):
    """Places in :attr:`World.scalars`."""

    SUN = 0
    SKY_LIGHT = 3
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
    GROUND_PLANE = 24  # normal, offset
    EYE = 28
    SUN_DIRECTIONS = 31  # of four points on the sun
    LIGHT_GRID_AXES = 43  # two unit vectors across the light
    LIGHT_GRID_FRAME = 49  # its origin and scale, for each axis


class World(NamedTuple):
    """What the kernels see.

    Attributes:
        shapes: (n, 19) laid out as :class:`ShapeColumn`.
        attributes: (n, 5) laid out as :class:`AttributeColumn`.
        order: (n,) shapes, nearest first.
        materials: as in :class:`omnisyn_cli.scenes.scene.Scene`.
        scalars: laid out as :class:`Scalar`.
        lamps: as in Scene.
        grid_start, grid_items: of :func:`omnisyn_cli.scenes.culling.light_grid`.
        noise: of :func:`omnisyn_cli.scenes.noise.lattice`.
    """

    shapes: np.ndarray
    attributes: np.ndarray
    order: np.ndarray
    materials: np.ndarray
    scalars: np.ndarray
    lamps: np.ndarray
    grid_start: np.ndarray
    grid_items: np.ndarray
    noise: np.ndarray


class Bounds(NamedTuple):
    """What tells in which tiles of the picture a shape may be visible.

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
class StaticWorld:
    """The part of a world that does not depend on the eye; fields as in :class:`World` and :class:`Bounds`."""

    to_unit: Float[np.ndarray, "n 3 3"]
    axes: Float[np.ndarray, "n 3 3"]
    attributes: Int[np.ndarray, "n 5"]
    scalars: Float[np.ndarray, " s"]
    grid_start: Int[np.ndarray, " c"]
    grid_items: Int[np.ndarray, " i"]


def pack_scene(scene: Scene) -> StaticWorld:
    """Pack what does not depend on the eye: frames, materials, light, the grid of shadow casters."""
    light = scene.lighting
    sun = np.asarray(light.sun_direction, dtype=np.float64)
    side = np.cross(sun, [0.0, 0.0, 1.0] if abs(sun[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    across = np.stack([side, np.cross(sun, side)])
    suns = np.stack([sun + light.softness * (a * across[0] + b * across[1]) for a, b in _SUN_SAMPLE_OFFSETS])
    suns /= np.linalg.norm(suns, axis=1, keepdims=True)
    axes = np.ascontiguousarray(np.swapaxes(scene.rotation * scene.half[:, None, :], 1, 2))
    casters = np.flatnonzero(scene.casts_shadow)
    start, items, frame = light_grid(scene.centre, axes, casters, across, light.softness * _PENUMBRA_REACH)
    is_perforated = scene.materials[scene.material[:, 0], MaterialColumn.PERFORATED] > 0.0
    return StaticWorld(
        to_unit=axes / scene.half[:, :, None] ** 2,
        axes=axes,
        attributes=np.column_stack([scene.shape, scene.material, scene.variation, is_perforated]).astype(np.int64),
        scalars=np.concatenate(
            [_light_scalars(scene), scene.ground, np.zeros(3), suns.ravel(), across.ravel(), frame.ravel()]
        ),
        grid_start=start,
        grid_items=items,
    )


def _light_scalars(scene: Scene) -> Float[np.ndarray, "24"]:
    light = scene.lighting
    sun_and_sky = [*light.sun, *light.sky, *light.bounce, scene.ground_material]
    sky_picture = [*light.zenith, *light.horizon, *light.cloud, light.cloud_cover, light.cloud_scale]
    return np.array([*sun_and_sky, *sky_picture, light.haze, light.exposure, light.seed], dtype=np.float64)


def seen_from(static: StaticWorld, scene: Scene, eye: Float[np.ndarray, "3"]) -> tuple[World, Bounds]:
    """The world and the bounds of its shapes for one position of the eye."""
    offset = scene.centre - eye
    unit = -np.squeeze(static.to_unit @ offset[:, :, None], -1)
    near = np.linalg.norm(np.maximum(np.abs(unit) - 1.0, 0.0) * scene.half, axis=1) * (1.0 - 1e-9)
    order = np.argsort(near, kind="stable")
    scalars = static.scalars.copy()
    scalars[Scalar.EYE : Scalar.EYE + 3] = eye
    shapes = np.concatenate([static.to_unit.reshape(-1, 9), unit, near[:, None], scene.half, scene.tint], axis=1)
    world = World(
        shapes=shapes,
        attributes=static.attributes,
        order=order,
        materials=scene.materials,
        scalars=scalars,
        lamps=scene.lamps,
        grid_start=static.grid_start,
        grid_items=static.grid_items,
        noise=noise_lattice(),
    )
    return world, Bounds(scene.shape, offset, static.axes, order)
