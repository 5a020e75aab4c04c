"""A mesh made different every time it is learned from: size, handedness, furniture, materials."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, UInt8

from omnisyn_cli.geometry.textured_mesh import Material, TexturedMesh

SCALES = (0.75, 1.35)
"""Least and largest factor of the size. Set by hand."""

DROP_CHANCE = 0.12
"""Chance that a small material's faces are left out."""

MAX_DROPPED_AREA_SHARE = 0.04
"""Share of the area up to which a material may be left out."""

PHOTO_SHARES = (0.0, 0.8)
"""Share of the materials without texture that get a photograph, between which a scene draws its own."""

REPLACEMENT_CHANCE = 0.15
"""Chance that a textured material gets another photograph."""

TILES = (0.4, 4.0)
"""Metres that a photograph spans."""


def varied_mesh(
    mesh: TexturedMesh, rng: np.random.Generator, photos: Sequence[UInt8[np.ndarray, "height width 3"]]
) -> TexturedMesh:
    """The mesh in another size, mirrored or not, with other materials and some things left out.

    Args:
        mesh: what is varied; its light map, if any, stays.
        rng: random numbers.
        photos: photographs of surfaces; with none, materials get other colours only.
    """
    kept = _kept_faces(mesh, rng)
    scale = np.exp(rng.uniform(*np.log(SCALES))) * np.array([rng.choice([-1.0, 1.0]), 1.0, 1.0])
    share = rng.uniform(*PHOTO_SHARES)
    return replace(
        mesh,
        vertices=(mesh.vertices * scale).astype(np.float32),
        faces=mesh.faces[kept],
        face_material=mesh.face_material[kept],
        materials=tuple(_varied(material, rng, photos, share) for material in mesh.materials),
    )


def papered_mesh(
    mesh: TexturedMesh, rng: np.random.Generator, photos: Sequence[UInt8[np.ndarray, "height width 3"]]
) -> TexturedMesh:
    """The mesh with a photograph on every material that has no texture and does not shine."""
    return replace(mesh, materials=tuple(_papered(material, rng, photos) for material in mesh.materials))


def _papered(material: Material, rng: np.random.Generator, photos: Sequence[np.ndarray]) -> Material:
    photo, tile = int(rng.integers(len(photos))), rng.uniform(*np.log(TILES))
    if material.is_textured or material.is_emissive:
        return material
    return replace(material, texture=photos[photo], tile=float(np.exp(tile)))


def _kept_faces(mesh: TexturedMesh, rng: np.random.Generator) -> Bool[np.ndarray, " faces"]:
    areas = np.bincount(mesh.face_material, mesh.face_areas(), len(mesh.materials))
    is_small = areas < MAX_DROPPED_AREA_SHARE * areas.sum()
    dropped = is_small & (rng.random(len(areas)) < DROP_CHANCE * rng.random())
    return np.asarray(~dropped[mesh.face_material])


def _varied(material: Material, rng: np.random.Generator, photos: Sequence[np.ndarray], share: float) -> Material:
    # the same numbers are drawn for every material, so that one more photograph does not change all others
    chance, photo, tile, tint = (
        rng.random(),
        int(rng.integers(1 << 30)),
        rng.uniform(*np.log(TILES)),
        rng.normal(0, 1, 3),
    )
    if material.is_emissive or material.is_lightmapped or material.is_lit:
        return material
    if photos and chance < (REPLACEMENT_CHANCE if material.is_textured else share) and material.opacity is None:
        return replace(material, texture=photos[photo % len(photos)], tile=float(np.exp(tile)))
    if not material.is_textured:
        return replace(material, colour=np.clip(material.colour * np.exp(0.15 * tint + 0.1 * tint[0]), 0.02, 0.98))
    return material
