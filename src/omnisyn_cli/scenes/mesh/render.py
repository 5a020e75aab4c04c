"""A panorama of a mesh: colours from several samples a pixel, exact depth from its centre."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32, Int64

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.textured_mesh import TexturedMesh
from omnisyn_cli.scenes.mesh.lighting import Lighting
from omnisyn_cli.scenes.mesh.raycast import Hits, MeshCaster
from omnisyn_cli.scenes.mesh.texturing import SurfaceColours

__all__ = ["MeshScene", "render_mesh"]

SHINING = 3.0
"""Light of what is emissive."""

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


@dataclass(frozen=True)
class MeshScene:
    """A mesh in its light.

    Attributes:
        caster: the mesh, ready for rays.
        colours: its textures.
        lighting: what shines on it.
        exposure: factor on light; None chooses one for each picture.
    """

    caster: MeshCaster
    colours: SurfaceColours
    lighting: Lighting
    exposure: float | None = None

    @staticmethod
    def of(mesh: TexturedMesh, lighting: Lighting, caster: MeshCaster | None = None) -> "MeshScene":
        """A scene without a fixed exposure."""
        return MeshScene(caster or MeshCaster(mesh), SurfaceColours(mesh), lighting)

    def exposed_at(self, pose: Pose) -> "MeshScene":
        """The scene with the exposure that suits a camera, for all pictures of a walk."""
        seen = _seen(self.caster, pose, pixel_directions(32, 64).reshape(-1, 3))
        if not len(seen.rays):
            return replace(self, exposure=1.0)
        shown = self.colours.at(seen.hits, seen.points, seen.normals, math.pi / 32) ** 2 * self.light(seen)
        bright = float(np.percentile(shown.mean(axis=1), 60))
        return replace(self, exposure=float(np.clip(MIDDLE_GREY / max(bright, 1e-3), *EXPOSURES)))

    def light(self, seen: "Seen") -> Float[np.ndarray, "seen 3"]:
        """What shines on points: baked light where there is some, else the lighting."""
        light = self.colours.light(seen.hits)
        mesh = self.caster.mesh
        shines = np.array([material.is_emissive for material in mesh.materials])[mesh.face_material[seen.hits.face]]
        light[shines] = SHINING
        dark = np.isnan(light[:, 0])
        light[dark] = self.lighting.at(self.caster, seen.points[dark], seen.normals[dark])
        return light


@dataclass(frozen=True)
class Seen:
    """Where the rays of a camera that hit something hit it.

    Attributes:
        rays: ``(seen,)`` which rays these are.
        hits: what they hit.
        points: ``(seen, 3)``.
        normals: ``(seen, 3)`` towards the camera.
    """

    rays: Int64[np.ndarray, " seen"]
    hits: Hits
    points: Float[np.ndarray, "seen 3"]
    normals: Float[np.ndarray, "seen 3"]

    def only(self, chosen: Int64[np.ndarray, " chosen"]) -> "Seen":
        """Some of them."""
        hits = Hits(self.hits.face[chosen], self.hits.distance[chosen], self.hits.barycentric[chosen])
        return Seen(self.rays[chosen], hits, self.points[chosen], self.normals[chosen])


def _seen(caster: MeshCaster, pose: Pose, directions: Float[np.ndarray, "rays 3"]) -> Seen:
    """What a camera sees along directions of its own frame."""
    world = directions @ pose.rotation.T
    hits = caster.hits(np.broadcast_to(pose.position, world.shape), world)
    rays = np.flatnonzero(hits.is_hit)
    found = Hits(hits.face[rays], hits.distance[rays], hits.barycentric[rays])
    points = pose.position + world[rays] * found.distance[:, None]
    normals = caster.normals[found.face]
    is_behind = np.einsum("ij,ij->i", normals, world[rays]) > 0
    return Seen(rays, found, points, np.where(is_behind[:, None], -normals, normals))


def render_mesh(
    scene: MeshScene, pose: Pose, size: tuple[int, int], *, supersample: int = 2
) -> tuple[Float32[np.ndarray, "height width 3"], Float32[np.ndarray, "height width"]]:
    """Render one panorama.

    Light is computed once a pixel, and again for samples that lie on another surface than its centre.

    Args:
        scene: with or without an exposure.
        pose: world from camera, y up.
        size: ``(height, width)``.
        supersample: colour samples per pixel along each axis.

    Returns:
        ``(image, depth)``: RGB in [0, 1], and Euclidean metres along the ray of the pixel's centre, inf where there is
        nothing.
    """
    if scene.exposure is None:
        scene = scene.exposed_at(pose)
    height, width = size
    centre = _seen(scene.caster, pose, pixel_directions(height, width).reshape(-1, 3))
    depth = np.full(height * width, np.inf, np.float32)
    depth[centre.rays] = centre.hits.distance
    light, points, normals = (np.full((height * width, 3), np.nan) for _ in range(3))
    light[centre.rays], points[centre.rays], normals[centre.rays] = scene.light(centre), centre.points, centre.normals
    total = np.zeros((height * width, 3))
    fine, pixel = pixel_directions(height * supersample, width * supersample), math.pi / height / supersample
    for row in range(supersample):
        for col in range(supersample):
            directions = fine[row::supersample, col::supersample].reshape(-1, 3)
            total += _sample(scene, pose, directions, (light, points, normals), pixel)
    image = (total / supersample**2).astype(np.float32).reshape(height, width, 3)
    return image, depth.reshape(height, width)


def _sample(
    scene: MeshScene,
    pose: Pose,
    directions: Float[np.ndarray, "pixels 3"],
    centre: tuple[np.ndarray, np.ndarray, np.ndarray],
    pixel: float,
) -> Float[np.ndarray, "pixels 3"]:
    """Colours of one sample of every pixel, sRGB in [0, 1].

    Args:
        scene: with an exposure.
        pose: of the camera.
        directions: of the samples, in its frame.
        centre: light, point and normal at the centre of each pixel, NaN where nothing is.
        pixel: radians between samples.
    """
    seen = _seen(scene.caster, pose, directions)
    centre_light, centre_point, centre_normal = (values[seen.rays] for values in centre)
    apart = np.abs(np.einsum("ij,ij->i", seen.points - centre_point, centre_normal))
    aligned = np.einsum("ij,ij->i", seen.normals, centre_normal)
    shares_light = (apart < SAME_SURFACE * seen.hits.distance) & (aligned > SAME_NORMAL)  # False where NaN
    light, own = centre_light, np.flatnonzero(~shares_light)
    light[own] = scene.light(seen.only(own))
    albedo = scene.colours.at(seen.hits, seen.points, seen.normals, pixel) ** 2
    colours = scene.lighting.background(directions @ pose.rotation.T)
    colours[seen.rays] = developed(albedo * light, scene.exposure or 1.0)
    return colours


def developed(light: Float[np.ndarray, "*shape"], exposure: float) -> Float[np.ndarray, "*shape"]:
    """Light as it is in a picture: the square root, with a soft shoulder."""
    x = np.sqrt(light * exposure)
    return np.where(x < SHOULDER, x, SHOULDER + (1.0 - SHOULDER) * (1.0 - np.exp(-(x - SHOULDER) / (1.0 - SHOULDER))))
