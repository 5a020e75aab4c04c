"""A panorama: colours from several samples a pixel, exact depth from its centre; and how meshes are drawn in it.

Light of a mesh without any is sky through the openings, walls that reflect, and lamps. It is a function of the point
and its normal alone (everything is diffuse), so all views of a scene agree.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions, pixel_to_direction
from omnisyn_cli.scenes.mesh.raycast import Caster, Hits, MeshCaster, sphere_directions
from omnisyn_cli.scenes.mesh.texturing import SurfaceColours

OFFSET = 2e-3  # Metres above its surface that a point asks for light
AMBIENT_LIGHT = 0.05  # Light where nothing shines
# Share of the scenes whose sky is as bright as their walls: few rays then leave no edges of shadows on plain walls.
SOFT = 0.6
LAMPS = (0, 5)  # Least and greatest number of lamps of a scene, less one


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


def draw_lighting(caster: MeshCaster, rng: np.random.Generator, around: Float[np.ndarray, " 3"], rays: int) -> Lighting:
    """Some sky, brighter on one side, lamps at emissive faces or near ``around``; points ask ``rays`` directions."""
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


SHOULDER = 0.6  # Light up to which the picture is proportional to it; beyond that it nears 1
MIDDLE_GREY = 0.16  # Light that the 60th percentile of a picture becomes
EXPOSURES = (0.3, 12.0)  # Least and greatest factor of the exposure
# Distance from the plane of the pixel's centre, relative to that to the camera, within which samples share light.
SAME_SURFACE = 0.02
SAME_NORMAL = 0.95  # Least cosine between normals that share light
BAND_ROWS = 16  # Rows of a picture that are drawn at once; chosen by timing


# Colours (sRGB in [0, 1]) of one sample of every pixel: what is seen, radians between samples, and which sample.
Shader = Callable[[Hits, float, int], Float[np.ndarray, "rays 3"]]


def render(
    caster: Caster, shader: Callable[[Hits], Shader], pose: Pose, size: tuple[int, int], supersample: int,
    threads: int | None = None,
) -> tuple[Float32[np.ndarray, "height width 3"], Float32[np.ndarray, "height width"]]:  # fmt: skip
    """Render one panorama: RGB in [0, 1], and metres along the ray of each pixel's centre, inf where there is nothing.

    ``shader`` says how samples look of pixels whose centres see some hits. ``pose`` is world from camera, y up,
    ``size`` ``(height, width)``. A pixel has ``supersample``² colour samples. ``threads`` change nothing.
    """
    height, width = size
    image, depth = np.zeros((height, width, 3), np.float32), np.empty((height, width), np.float32)
    fine, pixel = (height * supersample, width * supersample), math.pi / height / supersample

    def hits(begin: int, end: int, step: int, row: int, col: int, grid: tuple[int, int]) -> Hits:
        rows, cols = np.arange(begin, end) * step + row, np.arange(width) * step + col
        directions = pixel_to_direction(rows[:, None], cols[None], grid).reshape(-1, 3)
        return caster.hits(pose.position[None], directions @ pose.rotation.T)

    def draw(first_band: int, last_band: int) -> None:
        for begin in range(first_band * BAND_ROWS, min(height, last_band * BAND_ROWS), BAND_ROWS):
            end = min(height, begin + BAND_ROWS)
            centre = hits(begin, end, 1, 0, 0, size)
            depth[begin:end] = centre.distance.reshape(-1, width)
            shade, total = shader(centre), np.zeros((end - begin, width, 3))
            for sample in range(supersample**2):
                seen = hits(begin, end, supersample, *divmod(sample, supersample), fine)
                total += shade(seen, pixel, sample).reshape(total.shape) ** 2  # light adds up, not its roots
            image[begin:end] = np.sqrt(total) / supersample

    run_ranges(draw, -(-height // BAND_ROWS), threads)
    return image, depth


@dataclass(frozen=True)
class MeshScene:
    """A textured mesh in its light; ``exposure`` is a factor on light."""

    caster: MeshCaster
    colours: SurfaceColours
    lighting: Lighting
    exposure: float = 1.0

    def light(self, hits: Hits) -> Float[np.ndarray, "hits 3"]:
        """What shines on points: baked light where there is some, else the lighting."""
        light = self.colours.light(hits)
        dark = np.flatnonzero(np.isnan(light[:, 0]))
        unlit = hits.only(dark)
        light[dark] = self.lighting.at(self.caster, unlit.points, self.caster.facing_normals(unlit))
        return light

    def shader(self, centre: Hits) -> Shader:
        """Light is computed once a pixel, and again for samples that lie on another surface than its centre."""
        light, points, normals = (np.full((len(centre.face), 3), np.nan) for _ in range(3))
        rays = np.flatnonzero(centre.is_hit)
        seen = centre.only(rays)
        light[rays], points[rays], normals[rays] = self.light(seen), seen.points, self.caster.facing_normals(seen)

        def shade(hits: Hits, pixel: float, sample: int) -> Float[np.ndarray, "rays 3"]:
            rays = np.flatnonzero(hits.is_hit)
            seen, plane, shared = hits.only(rays), normals[rays], light[rays]
            apart = np.abs(np.einsum("ij,ij->i", seen.points - points[rays], plane))
            aligned = np.einsum("ij,ij->i", self.caster.facing_normals(seen), plane)
            own = np.flatnonzero(~((apart < SAME_SURFACE * seen.distance) & (aligned > SAME_NORMAL)))  # and where NaN
            shared[own] = self.light(seen.only(own))
            colours = self.lighting.background(hits.directions)
            x = np.sqrt(self.colours.at(seen, pixel) ** 2 * shared * self.exposure)
            rolled = SHOULDER + (1.0 - SHOULDER) * (1.0 - np.exp(-(x - SHOULDER) / (1.0 - SHOULDER)))
            colours[rays] = np.where(x < SHOULDER, x, rolled)
            return colours

        return shade


def lit_scene(caster: MeshCaster, rng: np.random.Generator, pose: Pose, rays: int) -> MeshScene:
    """A mesh in light that is drawn, with the exposure that suits a camera, for all pictures of a walk."""
    scene = MeshScene(caster, SurfaceColours(caster), draw_lighting(caster, rng, pose.position, rays))
    seen = caster.hits(pose.position[None], pixel_directions(32, 64).reshape(-1, 3) @ pose.rotation.T)
    seen = seen.only(np.flatnonzero(seen.is_hit))
    if not len(seen.face):
        return scene
    shown = scene.colours.at(seen, math.pi / 32) ** 2 * scene.light(seen)
    bright = float(np.percentile(shown.mean(axis=1), 60))
    return replace(scene, exposure=float(np.clip(MIDDLE_GREY / max(bright, 1e-3), *EXPOSURES)))


def render_mesh(
    scene: MeshScene, pose: Pose, size: tuple[int, int], *, supersample: int = 2
) -> tuple[Float32[np.ndarray, "height width 3"], Float32[np.ndarray, "height width"]]:
    """:func:`render` of a mesh."""
    return render(scene.caster, scene.shader, pose, size, supersample)
