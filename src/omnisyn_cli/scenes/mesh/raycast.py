"""Rays against triangles, by Embree; distances are computed anew in double precision."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.textured_mesh import TexturedMesh

LAYERS = 8  # Surfaces with holes that a ray passes at most
STEP = 1e-4  # Metres, and share of the distance, by which a ray goes on behind a hole
OPAQUE = 128  # Least opacity that stops a ray
MISS_DISTANCE_BOUND = 1e30  # Embree's distance where there is nothing is beyond this


@dataclass(frozen=True)
class Hits:
    """What rays hit first: from origins in metres along unit vectors a face, −1 and infinitely far where nothing is."""

    origins: Float[np.ndarray, "rays 3"]
    directions: Float[np.ndarray, "rays 3"]
    face: Int64[np.ndarray, " rays"]
    distance: Float[np.ndarray, " rays"]

    @property
    def is_hit(self) -> Bool[np.ndarray, " rays"]:
        """Whether there is something."""
        return np.asarray(self.face >= 0)

    @property
    def points(self) -> Float[np.ndarray, "rays 3"]:
        """Where it is; infinite where there is nothing."""
        return np.asarray(self.origins + self.directions * self.distance[:, None])

    def only(self, rays: Int64[np.ndarray, " chosen"]) -> "Hits":
        """Those of some rays."""
        return Hits(self.origins[rays], self.directions[rays], self.face[rays], self.distance[rays])


class Caster:
    """Triangles (metres) for rays, which pass ``perforated`` faces where ``is_hole``; InputError: no Embree."""

    def __init__(
        self, vertices: Float32[np.ndarray, "vertices 3"], faces: Int32[np.ndarray, "faces 3"],
        perforated: Bool[np.ndarray, " faces"], is_hole: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> None:  # fmt: skip
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise InputError(
                'expected the package embreex to render scenes, found none; pip install "omnisyn-cli[scenes]"'
            ) from error
        self._scene = EmbreeScene()
        self._triangles = TriangleMesh(self._scene, np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
        self._origin, second, third = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
        self._edges = second - self._origin, third - self._origin
        normals = np.cross(*self._edges)
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        self._offset = np.einsum("ij,ij->i", self._origin, self.normals)
        self._perforated, self._is_hole = perforated, is_hole

    def distances(
        self, origins: Float[np.ndarray, "rays 3"], directions: Float[np.ndarray, "rays 3"]
    ) -> Float[np.ndarray, " rays"]:
        """Metres to the first surface, holes included, infinite where there is none; single precision."""
        found = self._scene.run(*_single(origins, directions), query="DISTANCE")
        return np.asarray(np.where(found > MISS_DISTANCE_BOUND, np.inf, found))

    def hits(self, origins: Float[np.ndarray, "#rays 3"], directions: Float[np.ndarray, "rays 3"]) -> Hits:
        """The first opaque surface along unit vectors."""
        rays, origins = len(directions), np.broadcast_to(origins, directions.shape)
        face, distance = np.full(rays, -1, np.int64), np.full(rays, np.inf)
        left, passed = np.arange(rays), np.zeros(rays)
        for layer in range(LAYERS):
            origin, direction = origins[left], directions[left]
            starts = origin + direction * passed[left, None] if layer else origin
            found = self._scene.run(*_single(starts, direction), query="INTERSECT").astype(np.int64)
            is_hit = found >= 0
            if not is_hit.all():
                left, found, origin, direction = left[is_hit], found[is_hit], origin[is_hit], direction[is_hit]
            along = np.maximum(self._plane_distances(found, origin, direction), passed[left])
            face[left], distance[left] = found, along
            open_rows = np.flatnonzero(self._perforated[found]) if layer < LAYERS - 1 else np.empty(0, np.int64)
            points = origin[open_rows] + direction[open_rows] * along[open_rows, None]
            open_rows = open_rows[self._is_hole(found[open_rows], points)]
            left, along = left[open_rows], along[open_rows]
            if not len(left):
                break
            face[left], distance[left] = -1, np.inf
            passed[left] = along + STEP * (1.0 + along)
        return Hits(origins, directions, face, distance)

    def facing_normals(self, hits: Hits) -> Float[np.ndarray, "rays 3"]:
        """Normals of what rays hit, all of them something, towards their origins."""
        normals = self.normals[hits.face]
        is_behind = np.einsum("ij,ij->i", normals, hits.directions) > 0
        return np.asarray(np.where(is_behind[:, None], -normals, normals))

    def _plane_distances(self, face: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        normal = self.normals[face]
        slope = np.einsum("ij,ij->i", directions, normal)
        slope = np.where(np.abs(slope) < 1e-9, 1e-9, slope)
        return np.asarray(np.abs((self._offset[face] - np.einsum("ij,ij->i", origins, normal)) / slope))

    def barycentric(self, face: Int64[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Weights of the three vertices at points of faces."""
        first, second, to = self._edges[0][face], self._edges[1][face], points - self._origin[face]
        a, b, c = (np.einsum("ij,ij->i", *pair) for pair in ((first, first), (first, second), (second, second)))
        d, e = np.einsum("ij,ij->i", to, first), np.einsum("ij,ij->i", to, second)
        area = a * c - b * b + 1e-30
        one, two = (c * d - b * e) / area, (a * e - b * d) / area
        return np.stack([1.0 - one - two, one, two], axis=1)


class MeshCaster(Caster):
    """A mesh prepared for rays; textures with opacity have holes."""

    def __init__(self, mesh: TexturedMesh) -> None:
        self.mesh = mesh
        cuts = np.array([material.opacity is not None for material in mesh.materials])
        super().__init__(mesh.vertices, mesh.faces, cuts[mesh.face_material], self._is_cut)

    def _is_cut(self, face: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Where the texture of a surface lets the ray through."""
        cut = np.zeros(len(face), np.bool_)
        uv = np.einsum("ij,ijk->ik", self.barycentric(face, points), self.mesh.uv[self.mesh.faces[face]])
        material = self.mesh.face_material[face]
        for index in np.unique(material):
            rows = material == index
            opacity = self.mesh.materials[index].opacity
            if opacity is not None:
                height, width = opacity.shape
                row = np.floor((1.0 - uv[rows, 1]) * height).astype(np.int64) % height
                cut[rows] = opacity[row, np.floor(uv[rows, 0] * width).astype(np.int64) % width] < OPAQUE
        return cut


def _single(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32)
