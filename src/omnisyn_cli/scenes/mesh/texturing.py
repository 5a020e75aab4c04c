"""Colours of points on a mesh: textures with mip levels, by texture coordinates or projected along the axes.

And meshes made different every time they are learned from: size, handedness, furniture, materials.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from omnisyn_cli.geometry.textured_mesh import Material, TexturedMesh
from omnisyn_cli.scenes.mesh.raycast import Hits, MeshCaster

SHINING = 3.0  # Light of what is emissive
MIP_LEVELS = 10  # At most: textures of 1024 texels come down to 2


class SurfaceColours:
    """Textures of a mesh, ready to be looked up."""

    def __init__(self, caster: MeshCaster) -> None:
        self._caster, self._mesh = caster, caster.mesh
        self._pyramids = [_pyramid(material.texture) for material in caster.mesh.materials]
        self._texels = _texels_per_metre(caster.mesh)

    def at(self, hits: Hits, pixel: float) -> Float[np.ndarray, "rays 3"]:
        """Colours (sRGB in [0, 1]) of what was hit, all of it something; ``pixel`` radians are between samples."""
        mesh, points = self._mesh, hits.points
        corners, weights = mesh.faces[hits.face], self._caster.barycentric(hits.face, points)
        material = mesh.face_material[hits.face]
        uv = _interpolated(weights, mesh.uv[corners])
        footprint = hits.distance * pixel * self._texels[hits.face]  # texels between samples, before any projection
        colours = np.empty((len(points), 3))
        for index in np.unique(material):
            rows = np.flatnonzero(material == index)
            kind, pyramid = mesh.materials[index], self._pyramids[index]
            if pyramid:
                at, texels = uv[rows], footprint[rows]
                if kind.tile is not None:
                    at = projected(points[rows], self._caster.normals[hits.face[rows]]) / kind.tile
                    texels = hits.distance[rows] * pixel * pyramid[0].shape[1] / kind.tile
                colours[rows] = _filtered(pyramid, at, texels)
            elif mesh.vertex_colours is not None:
                colours[rows] = _interpolated(weights[rows], mesh.vertex_colours[corners[rows]])
            else:
                colours[rows] = kind.colour
        return colours

    def light(self, hits: Hits) -> Float[np.ndarray, "rays 3"]:
        """Light of what was hit that does not depend on the lighting: baked, or its own; NaN where there is none."""
        mesh = self._mesh
        light = np.full((len(hits.face), 3), np.nan)
        is_baked, is_lit, is_emissive = (
            np.array([getattr(m, name) for m in mesh.materials])[mesh.face_material[hits.face]]
            for name in ("is_lightmapped", "is_lit", "is_emissive")
        )
        if mesh.light_map is not None and mesh.light_uv is not None and is_baked.any():
            face = hits.face[is_baked]
            weights = self._caster.barycentric(face, hits.points[is_baked])
            uv = np.clip(_interpolated(weights, mesh.light_uv[mesh.faces[face]]), 0.0, 1.0)
            light[is_baked] = bilinear(mesh.light_map, uv)
        light[is_lit], light[is_emissive] = 1.0, SHINING
        return light


def _interpolated(weights: Float[np.ndarray, "n 3"], values: Float[np.ndarray, "n 3 k"]) -> Float[np.ndarray, "n k"]:
    return np.asarray(np.einsum("ij,ijk->ik", weights, values))


def projected(points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Metres across and up a surface, seen along the axis that it faces most."""
    axis = np.abs(normals).argmax(axis=1)
    across = np.where(axis == 0, points[:, 2], points[:, 0])
    up = np.where(axis == 1, points[:, 2], points[:, 1])
    return np.stack([across, up], axis=1)


def _pyramid(texture: UInt8[np.ndarray, "height width 3"] | None) -> list[np.ndarray]:
    """The texture, then each time half as large."""
    if texture is None:
        return []
    levels = [texture]
    while min(levels[-1].shape[:2]) > 1 and len(levels) < MIP_LEVELS:
        height, width = levels[-1].shape[:2]
        levels.append(cv2.resize(levels[-1], (max(1, width // 2), max(1, height // 2)), interpolation=cv2.INTER_AREA))
    return levels


def _texels_per_metre(mesh: TexturedMesh) -> Float[np.ndarray, " faces"]:
    """Of each face, along an edge of a square of its size."""
    a, b, c = (mesh.uv[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    first, second = b - a, c - a
    covered = 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    texels = np.array([0 if m.texture is None else m.texture.shape[0] * m.texture.shape[1] for m in mesh.materials])
    return np.asarray(np.sqrt(covered * texels[mesh.face_material] / np.maximum(mesh.face_areas(), 1e-12)))


def _filtered(pyramid: list[np.ndarray], uv: np.ndarray, texels: np.ndarray) -> np.ndarray:
    """From the level whose texels are as far apart as the samples."""
    level = np.clip(np.rint(np.log2(np.maximum(texels, 1e-6))), 0, len(pyramid) - 1).astype(np.int64)
    colours = np.empty((len(uv), 3))
    for each in np.unique(level):
        rows = level == each
        colours[rows] = bilinear(pyramid[each], uv[rows]) / 255.0
    return colours


def bilinear(image: np.ndarray, uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Values of an image that repeats itself at texture coordinates, (0, 0) in the lower left corner."""
    height, width = image.shape[:2]
    col, row = uv[:, 0] % 1.0 * width - 0.5, (1.0 - uv[:, 1]) % 1.0 * height - 0.5
    left, top = np.floor(col).astype(np.int64), np.floor(row).astype(np.int64)
    right_share, low_share = ((x - whole)[:, None].astype(np.float32) for x, whole in ((col, left), (row, top)))
    rows, cols = (top % height, (top + 1) % height), (left % width, (left + 1) % width)
    upper = image[rows[0], cols[0]] * (1 - right_share) + image[rows[0], cols[1]] * right_share
    lower = image[rows[1], cols[0]] * (1 - right_share) + image[rows[1], cols[1]] * right_share
    return np.asarray(upper * (1 - low_share) + lower * low_share)


def untextured_share(mesh: TexturedMesh) -> float:
    """Share of the area without texture or colours of its own."""
    if mesh.vertex_colours is not None:
        return 0.0
    plain = np.array([not material.is_textured for material in mesh.materials])[mesh.face_material]
    areas = mesh.face_areas()
    return float(areas[plain].sum() / max(areas.sum(), 1e-12))


SCALES = (0.75, 1.35)  # Least and largest factor of the size. Set by hand.
DROP_CHANCE = 0.12  # Chance that a small material's faces are left out
MAX_DROPPED_AREA_SHARE = 0.04  # Share of the area up to which a material may be left out
# Share of the materials without texture that get a photograph, between which a scene draws its own.
PHOTO_SHARES = (0.0, 0.8)
REPLACEMENT_CHANCE = 0.15  # Chance that a textured material gets another photograph
TILES = (0.4, 4.0)  # Metres that a photograph spans

Photos = Sequence[UInt8[np.ndarray, "height width 3"]]  # Photographs of surfaces.


def varied_mesh(mesh: TexturedMesh, rng: np.random.Generator, photos: Photos) -> TexturedMesh:
    """Another size, handedness, other materials (without photographs only colours), less furniture; same light map."""
    areas = np.bincount(mesh.face_material, mesh.face_areas(), len(mesh.materials))
    is_small = areas < MAX_DROPPED_AREA_SHARE * areas.sum()
    kept = ~(is_small & (rng.random(len(areas)) < DROP_CHANCE * rng.random()))[mesh.face_material]
    scale = np.exp(rng.uniform(*np.log(SCALES))) * np.array([rng.choice([-1.0, 1.0]), 1.0, 1.0])
    share = rng.uniform(*PHOTO_SHARES)
    return replace(
        mesh,
        vertices=(mesh.vertices * scale).astype(np.float32),
        faces=mesh.faces[kept],
        face_material=mesh.face_material[kept],
        materials=tuple(_varied(material, rng, photos, share) for material in mesh.materials),
    )


def papered_mesh(mesh: TexturedMesh, rng: np.random.Generator, photos: Photos) -> TexturedMesh:
    """The mesh with a photograph on every material that has no texture and does not shine."""
    materials = []
    for material in mesh.materials:
        photo, tile = int(rng.integers(len(photos))), rng.uniform(*np.log(TILES))
        if not (material.is_textured or material.is_emissive):
            material = replace(material, texture=photos[photo], tile=float(np.exp(tile)))
        materials.append(material)
    return replace(mesh, materials=tuple(materials))


def _varied(material: Material, rng: np.random.Generator, photos: Photos, share: float) -> Material:
    # the same numbers are drawn for every material, so that one more photograph does not change all others
    chance, photo = rng.random(), int(rng.integers(1 << 30))
    tile, tint = rng.uniform(*np.log(TILES)), rng.normal(0, 1, 3)
    if material.is_emissive or material.is_lightmapped or material.is_lit:
        return material
    if photos and chance < (REPLACEMENT_CHANCE if material.is_textured else share) and material.opacity is None:
        return replace(material, texture=photos[photo % len(photos)], tile=float(np.exp(tile)))
    if not material.is_textured:
        return replace(material, colour=np.clip(material.colour * np.exp(0.15 * tint + 0.1 * tint[0]), 0.02, 0.98))
    return material
