"""Making walks: upright panoramas along a line with exact depth, of procedural scenes and of meshes.

Equal seeds, textures and meshes make equal files, see :class:`omnisyn_cli.training.data.Walk`. Views of a pair
are turned to face each other, and some poses are made a bit wrong.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.io.meshes import list_meshes, read_mesh
from omnisyn_cli.scenes import GENERATORS, render_panorama
from omnisyn_cli.scenes.mesh.raycast import MeshCaster, find_walk
from omnisyn_cli.scenes.mesh.render import MeshScene, lit_scene, render_mesh
from omnisyn_cli.scenes.mesh.texturing import varied_mesh
from omnisyn_cli.training.data import Walk, save_samples
from omnisyn_cli.training.scene_makers import PATH_STOPS, SceneConfig, photographs, scene_path, walk_of

MESH = "mesh"  # Kind of scene that is a mesh; the others are those of :data:`omnisyn_cli.scenes.GENERATORS`
ATTEMPTS = 12  # Seeds that are tried for a walk before the kind is given up
LIGHT_RAYS = 16  # Directions that every point of a mesh asks for light
MIN_MEAN_BRIGHTNESS = 0.06  # Mean of a picture below which a walk is dropped

_read_mesh = lru_cache(maxsize=2)(read_mesh)


@dataclass(frozen=True)
class MeshSource:
    """Meshes to walk through."""

    folder: str  # of mesh files, see list_meshes
    scales: Mapping[str, float]  # metres per unit of a file, by the name of the file or of its folder; 1 for all others
    held_out: tuple[str, ...] = ()  # names of files, or of their folders, that are only for validation

    def paths(self, *, is_held_out: bool) -> list[Path]:
        """The files to learn from, or those held out; InputError: none, or a held-out or scaled name is of none."""
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
class WalkConfig(SceneConfig):
    """What walks are made of."""

    kinds: tuple[str, ...] = (MESH, "home", MESH, "street", MESH, "room")  # MESH, or of GENERATORS
    pose_error_share: float = 0.0
    pose_error_radians: float = 0.0015
    views: int = 4  # per walk; n views make n·(n−1) pairs
    supersample: int = 2  # colour samples per pixel along each axis
    meshes: MeshSource | None = None  # or None, where no kind is MESH
    is_held_out: bool = False  # whether meshes are those held out, which are then left as they are

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


def make_walk(seed: int, config: WalkConfig) -> Walk:
    """The walk of a seed; InputError: there is no room for one, whatever is tried."""
    kind = config.kinds[seed % len(config.kinds)]
    make = _mesh_walk if kind == MESH else _procedural_walk
    for attempt in range(ATTEMPTS):
        walk = make(kind, seed, attempt, config)
        if walk is not None:
            return walk
    raise InputError(f"expected room for a walk in {kind} scenes near seed {seed}, found none in {ATTEMPTS} attempts")


def make_walk_file(folder: Path, seed: int, config: WalkConfig) -> Path | None:
    """Render the procedural walk of a seed into a pool; None if the scene has no room for one."""
    walk = _procedural_walk(config.kinds[seed % len(config.kinds)], seed, 0, config)
    if walk is None:
        return None
    file = scene_path(folder, seed)
    save_samples(file, [walk])
    return file


def _procedural_walk(kind: str, seed: int, attempt: int, config: WalkConfig) -> Walk | None:
    number = seed + attempt * 10_000_019
    rng = np.random.default_rng([21, number])
    found = config.scene(number, PATH_STOPS, kind)
    if found is None:
        return None
    scene, path = found
    between = np.sort(rng.choice(np.arange(1, PATH_STOPS - 1), config.views - 2, replace=False))
    rotation, error = rotation_from_heading(rng.uniform(-np.pi, np.pi)), config.pose_error(rng)
    poses = [
        Pose(rotation_from_rotation_vector(error * rng.standard_normal(3)) @ rotation, path[k].position)
        for k in (0, *between, PATH_STOPS - 1)
    ]
    views = [render_panorama(scene, pose, config.size, supersample=config.supersample, threads=1) for pose in poses]
    return _walk(views, poses, rotation, is_mesh=False)


def _mesh_walk(kind: str, seed: int, attempt: int, config: WalkConfig) -> Walk | None:
    """Of one of the meshes in turn; None where there is no room, or no light."""
    if config.meshes is None:
        raise InputError(f"expected a folder of meshes for scenes of kind {kind}, got none; give one (--meshes)")
    rng = np.random.default_rng([22, seed, attempt])
    paths = config.meshes.paths(is_held_out=config.is_held_out)
    turn, position = divmod(seed, len(config.kinds))
    number = turn * config.kinds.count(MESH) + config.kinds[:position].count(MESH)
    path = paths[(number + attempt) % len(paths)]
    mesh = _read_mesh(path, config.meshes.scale(path))
    if not config.is_held_out:
        mesh = varied_mesh(mesh, rng, photographs(config.textures))
    caster = MeshCaster(mesh)
    poses = find_walk(caster, rng, config.views)
    if poses is None:
        return None
    walk = mesh_walk(lit_scene(caster, rng, poses[0], LIGHT_RAYS), poses, config.size, config.supersample)
    is_dark = min(float(image.mean()) for image in walk.images) < 255.0 * MIN_MEAN_BRIGHTNESS
    return None if is_dark else walk


def mesh_walk(scene: MeshScene, poses: Sequence[Pose], size: tuple[int, int], supersample: int) -> Walk:
    """A mesh seen from poses that share a rotation."""
    views = [render_mesh(scene, pose, size, supersample=supersample) for pose in poses]
    return _walk(views, poses, poses[0].rotation, is_mesh=True)


def _walk(
    views: Sequence[tuple[np.ndarray, np.ndarray]], poses: Sequence[Pose], rotation: np.ndarray, *, is_mesh: bool
) -> Walk:
    """Of renderings; positions are turned into the frame of the cameras, so that all have heading 0."""
    images, depths = zip(*views, strict=True)
    placed = [(pose.position - poses[0].position) @ rotation for pose in poses]
    return walk_of(images, [1.0 / np.maximum(depth, 1e-3) for depth in depths], placed, is_mesh=is_mesh)


# Share of the pairs with pose errors, and the standard deviations of the rotation and of the direction, radians.
POSE_ERROR_SHARE, TURN_ERROR, DIRECTION_ERROR = 0.4, 0.003, 0.008


def draw_pose_error(rng: np.random.Generator) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """A second camera's error: a rotation, and what its direction is off by; mostly the identity and zeros."""
    if rng.random() >= POSE_ERROR_SHARE:
        return np.eye(3), np.zeros(3)
    return rotation_from_rotation_vector(rng.normal(0.0, TURN_ERROR, 3)), rng.normal(0.0, DIRECTION_ERROR, 3)


def facing_the_other(
    images: Shaped[np.ndarray, "views height width *rest"], towards: Float[np.ndarray, " 3"]
) -> tuple[np.ndarray, Float[np.ndarray, " 3"]]:
    """Rolled by whole columns so that the other camera is ahead, and the direction to it in that frame."""
    width = images.shape[2]
    columns = round(math.atan2(towards[0], -towards[2]) / (2.0 * math.pi) * width)
    turn = columns / width * 2.0 * math.pi
    cosine, sine = math.cos(turn), math.sin(turn)
    ahead = np.array([cosine * towards[0] + sine * towards[2], towards[1], cosine * towards[2] - sine * towards[0]])
    return np.roll(images, -columns, axis=2), ahead
