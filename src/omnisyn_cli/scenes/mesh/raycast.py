"""Rays against a triangle mesh, by Embree; distances are computed anew in double precision."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.textured_mesh import TexturedMesh

__all__ = ["Hits", "MeshCaster"]

LAYERS = 8
"""Cut-out surfaces that a ray passes at most."""

STEP = 1e-4
"""Metres, and share of the distance, by which a ray goes on behind a cut-out."""

OPAQUE = 128
"""Least opacity that stops a ray."""

MISS_DISTANCE_BOUND = 1e30
"""Embree's distance where there is nothing is beyond this."""


@dataclass(frozen=True)
class Hits:
    """What rays hit first.

    Attributes:
        face: −1 where there is nothing.
        distance: metres along the unit vector, infinite where there is nothing.
        barycentric: weights of the three vertices.
    """

    face: Int64[np.ndarray, " rays"]
    distance: Float[np.ndarray, " rays"]
    barycentric: Float[np.ndarray, "rays 3"]

    @property
    def is_hit(self) -> Bool[np.ndarray, " rays"]:
        """Whether there is something."""
        return self.face >= 0


class MeshCaster:
    """A mesh prepared for rays.

    Args:
        mesh: with at least one face.

    Raises:
        InputError: Embree is not installed.
    """

    def __init__(self, mesh: TexturedMesh) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise InputError(
                'expected the package embreex to render meshes, found none; pip install "omnisyn-cli[scenes]"'
            ) from error
        self.mesh = mesh
        self._scene = EmbreeScene()
        self._triangles = TriangleMesh(
            self._scene, np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces)
        )
        self.normals = mesh.face_normals()
        self._origin, second, third = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
        self._edges = second - self._origin, third - self._origin
        self._cuts = np.array([material.opacity is not None for material in mesh.materials])

    def distances(
        self, origins: Float[np.ndarray, "rays 3"], directions: Float[np.ndarray, "rays 3"]
    ) -> Float[np.ndarray, " rays"]:
        """Metres to the first surface, cut-outs included, infinite where there is none; single precision."""
        found = self._scene.run(*_single(origins, directions), query="DISTANCE")
        return np.where(found > MISS_DISTANCE_BOUND, np.inf, found)

    def hits(self, origins: Float[np.ndarray, "rays 3"], directions: Float[np.ndarray, "rays 3"]) -> Hits:
        """The first opaque surface along unit vectors."""
        rays = len(directions)
        face, distance = np.full(rays, -1, np.int64), np.full(rays, np.inf)
        barycentric = np.zeros((rays, 3))
        left, passed = np.arange(rays), np.zeros(rays)
        for layer in range(LAYERS):
            starts = origins[left] + directions[left] * passed[left, None]
            found = self._scene.run(*_single(starts, directions[left]), query="INTERSECT").astype(np.int64)
            left, found = left[found >= 0], found[found >= 0]
            if not len(left):
                break
            along = np.maximum(self._plane_distances(found, origins[left], directions[left]), passed[left])
            weights = self._barycentric(found, origins[left] + directions[left] * along[:, None])
            is_open = self._is_hole(found, weights) if layer < LAYERS - 1 else np.zeros(len(left), np.bool_)
            stopped = left[~is_open]
            face[stopped], distance[stopped], barycentric[stopped] = (
                found[~is_open], along[~is_open], weights[~is_open]
            )  # fmt: skip
            passed[left] = along + STEP * (1.0 + along)
            left = left[is_open]
        return Hits(face, distance, barycentric)

    def _plane_distances(self, face: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        normal = self.normals[face]
        slope = np.einsum("ij,ij->i", directions, normal)
        slope = np.where(np.abs(slope) < 1e-9, 1e-9, slope)
        return np.asarray(np.abs(np.einsum("ij,ij->i", self._origin[face] - origins, normal) / slope))

    def _barycentric(self, face: np.ndarray, points: np.ndarray) -> np.ndarray:
        first, second, to = self._edges[0][face], self._edges[1][face], points - self._origin[face]
        a, b, c = (np.einsum("ij,ij->i", *pair) for pair in ((first, first), (first, second), (second, second)))
        d, e = np.einsum("ij,ij->i", to, first), np.einsum("ij,ij->i", to, second)
        area = a * c - b * b + 1e-30
        one, two = (c * d - b * e) / area, (a * e - b * d) / area
        return np.stack([1.0 - one - two, one, two], axis=1)

    def _is_hole(self, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Where the texture of a surface lets the ray through."""
        holes = np.zeros(len(face), np.bool_)
        material = self.mesh.face_material[face]
        for index in np.unique(material[self._cuts[material]]):
            rows = np.flatnonzero(material == index)
            opacity = self.mesh.materials[index].opacity
            if opacity is None:
                continue
            uv = np.einsum("ij,ijk->ik", barycentric[rows], self.mesh.uv[self.mesh.faces[face[rows]]])
            height, width = opacity.shape
            row = np.floor((1.0 - uv[:, 1]) * height).astype(np.int64) % height
            holes[rows] = opacity[row, np.floor(uv[:, 0] * width).astype(np.int64) % width] < OPAQUE
        return holes


def _single(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32)
