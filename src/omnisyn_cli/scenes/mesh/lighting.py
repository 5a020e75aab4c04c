"""Light of a mesh without any: sky through the openings, walls that reflect, lamps.

Light is a function of the point and its normal alone (everything is diffuse), so all views of a scene agree.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from omnisyn_cli.scenes.mesh.raycast import MeshCaster

GOLDEN_RATIO = (1.0 + math.sqrt(5.0)) / 2.0
"""Turns of a spiral by it spread points evenly (Fibonacci lattice)."""

OFFSET = 2e-3
"""Metres above its surface that a point asks for light."""

AMBIENT_LIGHT = 0.05
"""Light where nothing shines."""

SOFT = 0.6
"""Share of the scenes whose sky is as bright as their walls: few rays then leave no edges of shadows on plain walls."""

LAMPS = (0, 5)
"""Least and greatest number of lamps of a scene, less one."""


@dataclass(frozen=True)
class Lighting:
    """What shines on a scene; units in which a white wall in full light is about 1."""

    directions: Float[np.ndarray, "n 3"]  # spread over the sphere, that every point asks
    sky: Float[np.ndarray, "n 3"]  # light from each direction where nothing is in the way
    bounced: Float[np.ndarray, " 3"]  # light of walls far away; nearer ones are darker
    reach: float  # metres from which on a wall is as bright as ``bounced``
    # positions, and their light at a metre
    lamps: Float[np.ndarray, "k 3"]
    lamp_light: Float[np.ndarray, "k 3"]
    # colours in [0, 1] of what is seen where nothing is
    horizon: Float[np.ndarray, " 3"]
    zenith: Float[np.ndarray, " 3"]

    def at(
        self, caster: MeshCaster, points: Float[np.ndarray, "points 3"], normals: Float[np.ndarray, "points 3"]
    ) -> Float[np.ndarray, "points 3"]:
        """Light that arrives at points of surfaces, from the side of their normals."""
        starts = points + OFFSET * normals
        total, weight = np.zeros((len(points), 3)), np.full(len(points), 1e-6)
        for direction, sky in zip(self.directions, self.sky, strict=True):
            cosine = normals @ direction
            facing = np.flatnonzero(cosine > 1e-3)
            if not len(facing):
                continue
            free = caster.distances(starts[facing], np.broadcast_to(direction, (len(facing), 3)))
            seen = np.where(np.isinf(free)[:, None], sky, self.bounced * np.clip(free / self.reach, 0.0, 1.0)[:, None])
            total[facing] += cosine[facing, None] * seen
            weight[facing] += cosine[facing]
        light = AMBIENT_LIGHT + total / weight[:, None]
        for lamp, colour in zip(self.lamps, self.lamp_light, strict=True):
            light += self._lamp(caster, starts, normals, lamp)[:, None] * colour
        return np.asarray(light)

    @staticmethod
    def _lamp(caster: MeshCaster, starts: np.ndarray, normals: np.ndarray, lamp: np.ndarray) -> np.ndarray:
        to_lamp = lamp - starts
        distance = np.linalg.norm(to_lamp, axis=1)
        to_lamp = to_lamp / np.maximum(distance, 1e-6)[:, None]
        cosine = np.einsum("ij,ij->i", normals, to_lamp)
        facing = np.flatnonzero(cosine > 0)
        light = np.zeros(len(starts))
        if len(facing):
            is_free = caster.distances(starts[facing], to_lamp[facing]) > distance[facing] - 0.03
            light[facing] = cosine[facing] * is_free / (0.3 + distance[facing] ** 2)
        return np.asarray(light)

    def background(self, directions: Float[np.ndarray, "rays 3"]) -> Float[np.ndarray, "rays 3"]:
        """Colours (sRGB in [0, 1]) where nothing is."""
        rise = np.clip(directions[:, 1:2], 0.0, 1.0)
        return np.asarray(self.horizon * (1.0 - rise) + self.zenith * rise)


def sphere_directions(count: int, turn: float = 0.0) -> Float[np.ndarray, "count 3"]:
    """Unit vectors spread evenly (a Fibonacci spiral), turned about the vertical."""
    index = np.arange(count)
    height = 1.0 - 2.0 * (index + 0.5) / count
    azimuth = 2.0 * math.pi * index / GOLDEN_RATIO + turn
    side = np.sqrt(1.0 - height**2)
    return np.stack([side * np.cos(azimuth), height, side * np.sin(azimuth)], axis=1)


def draw_lighting(caster: MeshCaster, rng: np.random.Generator, around: Float[np.ndarray, " 3"], rays: int) -> Lighting:
    """Light by chance: some sky, brighter on one side, and lamps at emissive faces or below what is above.

    Lamps hang near ``around``, a place for cameras, where the mesh has none. Every point asks ``rays`` directions.
    """
    directions = sphere_directions(rays, rng.uniform(0.0, 2.0 * math.pi))
    tint = np.exp(rng.normal(0.0, 0.08, 3))
    sun = rng.normal([0.0, 1.0, 0.0], 1.0)
    sun /= np.linalg.norm(sun)
    lobe = np.exp(rng.uniform(1.0, 5.0) * (directions @ sun - 1.0))
    bounced = rng.uniform(0.15, 0.5)
    if rng.random() < SOFT:
        brightness = np.full(rays, bounced * rng.uniform(0.9, 1.4))
    else:
        brightness = np.where(directions[:, 1] > 0, 1.0, 0.4) * rng.uniform(0.8, 2.2) + rng.uniform(0.0, 6.0) * lobe
    lamps = _lamps(caster, rng, around, int(rng.integers(*LAMPS)))
    return Lighting(
        directions=directions, sky=brightness[:, None] * tint, bounced=bounced * np.exp(rng.normal(0.0, 0.05, 3)),
        reach=rng.uniform(1.5, 4.0), lamps=lamps,
        lamp_light=rng.uniform(0.5, 3.0) * np.array([1.05, 1.0, 0.9]) * np.exp(rng.normal(0.0, 0.1, (len(lamps), 3))),
        horizon=np.clip(np.array([0.88, 0.91, 0.94]) * np.exp(rng.normal(0.0, 0.08, 3)), 0.0, 1.0),
        zenith=np.clip(np.array([0.37, 0.55, 0.80]) * np.exp(rng.normal(0.0, 0.2, 3)), 0.0, 1.0),
    )  # fmt: skip


def _lamps(caster: MeshCaster, rng: np.random.Generator, around: np.ndarray, count: int) -> np.ndarray:
    """Positions before emissive faces, else between the camera and what is above it."""
    mesh = caster.mesh
    emissive = np.array([material.is_emissive for material in mesh.materials])[mesh.face_material]
    shining = np.flatnonzero(emissive)
    if len(shining) and count:
        areas = mesh.face_areas()[shining]
        if areas.sum() > 0:
            chosen = rng.choice(shining, count, p=areas / areas.sum())
            centres = mesh.vertices[mesh.faces[chosen]].mean(axis=1).astype(np.float64)
            normals = caster.normals[chosen]
            front, back = (caster.distances(centres + 0.02 * s * normals, s * normals) for s in (1.0, -1.0))
            return np.asarray(centres + 0.05 * np.where(front > back, 1.0, -1.0)[:, None] * normals)
    places = around + rng.normal(0.0, [1.2, 0.0, 1.2], (count, 3))
    above = caster.distances(places, np.broadcast_to([0.0, 1.0, 0.0], places.shape))
    rise = np.minimum(np.where(np.isinf(above), 2.0, above) * rng.uniform(0.5, 0.9, count), 3.0)
    places[:, 1] += rise
    return np.asarray(places)
