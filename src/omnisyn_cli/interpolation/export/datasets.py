"""Panoramas with poses, depth and points as data sets: COLMAP models and nerfstudio's ``transforms.json``."""

import re
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import MAX_REMAP_COLUMNS, RemapTable
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import pixel_scale, pixel_to_texture
from omnisyn_cli.interpolation.export.points import Points, ply_points
from omnisyn_cli.interpolation.loading import PanoramaSurface
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.io.meshes import write_ply
from omnisyn_cli.io.outputs import make_folder, named_in, write_parts
from omnisyn_cli.poses.formats.colmap import colmap_files, colmap_rig_files
from omnisyn_cli.poses.formats.files import CAMERA_AXES
from omnisyn_cli.poses.formats.json_files import nerfstudio_text

FACES: Mapping[str, Float[np.ndarray, "3 3"]] = {
    "front": np.eye(3),
    "right": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "back": np.diag([-1.0, 1.0, -1.0]),
    "left": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "down": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
"""Faces of a cube: rig-from-face in OpenCV's camera axes; "front" is the centre of the panorama."""

PANORAMAS, RIG, MODEL = "panoramas", "faces", "sparse/0"
"""Folders of the two models of COLMAP, and of its files in each."""

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

OWN_NAME = r"(\d{4,}_[A-Za-z0-9._-]*)"
"""What :func:`safe_name` makes, as a group."""

MILLIMETRES, MAX_DEPTH_MILLIMETRES = 1000.0, 65535
"""In a metre; in samples of 16 bits."""


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
    return max(2, 2 * round(pixel_scale(size)[0]))


def write_colmap_view(folder: Path, stem: str, surface: PanoramaSurface, side: int) -> None:
    """Pictures, depth and masks of a panorama and of its six faces, which have so many rows."""
    whole, rig, name = folder / PANORAMAS, folder / RIG, f"{stem}.jpg"
    picture, inverse_depth, usable = surface.samples(), surface.mesh.inverse_depth, _usable(surface)
    _write_picture(whole / "images" / name, picture)
    make_folder(whole / "depth", "depth")
    write_depth(whole / "depth" / f"{stem}.exr", _depth(inverse_depth, np.inf))
    _write_mask(whole / "masks" / f"{name}.png", usable)
    u, v = pixel_to_texture(np.arange(side), np.arange(side), (side, side))
    x, y = np.meshgrid(2.0 * u - 1.0, 2.0 * v - 1.0)
    rays = np.stack([x, y, np.ones_like(x)], -1)
    for face, turn in FACES.items():
        directions = rays @ (CAMERA_AXES["opencv"].T @ turn).T
        _write_picture(rig / "images" / face / name, _seen_along(picture, directions))
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


def _seen_along(picture: UInt8[np.ndarray, "height width 3"], directions: np.ndarray) -> np.ndarray:
    """The panorama in some directions, bicubic."""
    if picture.shape[1] > MAX_REMAP_COLUMNS:
        picture = np.asarray(cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    return RemapTable.for_directions(directions, picture.shape).bicubic(picture)


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
