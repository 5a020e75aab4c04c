"""Panoramas as points and flat discs (Gaussian splats), and as data sets with poses, depth and points.

Points are the pixels of surfaces, discs lie in these. Data sets are COLMAP models and nerfstudio's ``transforms.json``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from omnisyn_cli.geometry import sphere
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.geometry.remap import MAX_REMAP_COLUMNS, RemapTable
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.interpolation.loading import PanoramaSurface, quantized_picture
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.io.meshes import write_ply
from omnisyn_cli.io.outputs import make_folder, named_in, write_parts
from omnisyn_cli.poses.formats.colmap import colmap_files, colmap_rig_files
from omnisyn_cli.poses.formats.files import CAMERA_AXES
from omnisyn_cli.poses.formats.json_files import nerfstudio_text
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.quad_blocks import BOTTOM, LEFT, TOP

# Standard deviation of a disc, in distances of its neighbours: four of them cover what lies between to 90 %. And its
# thickness, in its radius. Half way through a warehouse radii of 0.5 and 0.55 are best (24.6 dB, 0.6 has 24.1), and 0.5
# lets twice as much through.
DISC_RADIUS_SHARE, DISC_THICKNESS_SHARE = 0.55, 0.01
# Between a surface's normal and the line of sight: what is seen at a smaller angle gets no longer discs.
MIN_COSINE = 0.25

DISC_OPACITY = 0.99
ZEROTH_HARMONIC = 0.28209479177387814
"""The constant spherical harmonic, √(1/4π): colours are stored as what lies above one half, divided by it."""


@dataclass(frozen=True)
class Points:
    """Points of one or more panoramas in one world."""

    position: Float[np.ndarray, "points 3"]  # metres
    colour: UInt8[np.ndarray, "points 3"]  # RGB
    confidence: Float[np.ndarray, " points"]  # of their distances, in [0, 1]
    normal: Float[np.ndarray, "points 3"]  # of length one, towards the panorama
    radius: Float[np.ndarray, "points 2"]  # metres: standard deviations of a disc along its first and second axis
    turn: Float[np.ndarray, "points 4"]  # quaternion w, x, y, z: world from disc, whose third axis is the normal

    def __len__(self) -> int:
        return len(self.position)


def joined(parts: Sequence[Points]) -> Points:
    """All points of several parts."""
    return Points(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Points)))


def points_of(
    mesh: Mesh, confidence: Float[np.ndarray, "height width"], picture: UInt8[np.ndarray, "rows cols 3"], pose: Pose,
    stride: int, farthest: float = np.inf,
) -> Points:  # fmt: skip
    """Points of a panorama, as dense on the sphere everywhere: fewer columns towards the poles.

    The confidence has the mesh's size, the picture any; the pose is that of the panorama in the world of the points.
    Points are ``stride`` pixels of the mesh apart. What is infinitely far, ``farthest`` metres or more away, or without
    a surface, is left out.
    """
    height, width = mesh.size
    row, col = _places(height, width, stride)
    rho = mesh.inverse_depth[row, col]
    kept = (rho > 0) & (rho * farthest > 1)
    row, col, rho = row[kept], col[kept], rho[kept].astype(np.float64)
    direction = sphere.pixel_to_direction(row, col, mesh.size)
    reduced = quantized_picture(picture, 2 * max(height // stride, 1)).astype(np.float32)
    colour = np.asarray(np.rint(sample_bilinear(reduced, direction)), np.uint8)
    normal = _normals(mesh)[row, col]
    turn, cosine = _facing(direction, normal)
    across = DISC_RADIUS_SHARE * stride / sphere.pixel_scale(mesh.size)[0] / rho
    radius = np.stack([across / np.maximum(cosine, MIN_COSINE), across], -1)
    return Points(
        pose.transform(direction / rho[:, None]), colour, confidence[row, col], normal @ pose.rotation.T, radius,
        quaternion_from_rotation(pose.rotation @ turn),
    )  # fmt: skip


def _places(height: int, width: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of vertices that are ``stride`` pixels of the equator apart, everywhere."""
    rows = np.arange(min(stride // 2, height - 1), height, stride)
    count = np.maximum(np.rint(width * sphere.direction_tables(height, width)[0][rows] / stride), 1).astype(np.int64)
    row = np.repeat(rows, count)
    step = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    return row, (2 * step + 1) * width // (2 * np.repeat(count, count))


def _normals(mesh: Mesh) -> Float[np.ndarray, "height width 3"]:
    """Unit normals towards the centre, of neighbours that no cut separates; the line of sight where there are none."""
    rho = mesh.inverse_depth
    directions = sphere.pixel_directions(*mesh.size)
    points = directions / np.where(rho > 0, rho, 1.0)[..., None]
    beside, below = np.zeros(mesh.size, bool), np.zeros(mesh.size, bool)
    beside[:-1] = (mesh.quads & TOP) == 0
    beside[-1] = (mesh.quads[-1] & BOTTOM) == 0
    below[:-1] = (mesh.quads & LEFT) == 0
    present = rho > 0
    lines = []
    for axis, is_joined in ((1, beside), (0, below)):
        ahead = np.where(is_joined & present & np.roll(present, -1, axis), np.abs(np.roll(rho, -1, axis) - rho), np.inf)
        behind = np.roll(ahead, 1, axis)
        step = np.roll(points, -1, axis) - points
        # of two neighbours on one line the one whose distance differs less
        chosen = np.where((ahead <= behind)[..., None], step, np.roll(step, 1, axis))
        lines.append(np.where(np.isfinite(np.minimum(ahead, behind))[..., None], chosen, 0.0))
    normal = np.asarray(sphere.normalize(np.cross(lines[0], lines[1])))
    normal = np.where((normal * directions).sum(-1, keepdims=True) > 0, -normal, normal)
    return np.where((normal == 0).all(-1, keepdims=True), -directions, normal)


def _facing(direction: np.ndarray, normal: np.ndarray) -> tuple[Float[np.ndarray, "points 3 3"], np.ndarray]:
    """Axes of discs, as columns: along the slope, across it, the normal; and the cosine of the angle it is seen at."""
    cosine = -(direction * normal).sum(-1)
    slope = direction + cosine[:, None] * normal
    flat = np.linalg.norm(slope, axis=1) < 1e-6
    least = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    slope = np.where(flat[:, None], least - (least * normal).sum(-1, keepdims=True) * normal, slope)
    along = np.asarray(sphere.normalize(slope))
    return np.stack([along, np.cross(normal, along), normal], -1), cosine


def ply_points(points: Points) -> np.ndarray:
    """Vertices of a PLY file: x, y, z, red, green, blue, confidence, nx, ny, nz."""
    return _structured({
        **_named(("x", "y", "z"), points.position, "<f4"), **_named(("nx", "ny", "nz"), points.normal, "<f4"),
        **_named(("red", "green", "blue"), points.colour, "u1"), "confidence": (points.confidence, "<f4"),
    })  # fmt: skip


def ply_splats(points: Points) -> np.ndarray:
    """Vertices of a PLY file as the authors of 3D Gaussian splatting write it, with colours of degree 0.

    Source: Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field Rendering, 2023; their ``save_ply``.
    """
    thin = DISC_THICKNESS_SHARE * points.radius[:, 1:]
    return _structured({
        **_named(("x", "y", "z"), points.position, "<f4"), **_named(("nx", "ny", "nz"), points.normal, "<f4"),
        **_named(("f_dc_0", "f_dc_1", "f_dc_2"), (points.colour / 255.0 - 0.5) / ZEROTH_HARMONIC, "<f4"),
        "opacity": (np.full(len(points), np.log(DISC_OPACITY / (1.0 - DISC_OPACITY))), "<f4"),
        **_named(("scale_0", "scale_1", "scale_2"), np.log(np.concatenate([points.radius, thin], axis=1)), "<f4"),
        **_named(("rot_0", "rot_1", "rot_2", "rot_3"), points.turn, "<f4"),
    })  # fmt: skip


def _named(names: tuple[str, ...], columns: np.ndarray, kind: str) -> dict[str, tuple[np.ndarray, str]]:
    return {name: (columns[:, k], kind) for k, name in enumerate(names)}


def _structured(columns: dict[str, tuple[np.ndarray, str]]) -> np.ndarray:
    """A record for each point."""
    kinds = [(name, kind) for name, (_, kind) in columns.items()]
    return np.rec.fromarrays([values for values, _ in columns.values()], dtype=kinds)


# Faces of a cube: rig-from-face in OpenCV's camera axes; "front" is the centre of the panorama.
FACES: Mapping[str, Float[np.ndarray, "3 3"]] = {
    "front": np.eye(3),
    "right": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "back": np.diag([-1.0, 1.0, -1.0]),
    "left": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "down": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
# Folders of the two models of COLMAP, and of its files in each.
PANORAMAS, RIG, MODEL = "panoramas", "faces", "sparse/0"

COLMAP_FILES = (
    *(f"{PANORAMAS}/{files}" for files in ("images/*.jpg", "depth/*.exr", "masks/*.jpg.png")),
    *(
        f"{RIG}/{files}".replace("FACE", face)
        for files in ("images/FACE/*.jpg", "stereo/depth_maps/FACE/*.jpg.geometric.bin", "masks/FACE/*.jpg.png")
        for face in FACES
    ),
)
NERFSTUDIO_FILES = ("images/*.jpg", "depths/*.png", "masks/*.png")
"""Files of each panorama, whose name stands in place of the star."""

TRANSFORMS = "transforms.json"
OWN_NAME = r"(\d{4,}_[A-Za-z0-9._-]*)"  # what :func:`safe_name` makes, as a group
MILLIMETRES, MAX_DEPTH_MILLIMETRES = 1000.0, 65535  # in a metre; in samples of 16 bits


def safe_name(index: int, image: Path) -> str:
    """A name without spaces, which COLMAP's text files cannot hold, that sorts as the tour goes."""
    return f"{index:04d}_{re.sub(r'[^A-Za-z0-9._-]', '_', image.stem)}"


def former_files(folder: Path, *, is_colmap: bool) -> set[str]:
    """Files of the panoramas of an earlier data set in a folder: of those that all of its documents name as we do."""
    mentions = [(TRANSFORMS, f'"{files}"') for files in NERFSTUDIO_FILES]
    if is_colmap:
        models = ((PANORAMAS, " *.jpg\n"), (RIG, " front/*.jpg\n"))
        mentions = [(f"{model}/{MODEL}/images.txt", mention) for model, mention in models]
    named = [
        named_in(folder / document, re.compile(re.escape(mention).replace(r"\*", OWN_NAME)))
        for document, mention in mentions
    ]
    every = COLMAP_FILES if is_colmap else NERFSTUDIO_FILES
    return {files.replace("*", name) for name in set.intersection(*named) for files in every}


def face_side(size: tuple[int, int]) -> int:
    """Rows of a face whose centre is as sharp as the panorama: its focal length is what a radian has pixels there."""
    return max(2, 2 * round(sphere.pixel_scale(size)[0]))


def write_colmap_view(folder: Path, stem: str, surface: PanoramaSurface, side: int) -> None:
    """Pictures, depth and masks of a panorama and of its six faces, which have so many rows."""
    whole, rig, name = folder / PANORAMAS, folder / RIG, f"{stem}.jpg"
    picture, inverse_depth, usable = surface.samples(), surface.mesh.inverse_depth, _usable(surface)
    _write_picture(whole / "images" / name, picture)
    make_folder(whole / "depth", "depth")
    write_depth(whole / "depth" / f"{stem}.exr", _depth(inverse_depth, np.inf))
    _write_mask(whole / "masks" / f"{name}.png", usable)
    u, v = sphere.pixel_to_texture(np.arange(side), np.arange(side), (side, side))
    x, y = np.meshgrid(2.0 * u - 1.0, 2.0 * v - 1.0)
    rays = np.stack([x, y, np.ones_like(x)], -1)
    if picture.shape[1] > MAX_REMAP_COLUMNS:
        picture = np.asarray(cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    for face, turn in FACES.items():
        directions = rays @ (CAMERA_AXES["opencv"].T @ turn).T
        shown = RemapTable.for_directions(directions, picture.shape).bicubic(picture)
        _write_picture(rig / "images" / face / name, shown)
        along_axis = _depth(sample_nearest(inverse_depth, directions), 0.0) / np.linalg.norm(rays, axis=-1)
        # COLMAP's dense maps: width, height and channels in words, then float32, row after row
        map_file = rig / "stereo" / "depth_maps" / face / f"{name}.geometric.bin"
        write_file(map_file, "depth", f"{side}&{side}&1&".encode("ascii"), along_axis.astype("<f4").tobytes())
        usable_in_face = sample_nearest(usable.astype(np.float32), directions) > 0
        _write_mask(rig / "masks" / face / f"{name}.png", usable_in_face)


def write_colmap(folder: Path, poses: Mapping[str, Pose], sizes: Mapping[str, tuple[int, int]], side: int,
                 points: Points) -> None:  # fmt: skip
    """Both models; ``points`` are in COLMAP's world, poses in ours, by the names of views."""
    lines = [
        f"{' '.join(f'{number:.6g}' for number in place)} {' '.join(map(str, colour))}"
        for place, colour in zip(points.position.tolist(), points.colour.tolist(), strict=True)
    ]
    files = {f"{name}.jpg": pose for name, pose in poses.items()}
    whole = colmap_files(files, {f"{name}.jpg": size for name, size in sizes.items()}, lines)
    rig = colmap_rig_files(files, FACES, side, lines)
    for model, texts in ((PANORAMAS, whole), (RIG, rig)):
        for name, text in texts.items():
            write_file(folder / model / ("" if name.endswith(".json") else MODEL) / name, "the model", text.encode())


def write_nerfstudio_view(folder: Path, stem: str, surface: PanoramaSurface) -> None:
    """Picture, depth in millimetres along the ray, mask."""
    _write_picture(folder / "images" / f"{stem}.jpg", surface.samples())
    millimetres = np.rint(MILLIMETRES * _depth(surface.mesh.inverse_depth, 0.0))
    known = np.where(millimetres <= MAX_DEPTH_MILLIMETRES, millimetres, 0)
    _write_picture(folder / "depths" / f"{stem}.png", known.astype(np.uint16))
    _write_mask(folder / "masks" / f"{stem}.png", _usable(surface))


def write_nerfstudio(folder: Path, poses: Mapping[str, Pose], sizes: Mapping[str, tuple[int, int]],
                     points: Points) -> None:  # fmt: skip
    """``transforms.json`` and the points, which are in its world (z up)."""
    companions = {name: {"depth_file_path": f"depths/{name}.png", "mask_path": f"masks/{name}.png"} for name in poses}
    images: dict[str, Path | None] = {name: folder / "images" / f"{name}.jpg" for name in poses}
    shared = {"depth_unit_scale_factor": 1.0 / MILLIMETRES, "ply_file_path": "points.ply"}
    text = nerfstudio_text(poses, sizes, images, folder, companions, shared)
    write_file(folder / TRANSFORMS, "the model", text.encode())
    write_ply(folder / "points.ply", ply_points(points), ["metres, z up"])


def _usable(surface: PanoramaSurface) -> Bool[np.ndarray, "height width"]:
    mask = surface.view.mask
    return np.ones(surface.view.image.shape[:2], bool) if mask is None else mask


def _write_picture(path: Path, samples: np.ndarray) -> None:
    make_folder(path.parent, "images")
    write_image(path, samples)


def _write_mask(path: Path, usable: np.ndarray) -> None:
    _write_picture(path, np.where(usable, np.uint8(255), np.uint8(0)))


def _depth(inverse_depth: np.ndarray, beyond: float) -> Float32[np.ndarray, "*shape"]:
    """Metres; ``beyond`` where nothing is, or nothing is known."""
    is_there = inverse_depth > 0
    return np.where(is_there, 1.0 / np.where(is_there, inverse_depth, 1.0), beyond).astype(np.float32)


def write_file(path: Path, what: str, *parts: bytes) -> None:
    """Write a file of an export into a folder that is made for it; ``what`` says what for, where that fails."""
    make_folder(path.parent, what)
    write_parts(path, parts)
