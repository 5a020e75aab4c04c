"""A panorama: colours from several samples a pixel, exact depth from its centre; and how meshes are drawn in it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions, pixel_to_direction
from omnisyn_cli.geometry.textured_mesh import TexturedMesh
from omnisyn_cli.scenes.mesh.lighting import Lighting
from omnisyn_cli.scenes.mesh.raycast import Caster, Hits, MeshCaster
from omnisyn_cli.scenes.mesh.texturing import SurfaceColours

SHOULDER = 0.6
"""Light up to which the picture is proportional to it; beyond that it nears 1."""

MIDDLE_GREY = 0.16
"""Light that the 60th percentile of a picture becomes."""

EXPOSURES = (0.3, 12.0)
"""Least and greatest factor of the exposure."""

SAME_SURFACE = 0.02
"""Distance from the plane of the pixel's centre, relative to that to the camera, within which samples share light."""

SAME_NORMAL = 0.95
"""Least cosine between normals that share light."""

BAND_ROWS = 16
"""Rows of a picture that are drawn at once; chosen by timing."""


Shader = Callable[[Hits, float, int], Float[np.ndarray, "rays 3"]]
"""Colours (sRGB in [0, 1]) of one sample of every pixel: what is seen, radians between samples, and which sample."""


def render(
    caster: Caster, shader: Callable[[Hits], Shader], pose: Pose, size: tuple[int, int], supersample: int,
    threads: int | None = None,
) -> tuple[Float32[np.ndarray, "height width 3"], Float32[np.ndarray, "height width"]]:  # fmt: skip
    """Render one panorama: RGB in [0, 1], and metres along the ray of each pixel's centre, inf where there is nothing.

    ``caster`` says what rays hit, ``shader`` how samples look of pixels whose centres see some hits. ``pose`` is world
    from camera, y up, ``size`` ``(height, width)``. A pixel has ``supersample``² colour samples. The result does not
    depend on ``threads`` (None: one per core).
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
    """A mesh, ready for rays, with its textures in its light.

    ``exposure`` is a factor on light; None chooses one for each picture.
    """

    caster: MeshCaster
    colours: SurfaceColours
    lighting: Lighting
    exposure: float | None = None

    @staticmethod
    def of(mesh: TexturedMesh, lighting: Lighting, caster: MeshCaster | None = None) -> "MeshScene":
        """A scene without a fixed exposure."""
        caster = caster or MeshCaster(mesh)
        return MeshScene(caster, SurfaceColours(caster), lighting)

    def exposed_at(self, pose: Pose) -> "MeshScene":
        """The scene with the exposure that suits a camera, for all pictures of a walk."""
        seen = self.caster.hits(pose.position[None], pixel_directions(32, 64).reshape(-1, 3) @ pose.rotation.T)
        seen = seen.only(np.flatnonzero(seen.is_hit))
        if not len(seen.face):
            return replace(self, exposure=1.0)
        shown = self.colours.at(seen, math.pi / 32) ** 2 * self.light(seen)
        bright = float(np.percentile(shown.mean(axis=1), 60))
        return replace(self, exposure=float(np.clip(MIDDLE_GREY / max(bright, 1e-3), *EXPOSURES)))

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
            colours[rays] = developed(self.colours.at(seen, pixel) ** 2 * shared, self.exposure or 1.0)
            return colours

        return shade


def render_mesh(
    scene: MeshScene, pose: Pose, size: tuple[int, int], *, supersample: int = 2, threads: int | None = None
) -> tuple[Float32[np.ndarray, "height width 3"], Float32[np.ndarray, "height width"]]:
    """:func:`render` of a mesh, with the exposure that suits the pose where the scene has none."""
    scene = scene if scene.exposure else scene.exposed_at(pose)
    return render(scene.caster, scene.shader, pose, size, supersample, threads)


def developed(light: Float[np.ndarray, "*shape"], exposure: float) -> Float[np.ndarray, "*shape"]:
    """Light as it is in a picture: the square root, with a soft shoulder."""
    x = np.sqrt(light * exposure)
    return np.where(x < SHOULDER, x, SHOULDER + (1.0 - SHOULDER) * (1.0 - np.exp(-(x - SHOULDER) / (1.0 - SHOULDER))))
