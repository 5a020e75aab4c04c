"""A pool of walks: upright panoramas along a line with exact depth, of procedural scenes and of meshes.

A walk is a file ``NNNNNNNN.npz``:

* ``images`` ``(views, height, width, 3)`` uint8, upright, all with the same heading,
* ``inverse_depth`` ``(views, height, width)`` float16, 1/metre, 0 = nothing there,
* ``positions`` ``(views, 3)`` float32, metres, y up,
* ``is_mesh``: whether it is of a mesh,
* ``pairs`` ``(pairs, 2)`` int8: views that were matched, both ways round,
* ``matching`` ``(pairs, 4, height / 4, width / 4)`` float16: what matching says of the first of two, turned so that the
  other camera is ahead, see :mod:`omnisyn_cli.training.pair_matching`.

Any two views are a pair. Equal seeds, textures and meshes make equal files.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float16, Float32, Int8, UInt8

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.grouping import median_depth
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.textured_mesh import TexturedMesh
from omnisyn_cli.io import read_photographs
from omnisyn_cli.io.meshes import list_meshes, read_mesh
from omnisyn_cli.scenes import GENERATORS, Photos, generate_scene, pack_photos, render_panorama, sample_path
from omnisyn_cli.scenes.mesh import (
    MeshCaster,
    MeshScene,
    draw_lighting,
    find_walk,
    render_mesh,
    varied_mesh,
)
from omnisyn_cli.training.data import is_made_by, save_arrays
from omnisyn_cli.training.pair_matching import match_views, views_to_match
from omnisyn_cli.types import DepthEstimate, View

MESH = "mesh"
"""Kind of scene that is a mesh; the others are those of :data:`omnisyn_cli.scenes.GENERATORS`."""

ATTEMPTS = 12
"""Seeds that are tried for a walk before the kind is given up."""

STOPS = 9
"""Positions along a procedural path that views are chosen from; the ends are always taken."""

LIGHT_RAYS = 16
"""Directions that every point of a mesh asks for light."""

MIN_MEAN_BRIGHTNESS = 0.06
"""Mean of a picture below which a walk is dropped."""

VERTICAL_PATH_SHARE = 0.05
"""Share of procedural paths that go straight up."""


@dataclass(frozen=True)
class Walk:
    """Views of one scene, see the module's docstring."""

    images: UInt8[np.ndarray, "views height width 3"]
    inverse_depth: Float[np.ndarray, "views height width"]
    positions: Float32[np.ndarray, "views 3"]
    is_mesh: bool
    pairs: Int8[np.ndarray, "pairs 2"] = field(default_factory=lambda: np.zeros((0, 2), np.int8))
    matching: Float16[np.ndarray, "pairs 4 rows cols"] = field(
        default_factory=lambda: np.zeros((0, 4, 1, 2), np.float16)
    )


@dataclass(frozen=True)
class MeshSource:
    """Meshes to walk through.

    Attributes:
        folder: of mesh files, see :func:`omnisyn_cli.io.meshes.list_meshes`.
        scales: metres per unit of a file, by the name of the file or of its folder; 1 for all others.
        held_out: names of files, or of their folders, that are only for validation.
    """

    folder: str
    scales: Mapping[str, float]
    held_out: tuple[str, ...] = ()

    def paths(self, *, is_held_out: bool) -> list[Path]:
        """The files to learn from, or those that are held out.

        Raises:
            InputError: there are none, or a name that is held out or scaled is of none.
        """
        found = list_meshes(Path(self.folder))
        for name in (*self.held_out, *self.scales):
            if not any(name in _names(path) for path in found):
                raise InputError(f"expected a mesh or its folder named {name!r} in {self.folder}, found none")
        chosen = [path for path in found if any(name in self.held_out for name in _names(path)) == is_held_out]
        if not chosen:
            what = "held out" if is_held_out else "left to learn from"
            raise InputError(f"expected at least one mesh of {self.folder} that is {what}, got none")
        return chosen

    def scale(self, path: Path) -> float:
        """Metres per unit of a file."""
        return next((self.scales[name] for name in _names(path) if name in self.scales), 1.0)


def _names(path: Path) -> tuple[str, str]:
    """By which a mesh may be called."""
    return path.stem, path.parent.name


@dataclass(frozen=True)
class WalkConfig:
    """What walks are made of.

    Attributes:
        size: ``(height, width)`` of what is stored.
        views: per walk; n views make n·(n−1) pairs.
        kinds: of scenes, in turn by seed: :data:`MESH` or those of :data:`omnisyn_cli.scenes.GENERATORS`.
        supersample: colour samples per pixel along each axis.
        textures: folder of photographs of materials, or None.
        meshes: or None, where no kind is :data:`MESH`.
        is_held_out: whether meshes are those held out, which are then left as they are.
    """

    size: tuple[int, int] = (256, 512)
    views: int = 4
    kinds: tuple[str, ...] = (MESH, "home", MESH, "street", MESH, "room")
    supersample: int = 2
    textures: str | None = None
    meshes: MeshSource | None = None
    is_held_out: bool = False

    def check(self) -> None:
        """InputError unless all kinds can be made."""
        known = {*GENERATORS, MESH}
        unknown = [kind for kind in self.kinds if kind not in known]
        if unknown or not self.kinds:
            raise InputError(f"expected kinds of {', '.join(sorted(known))}, got {', '.join(unknown) or 'none'}")
        if MESH in self.kinds:
            if self.meshes is None:
                raise InputError("expected a folder of meshes, as the recipe has some; give one (--meshes)")
            self.meshes.paths(is_held_out=self.is_held_out)


def save_walk(path: Path, walk: Walk) -> None:
    """Write one file of a pool, whole or not at all.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    arrays = {
        "images": walk.images,
        "inverse_depth": walk.inverse_depth.astype(np.float16),
        "positions": walk.positions.astype(np.float32),
        "is_mesh": np.array(walk.is_mesh),
        "pairs": walk.pairs,
        "matching": walk.matching,
    }
    save_arrays(path, arrays)


def load_walk(path: Path) -> Walk:
    """Read one file of a pool."""
    with np.load(path) as file:
        inverse_depth, is_mesh = file["inverse_depth"].astype(np.float32), bool(file["is_mesh"])
        return Walk(file["images"], inverse_depth, file["positions"], is_mesh, file["pairs"], file["matching"])


def list_walks(folder: Path) -> list[Path]:
    """The files of a folder of walks, in order; none where it holds something else."""
    paths = sorted(folder.glob("*.npz"))
    return paths if paths and is_made_by("recipe", paths[0]) else []


def walk_views(walk: Walk) -> list[View]:
    """The panoramas of a walk with their true depth, the first at the origin."""
    valid = np.ones(walk.inverse_depth.shape[1:], np.float32)
    return [
        View(
            image.astype(np.float32) / np.float32(255.0),
            Pose(np.eye(3), (position - walk.positions[0]).astype(np.float64)),
            known_depth=DepthEstimate(inverse_depth.astype(np.float32), valid),
        )
        for image, position, inverse_depth in zip(walk.images, walk.positions, walk.inverse_depth, strict=True)
    ]


def make_walk(seed: int, config: WalkConfig) -> Walk:
    """The walk of a seed.

    Raises:
        InputError: there is no room for one, whatever is tried.
    """
    kind = config.kinds[seed % len(config.kinds)]
    make = _mesh_walk if kind == MESH else _procedural_walk
    for attempt in range(ATTEMPTS):
        walk = make(kind, seed, attempt, config)
        if walk is not None:
            return matched_walk(walk, np.random.default_rng([23, seed]), is_exact=config.is_held_out)
    raise InputError(f"expected room for a walk in {kind} scenes near seed {seed}, found none in {ATTEMPTS} attempts")


def matched_walk(walk: Walk, rng: np.random.Generator, *, is_exact: bool) -> Walk:
    """A walk with what matching says of some of its pairs.

    Args:
        walk: without.
        rng: which pairs, and what is not quite right in them.
        is_exact: whether colours and poses are as they are.
    """
    pairs, found = list[tuple[int, int]](), []
    for first, second in views_to_match(baseline_ratios(walk.inverse_depth, walk.positions), rng):
        motion = walk.positions[second].astype(np.float64) - walk.positions[first]
        found += list(match_views(walk.images[[first, second]], motion, None if is_exact else rng))
        pairs += [(first, second), (second, first)]
    if not pairs:
        return walk
    return replace(walk, pairs=np.array(pairs, np.int8), matching=np.stack(found).astype(np.float16))


def baseline_ratios(
    inverse_depth: Float[np.ndarray, "views height width"], positions: Float32[np.ndarray, "views 3"]
) -> Float[np.ndarray, "views views"]:
    """Distance of any two views over the median depth of the first one."""
    depths = np.array([median_depth(each) for each in inverse_depth])
    distances = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    return np.asarray(distances / depths[:, None])


def _procedural_walk(kind: str, seed: int, attempt: int, config: WalkConfig) -> Walk | None:
    number = seed + attempt * 10_000_019
    rng = np.random.default_rng([21, number])
    scene = generate_scene(kind, number, _packed_photos(config.textures))
    try:
        path = sample_path(scene, number, STOPS, vertical=VERTICAL_PATH_SHARE)
    except ValueError:
        return None
    between = np.sort(rng.choice(np.arange(1, STOPS - 1), config.views - 2, replace=False))
    positions = [path[0].position, *(path[k].position for k in between), path[-1].position]
    rotation = rotation_from_heading(rng.uniform(-np.pi, np.pi))
    views = [
        render_panorama(scene, Pose(rotation, position), config.size, supersample=config.supersample, threads=1)
        for position in positions
    ]
    return _walk(views, positions, rotation, is_mesh=False)


def _mesh_walk(kind: str, seed: int, attempt: int, config: WalkConfig) -> Walk | None:
    """Of one of the meshes in turn; None where there is no room, or no light."""
    if config.meshes is None:
        raise InputError(f"expected a folder of meshes for scenes of kind {kind}, got none; give one (--meshes)")
    rng = np.random.default_rng([22, seed, attempt])
    paths = config.meshes.paths(is_held_out=config.is_held_out)
    turn, position = divmod(seed, len(config.kinds))
    number = turn * config.kinds.count(MESH) + config.kinds[:position].count(MESH)
    path = paths[(number + attempt) % len(paths)]
    mesh = _mesh(path, config.meshes.scale(path))
    if not config.is_held_out:
        mesh = varied_mesh(mesh, rng, _photographs(config.textures))
    caster = MeshCaster(mesh)
    poses = find_walk(caster, rng, config.views)
    if poses is None:
        return None
    scene = MeshScene.of(mesh, draw_lighting(caster, rng, poses[0].position, LIGHT_RAYS), caster)
    walk = mesh_walk(scene.exposed_at(poses[0]), poses, config.size, config.supersample)
    is_dark = min(float(image.mean()) for image in walk.images) < 255.0 * MIN_MEAN_BRIGHTNESS
    return None if is_dark else walk


def mesh_walk(scene: MeshScene, poses: Sequence[Pose], size: tuple[int, int], supersample: int) -> Walk:
    """A mesh seen from poses that share a rotation."""
    views = [render_mesh(scene, pose, size, supersample=supersample) for pose in poses]
    return _walk(views, [pose.position for pose in poses], poses[0].rotation, is_mesh=True)


def _walk(
    views: Sequence[tuple[np.ndarray, np.ndarray]],
    positions: Sequence[np.ndarray],
    rotation: np.ndarray,
    *,
    is_mesh: bool,
) -> Walk:
    """Of renderings; positions are turned into the frame of the cameras, so that all have heading 0."""
    images = [(np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8) for image, _ in views]
    inverse_depth = [1.0 / np.maximum(depth, 1e-3) for _, depth in views]
    placed = (np.stack(positions) - positions[0]) @ rotation
    return Walk(np.stack(images), np.stack(inverse_depth).astype(np.float32), placed.astype(np.float32), is_mesh)


@lru_cache(maxsize=2)
def _mesh(path: Path, scale: float) -> TexturedMesh:
    return read_mesh(path, scale)


@lru_cache(maxsize=1)
def _photographs(folder: str | None) -> list[np.ndarray]:
    return [] if folder is None else read_photographs(Path(folder))


@lru_cache(maxsize=1)
def _packed_photos(folder: str | None) -> Photos | None:
    return None if folder is None else pack_photos(_photographs(folder))
