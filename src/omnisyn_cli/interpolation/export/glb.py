"""A binary glTF 2.0 model: a node for each panorama, with an unlit, textured mesh, and its sky as a node below it.

glTF's frame is ours: right-handed, y up, metres; panoramas look along their node's −z. Source: Khronos, glTF 2.0
specification, section 4 (GLB) and ``KHR_materials_unlit``.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.interpolation.export.triangulation import TexturedMesh
from omnisyn_cli.io.encode import jpeg_bytes
from omnisyn_cli.io.outputs import write_parts

MAX_GLB_BYTES = 2**32 - 1
"""Lengths in a GLB are numbers of 32 bits."""

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
        name is the node's own. Those without triangles are left out.

        Raises InputError: the model has become larger than the format can say.
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
