"""A panorama's surface as triangles with texture coordinates, few where it is flat, without cracks; and as a GLB.

The renderer looks pictures up by the direction of every pixel; a viewer interpolates texture coordinates linearly over
a triangle. So a flat rectangle is split further where a linear interpolation would shift the picture, and where a
smaller neighbour has a corner on its edge it becomes a fan that has this corner as well.

The model is a binary glTF 2.0 file: a node for each panorama, with an unlit, textured mesh, and its sky as a node below
it. glTF's frame is ours: right-handed, y up, metres; panoramas look along their node's −z. Source: Khronos, glTF 2.0
specification, section 4 (GLB) and ``KHR_materials_unlit``.
"""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Integer, Shaped, UInt8

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_to_angles, pixel_to_direction, pixel_to_texture
from omnisyn_cli.io.encode import jpeg_bytes
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.simplify import flat_rectangles

# Share of its distance by which a point of the surface may be moved along its ray: with true depth that leaves one
# triangle in six and costs 0.03 dB half way; with estimated depth one in four. Texture pixels by which the picture may
# be shifted on the surface: twice as many cost 0.4 dB on a warehouse.
MAX_FLATNESS, SHIFT = 0.01, 0.25
POLE_PIECES = 2  # points at the pole of a piece of a cap, which are the first two of its four


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles in the frame of the panorama."""

    position: Float[np.ndarray, "vertices 3"]  # metres
    # (u, v) from the upper left corner of the panorama; u leaves [0, 1] by up to a pixel of the mesh beside the seam,
    # where the texture repeats
    texture: Float[np.ndarray, "vertices 2"]
    triangles: Integer[np.ndarray, "triangles 3"]  # counter-clockwise as seen from the centre

    def split(self, distance: float) -> tuple["TexturedMesh", "TexturedMesh"]:
        """What is nearer than a distance, at least in part, and the rest."""
        is_far = np.linalg.norm(self.position, axis=1) >= distance
        beyond = is_far[self.triangles].all(axis=1)
        return self._of(self.triangles[~beyond]), self._of(self.triangles[beyond])

    def _of(self, triangles: np.ndarray) -> "TexturedMesh":
        """Some of the triangles, with their vertices only."""
        kept, renamed = np.unique(triangles, return_inverse=True)
        return TexturedMesh(self.position[kept], self.texture[kept], renamed.reshape(triangles.shape))


def textured_mesh(mesh: Mesh, texture_height: int, threads: int | None = None) -> TexturedMesh:
    """The triangles of a mesh without infinitely far vertices, for a texture of ``texture_height`` rows."""
    shift = SHIFT * mesh.size[0] / texture_height  # in pixels of the mesh
    angle = shift * float(pixel_to_angles(1.0, 0.0, mesh.size)[1] - pixel_to_angles(0.0, 0.0, mesh.size)[1])
    rectangles, pieces = flat_rectangles(mesh, MAX_FLATNESS, angle, threads)
    parts = [_stitched(mesh, _split(mesh, rectangles, shift)), _in_pieces(mesh, pieces)]
    begin = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    points, pixels = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    texture = np.stack(pixel_to_texture(pixels[:, 0], pixels[:, 1], mesh.size), -1)
    triangles = np.concatenate([part[2] + first for part, first in zip(parts, begin, strict=False)])
    return TexturedMesh(points[:, :3] / points[:, 3:], texture, triangles)


Part = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Points (direction, inverse depth), their rows and columns in pixels of the mesh, triangles."""


def _vertices(mesh: Mesh, row: np.ndarray, col: np.ndarray) -> Float[np.ndarray, "*batch 4"]:
    """Directions and inverse depths of vertices; the column after the last is the first."""
    direction = pixel_to_direction(row, col, mesh.size)
    rho = mesh.inverse_depth[row, col % mesh.size[1]]
    return np.concatenate([direction, rho[..., None]], axis=-1, dtype=np.float64)


def _corners(rectangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of top left, top right, bottom left and bottom right, ``(rectangles, 4)``."""
    row, col, height, width = rectangles.T
    return np.stack([row, row, row + height, row + height], -1), np.stack([col, col + width, col, col + width], -1)


def _split(mesh: Mesh, rectangles: np.ndarray, shift: float) -> Integer[np.ndarray, "rectangles 4"]:
    """Rectangles halved until the middle of no edge or diagonal would show what lies ``shift`` pixels aside."""
    done = []
    while len(rectangles):
        row, col = _corners(rectangles)
        points = _vertices(mesh, row, col)
        wide, tall = rectangles[:, 3] > 1, rectangles[:, 2] > 1
        across, down, aslant = (
            np.maximum(*(_shift_between(mesh, points, row, col, *edge) for edge in edges))
            for edges in (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2)))
        )
        is_longer = rectangles[:, 3] >= rectangles[:, 2]
        in_width = wide & ((across > shift) | ((aslant > shift) & is_longer))
        in_height = tall & ~in_width & ((down > shift) | (aslant > shift))
        done.append(rectangles[~in_width & ~in_height])
        rectangles = np.concatenate([_halves(rectangles[in_width], 1), _halves(rectangles[in_height], 0)])
    return np.concatenate(done) if done else rectangles


def _shift_between(
    mesh: Mesh, points: np.ndarray, row: np.ndarray, col: np.ndarray, first: int, last: int
) -> Float[np.ndarray, " rectangles"]:
    """Pixels between what lies half way between two corners in space, and half way in the picture."""
    middle = points[:, first, :3] / points[:, first, 3:] + points[:, last, :3] / points[:, last, 3:]
    seen_row, seen_col = direction_to_pixel(middle, mesh.size)
    mean_row, mean_col = 0.5 * (row[:, first] + row[:, last]), 0.5 * (col[:, first] + col[:, last])
    aside = _near(seen_col, mean_col, mesh.size[1]) - mean_col
    sine = np.hypot(middle[:, 0], middle[:, 2]) / np.linalg.norm(middle, axis=1)
    return np.asarray(np.hypot(seen_row - mean_row, aside * sine))


def _halves(rectangles: np.ndarray, axis: int) -> np.ndarray:
    """Both halves of each, beside each other (axis 1) or one below the other (0)."""
    first, second = rectangles.copy(), rectangles.copy()
    first[:, 2 + axis] //= 2
    second[:, 2 + axis] -= first[:, 2 + axis]
    second[:, axis] += first[:, 2 + axis]
    return np.concatenate([first, second])


def _near(col: np.ndarray, reference: np.ndarray, width: int) -> np.ndarray:
    """Columns as close to others as they can be: across the seam they go on below 0 or from the width on."""
    half = width / 2
    return np.asarray(reference + (col - reference + half) % width - half)


def _stitched(mesh: Mesh, rectangles: np.ndarray) -> Part:
    """Two triangles for a rectangle, or a fan around its middle if other vertices than its corners lie on its edges."""
    (height, width), (row, col) = mesh.size, _corners(rectangles)
    used = np.zeros((height, width + 1), bool)
    used[row, col] = True
    cut_row, cut_col = np.divmod(mesh.cut_quads, width)
    used[cut_row[:, None] + [0, 0, 1, 1], cut_col[:, None] + [0, 1, 0, 1]] = True
    used[[0, -1]] = True  # the caps have all of them
    used[:, [0, width]] |= used[:, [width, 0]]
    owner, rim_row, rim_col = _rims(rectangles)
    kept = used[rim_row, rim_col]
    owner, rim_row, rim_col = owner[kept], rim_row[kept], rim_col[kept]
    is_fan = np.bincount(owner, minlength=len(rectangles)) > 4
    number = np.cumsum(used.ravel()).reshape(used.shape) - 1
    vertex_row, vertex_col = np.nonzero(used)
    vertices = _vertices(mesh, vertex_row, vertex_col)
    middles = _vertices(mesh, row[is_fan], col[is_fan]).mean(axis=1)
    middle_row, middle_col = direction_to_pixel(middles[:, :3], mesh.size)
    middle_pixels = np.stack([middle_row, _near(middle_col, col[is_fan].mean(axis=1), width)], -1)
    middle_of = len(vertices) + np.cumsum(is_fan) - 1
    rim, in_fan = number[rim_row, rim_col], is_fan[owner]
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    following = np.append(rim[1:], 0)
    following[np.append(first[1:], len(rim)) - 1] = rim[first]
    fans = np.stack([middle_of[owner], rim, following], -1)[in_fan]
    plain = _two_triangles(mesh, row[~is_fan], col[~is_fan], number)
    pixels = np.concatenate([np.stack([vertex_row, vertex_col], -1), middle_pixels])
    return np.concatenate([vertices, middles]), pixels, np.concatenate([plain, fans])


def _rims(rectangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All vertices on the edges of rectangles, counter-clockwise seen from the centre: whose, rows, columns."""
    row, col, height, width = rectangles.T
    length = 2 * (height + width)
    owner = np.repeat(np.arange(len(rectangles)), length)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(length) - length, length)
    tall, wide = height[owner], width[owner]
    down = np.minimum(step, tall) - np.clip(step - tall - wide, 0, tall)
    right = np.clip(step - tall, 0, wide) - np.clip(step - 2 * tall - wide, 0, wide)
    return owner, row[owner] + down, col[owner] + right


def _two_triangles(mesh: Mesh, row: np.ndarray, col: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Of rectangles without a vertex between their corners, split where the surface bends less."""
    corner, rho = number[row, col], mesh.inverse_depth[row, col % mesh.size[1]]
    rising = np.abs(rho[:, 2] - rho[:, 1]) < np.abs(rho[:, 0] - rho[:, 3])
    first = np.where(rising[:, None], corner[:, [0, 2, 1]], corner[:, [0, 2, 3]])
    second = np.where(rising[:, None], corner[:, [2, 3, 1]], corner[:, [0, 3, 1]])
    return np.concatenate([first, second])


def _in_pieces(mesh: Mesh, pieces: Float[np.ndarray, "pieces 4 4"]) -> Part:
    """Quarters of cut quads and the caps of both poles, each with points of its own."""
    row, col = direction_to_pixel(pieces[..., :3], mesh.size)
    is_cap = (pieces[:, 0] == pieces[:, 1]).all(axis=1)
    col = _near(col, col[:, 3:], mesh.size[1])
    col[is_cap, :POLE_PIECES] = col[is_cap, POLE_PIECES:].mean(axis=1, keepdims=True)
    corner = 4 * np.arange(len(pieces))[:, None] + np.arange(4)
    triangles = np.concatenate([corner[:, [0, 2, 3]], corner[~is_cap][:, [0, 3, 1]]])
    return pieces.reshape(-1, 4).astype(np.float64), np.stack([row, col], -1).reshape(-1, 2), triangles


MAX_GLB_BYTES = 2**32 - 1  # lengths in a GLB are numbers of 32 bits
TRIANGLES, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 4, 34962, 34963
LINEAR_FILTER, MIPMAP_FILTER, CLAMP_TO_EDGE, REPEAT = 9729, 9987, 33071, 10497
COMPONENTS = {"float32": 5126, "uint32": 5125, "uint16": 5123}
ELEMENTS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
"""Numbers and words of glTF 2.0, which takes them from OpenGL; components by numpy's type, elements by their length."""


class GltfModel:
    """A model that panoramas are added to, and that is written when all are there."""

    def __init__(self, generator: str) -> None:
        self._chunks: list[bytes] = []
        self._length = 0
        self._json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": generator},
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [], "materials": [], "textures": [],
            "images": [], "accessors": [], "bufferViews": [],
            "samplers": [{
                "magFilter": LINEAR_FILTER, "minFilter": MIPMAP_FILTER, "wrapS": REPEAT, "wrapT": CLAMP_TO_EDGE,
            }],
        }  # fmt: skip

    def add(self, name: str, pose: Pose, meshes: dict[str, TexturedMesh], picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """Add a panorama: a node at its pose (world-from-camera), with a picture as texture.

        Meshes are in the frame of the panorama, by what comes after the name for a node below it; the one of an empty
        name is the node's own. Those without triangles are left out. InputError: the model has become larger than the
        format can say.
        """
        material = self._append("materials", self._material(name, picture))
        node = self._append("nodes", {
            "name": name, "translation": pose.position.tolist(),
            "rotation": np.roll(quaternion_from_rotation(pose.rotation), -1).tolist(),  # x, y, z, w
        })  # fmt: skip
        self._json["scenes"][0]["nodes"].append(node)
        for what, mesh in meshes.items():
            if not len(mesh.triangles):
                continue
            whose = f"{name} {what}".strip()
            number = self._append("meshes", {"name": whose, "primitives": [self._primitive(mesh, material)]})
            if what:
                child = self._append("nodes", {"name": whose, "mesh": number})
                self._json["nodes"][node].setdefault("children", []).append(child)
            else:
                self._json["nodes"][node]["mesh"] = number

    def write(self, path: Path) -> None:
        """Write the model over what is there; WriteError: the disk is full, or the folder went away."""
        self._json["buffers"] = [{"byteLength": self._length}]
        text = json.dumps(self._json, ensure_ascii=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sIIII", b"glTF", 2, 12 + 8 + len(text) + 8 + self._length, len(text), 0x4E4F534A)
        write_parts(path, [head, text, struct.pack("<II", self._length, 0x004E4942), *self._chunks])

    def _append(self, kind: str, value: dict[str, Any]) -> int:
        self._json[kind].append(value)
        return len(self._json[kind]) - 1

    def _material(self, name: str, picture: np.ndarray) -> dict[str, Any]:
        view = self._append("bufferViews", self._stored(jpeg_bytes(picture)))
        image = self._append("images", {"name": name, "mimeType": "image/jpeg", "bufferView": view})
        texture = self._append("textures", {"sampler": 0, "source": image})
        base = {"baseColorTexture": {"index": texture}, "metallicFactor": 0.0, "roughnessFactor": 1.0}
        return {"name": name, "pbrMetallicRoughness": base, "extensions": {"KHR_materials_unlit": {}}}

    def _primitive(self, mesh: TexturedMesh, material: int) -> dict[str, Any]:
        kind = np.uint16 if len(mesh.position) < np.iinfo(np.uint16).max else np.uint32
        position = mesh.position.astype(np.float32)
        bounds = {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
        attributes = {
            "POSITION": self._accessor(position, ARRAY_BUFFER, bounds),
            "TEXCOORD_0": self._accessor(mesh.texture.astype(np.float32), ARRAY_BUFFER),
        }
        indices = self._accessor(mesh.triangles.reshape(-1, 1).astype(kind), ELEMENT_ARRAY_BUFFER)
        return {"attributes": attributes, "indices": indices, "material": material, "mode": TRIANGLES}

    def _accessor(
        self, values: Shaped[np.ndarray, "count parts"], target: int, more: dict[str, Any] | None = None
    ) -> int:
        view = self._append("bufferViews", {**self._stored(values.tobytes()), "target": target})
        return self._append("accessors", {
            "bufferView": view, "componentType": COMPONENTS[str(values.dtype)], "count": len(values),
            "type": ELEMENTS[values.shape[1]], **(more or {}),
        })  # fmt: skip

    def _stored(self, data: bytes) -> dict[str, Any]:
        """Where in the buffer some bytes are put; everything begins at a multiple of four."""
        view = {"buffer": 0, "byteOffset": self._length, "byteLength": len(data)}
        self._chunks.append(data + bytes(-len(data) % 4))
        self._length += len(self._chunks[-1])
        if self._length > MAX_GLB_BYTES // 2:
            raise InputError(
                "expected a model of at most 2 GiB, which is what viewers can hold, got more; name fewer panoramas, or "
                "ask for a smaller texture (--texture)"
            )
        return view
