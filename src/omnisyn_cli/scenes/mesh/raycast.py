"""Rays against triangles, by Embree, with distances in double precision; where cameras stand, by what they see."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.textured_mesh import TexturedMesh

GOLDEN_RATIO = (1.0 + math.sqrt(5.0)) / 2.0  # Turns of a spiral by it spread points evenly (Fibonacci lattice)
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
            normal = self.normals[found]
            slope = np.einsum("ij,ij->i", direction, normal)
            slope = np.where(np.abs(slope) < 1e-9, 1e-9, slope)
            to_plane = np.abs((self._offset[found] - np.einsum("ij,ij->i", origin, normal)) / slope)
            along = np.maximum(to_plane, passed[left])
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


def sphere_directions(count: int, turn: float = 0.0) -> Float[np.ndarray, "count 3"]:
    """Unit vectors spread evenly (a Fibonacci spiral), turned about the vertical."""
    index = np.arange(count)
    height = 1.0 - 2.0 * (index + 0.5) / count
    azimuth = 2.0 * math.pi * index / GOLDEN_RATIO + turn
    side = np.sqrt(1.0 - height**2)
    return np.stack([side * np.cos(azimuth), height, side * np.sin(azimuth)], axis=1)


EYE_HEIGHTS = (1.1, 1.9)  # Metres above the floor
CLEARANCE = 0.3  # Metres to the nearest surface, at least
RAYS = 96  # That a place is judged by
MIN_ENCLOSED_SHARE = 0.52  # Share of the rays that hit something; an empty plane alone is half
MIN_FLOOR_SHARE = 0.95  # Share of the rays below a place that hit something
# Share of surfaces seen from behind, in the gap between two shells; inside or outside it is nearly none or all.
BETWEEN_SHELLS = (0.4, 0.6)
LEVEL = 0.8  # Least cosine between the normal of a floor and up
NEAR_MEDIAN = 0.6  # Metres: places whose median distance is less are inside of things
BASELINES = (0.12, 2.4)  # Of walks, in median distances
LONGEST_WALK = 12.0  # Metres
ATTEMPTS = 200  # Places that are drawn before a mesh is given up. Set by hand.
PLACES = 40  # That a walk begins at one of

Place = tuple[Float[np.ndarray, " 3"], float]  # For a camera, and the median distance of what is around it; metres


def look_around(caster: MeshCaster, position: Float[np.ndarray, " 3"]) -> float | None:
    """Median distance of what a camera there would see, metres; None where none should stand."""
    directions = sphere_directions(RAYS)
    hits = caster.hits(position[None], directions)
    found = hits.is_hit
    below = directions[:, 1] < -0.6
    if found.mean() < MIN_ENCLOSED_SHARE or found[below].mean() < MIN_FLOOR_SHARE:
        return None
    distances = hits.distance[found]
    if distances.min() < CLEARANCE or np.median(distances) < NEAR_MEDIAN:
        return None
    behind = np.einsum("ij,ij->i", caster.normals[hits.face[found]], directions[found]) > 0
    if BETWEEN_SHELLS[0] < behind.mean() < BETWEEN_SHELLS[1]:
        return None
    return float(np.median(distances))


def find_places(caster: MeshCaster, rng: np.random.Generator, count: int, attempts: int = 400) -> list[Place]:
    """Places by chance; fewer than ``count`` where ``attempts`` do not find more."""
    low, high = (np.percentile(caster.mesh.vertices, share, axis=0) for share in (1, 99))
    starts = rng.uniform(low, np.maximum(high, low + 1e-3), (attempts, 3))
    starts[:, 1] += 0.3
    down = np.broadcast_to([0.0, -1.0, 0.0], starts.shape)
    floor = caster.hits(starts, down)
    level = floor.is_hit & (np.abs(caster.normals[floor.face][:, 1]) > LEVEL)
    eyes = starts[level]
    eyes[:, 1] += rng.uniform(*EYE_HEIGHTS, level.sum()) - floor.distance[level]
    found = ((eye, median) for eye in eyes if (median := look_around(caster, eye)) is not None)
    return list(islice(found, count))


def find_line(
    caster: MeshCaster, places: list[Place], rng: np.random.Generator, frames: int
) -> list[Float[np.ndarray, " 3"]] | None:
    """A straight walk from a place: ends and some between, evenly by log length over median distance; or None."""
    for _ in range(ATTEMPTS if places else 0):
        begin, median = places[rng.integers(len(places))]
        length = min(median * float(np.exp(rng.uniform(*np.log(BASELINES)))), LONGEST_WALK)
        heading, rise = rng.uniform(0.0, 2.0 * math.pi), rng.normal(0.0, 0.05)
        step = np.array([math.cos(heading), rise, math.sin(heading)])
        step /= np.linalg.norm(step)
        if caster.distances(begin[None], step[None])[0] < length + CLEARANCE:
            continue
        shares = np.array([0.0, *np.sort(rng.uniform(0.2, 0.8, max(0, frames - 2))), 1.0])[:frames]
        line = [begin + share * length * step for share in shares]
        if all(look_around(caster, position) is not None for position in line[1:]):
            return line
    return None


def find_walk(caster: MeshCaster, rng: np.random.Generator, frames: int) -> list[Pose] | None:
    """Upright cameras with one heading along a line that :func:`find_line` finds; None if there is none."""
    line = find_line(caster, find_places(caster, rng, PLACES), rng, frames)
    rotation = rotation_from_heading(rng.uniform(-math.pi, math.pi))
    return None if line is None else [Pose(rotation, position) for position in line]
