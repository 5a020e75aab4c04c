"""Textured meshes from files: glTF, OBJ and PLY through trimesh, and an archive of arrays; clouds of points as PLY.

The archive is described in ``docs/scenes.md``. Source of PLY: Turk, The PLY Polygon File Format, 1994.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.textured_mesh import Material, TexturedMesh
from omnisyn_cli.io.outputs import write_parts

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply")  # formats that trimesh reads with their textures
ARCHIVE = "scene.npz"  # a mesh as arrays in numpy's format
MAX_FACES = 20_000_000  # of a mesh that is read. Set by hand.
MIN_AREA = 1e-10  # square metres; smaller faces are dropped
LARGEST_EXTENT = 5000.0  # metres; larger meshes are in other units
SMALLEST_EXTENT = 0.5  # metres; smaller meshes are in other units
LIGHT_MAP_GAIN = 2.0  # light where the light map is white


def list_meshes(folder: Path) -> list[Path]:
    """All mesh files of a folder and below, in order; InputError: there are none."""
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in MESH_SUFFIXES or path.name == ARCHIVE)
    if not found:
        raise InputError(f"expected meshes ({', '.join(MESH_SUFFIXES)} or {ARCHIVE}) in {folder}, found none")
    return found


def read_mesh(path: Path, scale: float = 1.0, *, z_up: bool = False) -> TexturedMesh:
    """The mesh of a glTF, OBJ, PLY or an archive with ``scale`` metres per unit, y up.

    ``z_up`` says that the file's z is up; archives say so themselves.
    InputError: it cannot be read, has no faces, or is of an extent that no room or street has.
    """
    if not path.is_file():
        raise InputError(f"expected a mesh at {path}, found no file")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is left out
        mesh = _read_archive(path) if path.suffix == ".npz" else _read_scene(path, z_up)
        return _checked(mesh, path, scale)


def _checked(mesh: TexturedMesh, path: Path, scale: float) -> TexturedMesh:
    if mesh.faces.size and not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
        raise InputError(f"expected triangles of the vertices of {path}, found others; export it again")
    vertices = (mesh.vertices * np.float32(scale)).astype(np.float32)
    corners = vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    kept = np.isfinite(corners).all(axis=(1, 2)) & np.isfinite(area) & (area > MIN_AREA)
    if not kept.any():
        raise InputError(f"expected triangles in {path}, found none that have an area; export it again")
    if kept.sum() > MAX_FACES:
        raise InputError(f"expected at most {MAX_FACES:,} triangles in {path}, got {kept.sum():,}; simplify it")
    seen = corners[kept].reshape(-1, 3)
    extent = math.dist(np.percentile(seen, 99, axis=0), np.percentile(seen, 1, axis=0))
    if not SMALLEST_EXTENT <= extent <= LARGEST_EXTENT:
        raise InputError(
            f"expected a room or a street in {path}, got a mesh of {extent:.3g} m; is it in other units? Use --scale"
        )
    faces, materials = mesh.faces[kept], mesh.face_material[kept]
    return replace(mesh, vertices=np.nan_to_num(vertices), faces=faces, face_material=materials)


def _read_archive(path: Path) -> TexturedMesh:
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        described = json.loads(str(arrays["materials"]))
        has_light = bool(arrays["has_lm"]) and "uvl" in arrays
        return TexturedMesh(
            vertices=_y_up(arrays["verts"]),
            faces=arrays["faces"].astype(np.int32),
            uv=arrays["uv"].astype(np.float32),
            face_material=arrays["mat"].astype(np.int32),
            materials=tuple(_archived_material(entry, path) for entry in described),
            light_uv=arrays["uvl"].astype(np.float32) if has_light else None,
            light_map=LIGHT_MAP_GAIN * _picture(path.with_name("lightmap.jpg")) / np.float32(255.0)
            if has_light
            else None,
        )
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, TypeError) as error:
        raise InputError(f"expected a mesh archive in {path}, got '{error!s:.80}'") from error


def _archived_material(entry: dict[str, Any], path: Path) -> Material:
    texture, opacity = entry.get("tex"), entry.get("alpha")
    return Material(
        name=str(entry["name"]),
        colour=np.array(entry["color"], np.float64),
        texture=_picture(_texture_path(path, texture)) if texture else None,
        opacity=_picture(_texture_path(path, opacity))[..., 0] if opacity else None,
        is_emissive=bool(entry.get("emit")),
        is_lightmapped=bool(entry.get("lm")),
    )


def _texture_path(path: Path, name: str) -> Path:
    shared = path.parent.parent.parent / "scene_textures" / Path(name).name
    return shared if shared.exists() else path.with_name(Path(name).name)


def _picture(path: Path) -> Any:
    """``(height, width, 3)`` uint8."""
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise InputError(f"expected a texture at {path}, found none that can be read")
    return np.ascontiguousarray(image[..., ::-1])


def _y_up(vertices: np.ndarray) -> np.ndarray:
    """Of coordinates whose z is up."""
    return np.ascontiguousarray(np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1), np.float32)


def _read_scene(path: Path, z_up: bool) -> TexturedMesh:
    try:
        import trimesh
    except ImportError as error:
        raise InputError(
            'expected the package trimesh to read meshes, found none; pip install "omnisyn-cli[scenes]"'
        ) from error
    try:
        loaded = trimesh.load(path, process=False)
        scene = loaded if isinstance(loaded, trimesh.Scene) else trimesh.Scene(loaded)
        parts = list(_parts(scene))
    except Exception as error:
        raise InputError(f"expected a mesh in {path}, got '{error!s:.120}'; export it again") from error
    if not parts:
        raise InputError(f"expected a mesh with triangles in {path}, found none; export it again")
    return _joined(parts, z_up)


def _parts(scene: Any) -> Any:
    """Of every drawn mesh: vertices in the scene's frame, faces, texture coordinates, material, colours."""
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not len(getattr(mesh, "faces", ())):
            continue
        vertices = np.asarray(mesh.vertices) @ transform[:3, :3].T + transform[:3, 3]
        faces = np.asarray(mesh.faces, np.int64)
        uv = getattr(mesh.visual, "uv", None)
        colours = None
        if mesh.visual.kind == "vertex":
            colours = np.asarray(mesh.visual.vertex_colors)[:, :3] / 255.0
        material = _scene_material(getattr(mesh.visual, "material", None), node, has_uv=uv is not None)
        if material is not None:
            yield vertices, faces, None if uv is None else np.asarray(uv)[:, :2], material, colours


def _scene_material(material: Any, node: str, *, has_uv: bool) -> Material | None:
    """Of trimesh's material; None for clear glass."""
    if material is None:
        return Material(node, np.full(3, 0.7))
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    emissive = getattr(material, "emissiveFactor", None)
    shown = getattr(material, "emissiveTexture", None)
    is_lit = image is None and shown is not None
    image = shown if is_lit else image
    colour, alpha = _colour(material)
    mode = getattr(material, "alphaMode", None)
    if mode == "BLEND" and alpha < 0.5 and image is None:
        return None
    texture = opacity = None
    if image is not None and has_uv:
        rgba = np.asarray(image.convert("RGBA"))
        texture = np.ascontiguousarray(rgba[..., :3])
        is_cut = mode != "OPAQUE" and float((rgba[..., 3] < 128).mean()) > 0.02
        opacity = np.ascontiguousarray(rgba[..., 3]) if is_cut else None
    shines = emissive is not None and float(np.max(emissive)) > 0.9 and image is None
    name = str(getattr(material, "name", None) or node)
    return Material(name, colour, texture, opacity, is_emissive=shines, is_lit=is_lit)


def _colour(material: Any) -> tuple[np.ndarray, float]:
    """SRGB in [0, 1], and how opaque."""
    given = getattr(material, "baseColorFactor", None)
    is_linear = given is not None
    if given is None:
        given = getattr(material, "diffuse", None)
    if given is None:
        return np.full(3, 0.7), 1.0
    values = np.asarray(given)
    values = values / 255.0 if values.dtype.kind in "ui" else values.astype(np.float64)
    colour = np.clip(values[:3], 0.0, 1.0)
    return (colour ** (1 / 2.2) if is_linear else colour), float(values[3]) if len(values) > 3 else 1.0


def _joined(parts: list[Any], z_up: bool) -> TexturedMesh:
    counts = np.cumsum([0, *(len(part[0]) for part in parts)])
    vertices = np.concatenate([part[0] for part in parts])
    colours = None
    if any(part[4] is not None for part in parts):
        colours = np.concatenate(
            [np.broadcast_to(part[3].colour, (len(part[0]), 3)) if part[4] is None else part[4] for part in parts]
        ).astype(np.float32)
    return TexturedMesh(
        vertices=_y_up(vertices) if z_up else vertices.astype(np.float32),
        faces=np.concatenate([part[1] + first for part, first in zip(parts, counts, strict=False)]).astype(np.int32),
        uv=np.nan_to_num(
            np.concatenate([np.zeros((len(part[0]), 2)) if part[2] is None else part[2] for part in parts])
        ).astype(np.float32),
        face_material=np.concatenate([np.full(len(part[1]), k) for k, part in enumerate(parts)]).astype(np.int32),
        materials=tuple(part[3] for part in parts),
        vertex_colours=colours,
    )


TYPES = {"<f4": "float", "|u1": "uchar"}  # PLY's names of numpy's types


def write_ply(path: Path, vertices: np.ndarray, comments: Sequence[str] = ()) -> None:
    """Write records (fields ``<f4`` and ``u1``) as the vertices of a PLY file, as :func:`write_parts` does."""
    names = vertices.dtype.names or ()
    properties = [f"property {TYPES[vertices.dtype[name].str]} {name}" for name in names]
    head = [
        "ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments),
        f"element vertex {len(vertices)}", *properties, "end_header", "",
    ]  # fmt: skip
    write_parts(path, ("\n".join(head).encode("ascii"), vertices.tobytes()))
