"""Panoramas of generated scenes: their triangles, ready for rays, and the samples of a pixel."""

from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.scenes.mesh.raycast import Caster, Hits
from omnisyn_cli.scenes.mesh.render import render
from omnisyn_cli.scenes.scene import Scene, triangles
from omnisyn_cli.scenes.shader import Surfaces, find_holes, find_surfaces, shade_rays

# Points on the disc of the sun, in half angles: the samples of a pixel see them in turn.
SUN_POINTS = ((-0.5, -0.5), (0.5, -0.2), (-0.2, 0.5), (0.4, 0.4))


class DrawnScene:
    """A generated scene, ready to be drawn."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._vertices, self._faces, self.owner, axis = triangles(scene.shapes)
        self._surfaces = Surfaces(scene.shapes, scene.materials, self.owner, axis)
        light = scene.lighting
        self._lit = (self._surfaces, scene.photos, light, scene.lamps)
        sun = np.array(light.sun_direction)
        side = np.cross(sun, [0.0, 0.0, 1.0] if abs(sun[2]) < 0.9 else [1.0, 0.0, 0.0])
        across = np.stack([side / np.linalg.norm(side), np.cross(sun, side) / np.linalg.norm(side)])
        suns = sun + light.softness * np.array(SUN_POINTS) @ across
        self._suns = suns / np.linalg.norm(suns, axis=1, keepdims=True)

    @cached_property
    def caster(self) -> Caster:
        """Of all there is."""
        return self._caster(np.ones(len(self._faces), np.bool_))

    @cached_property
    def _shadow_caster(self) -> Caster:
        return self._caster(self._scene.shapes["casts_shadow"][self.owner])

    def _caster(self, chosen: np.ndarray) -> Caster:
        surfaces = self._surfaces._replace(owner=self.owner[chosen], axis=self._surfaces.axis[chosen])

        def is_hole(face: np.ndarray, points: np.ndarray) -> np.ndarray:
            is_open = np.empty(len(face), np.bool_)
            find_holes(surfaces, face, points, is_open)
            return is_open

        perforated = surfaces.materials["is_perforated"][surfaces.shapes["material"][surfaces.owner, 0]]
        return Caster(self._vertices, self._faces[chosen], perforated, is_hole)

    def shade(self, hits: Hits, pixel: float, sample: int) -> Float[np.ndarray, "rays 3"]:
        """Colours as of :data:`omnisyn_cli.scenes.mesh.render.Shader`; every sample has its own light."""
        directions, sun = hits.directions, self._suns[sample % len(SUN_POINTS)]
        points = np.where(hits.is_hit[:, None], hits.points, 0.0)
        starts, normals, colours = np.empty_like(points), np.zeros_like(points), np.empty_like(points)
        find_surfaces(self._surfaces, hits.face, points, directions, starts, normals)
        sunlit = normals @ sun if max(self._scene.lighting.sun) > 0.0 else np.zeros(len(points))
        facing = np.flatnonzero(sunlit > 0.0)
        shadows = self._shadow_caster.hits(starts[facing], np.broadcast_to(sun, (len(facing), 3)))
        sunlit[facing[shadows.is_hit]] = 0.0
        hit = (points, directions, hits.face, hits.distance)
        shade_rays(self._lit, sun, hit, normals, np.maximum(sunlit, 0.0), pixel, colours)
        return colours


_drawn = lru_cache(maxsize=2)(DrawnScene)


def render_panorama(
    scene: Scene, pose: Pose, size: tuple[int, int], *, supersample: int = 2, threads: int | None = None
) -> tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width"]]:
    """:func:`omnisyn_cli.scenes.mesh.render.render` of a generated scene; depth is inf where there is only sky."""
    drawn = _drawn(scene)
    return render(drawn.caster, lambda _: drawn.shade, pose, size, supersample, threads)


def trace_rays(
    scene: Scene, position: Float[np.ndarray, "3"], directions: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Metres along unit vectors from a position (inf: sky), and the index of the shape that is hit (−1: sky)."""
    drawn = _drawn(scene)
    hits = drawn.caster.hits(position[None], directions)
    return hits.distance, np.where(hits.is_hit, drawn.owner[hits.face], -1)
