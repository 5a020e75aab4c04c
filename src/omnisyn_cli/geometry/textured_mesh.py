"""A triangle mesh with materials, as it comes from a file and goes to a ray caster."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8


@dataclass(frozen=True)
class Material:
    """What a surface looks like.

    Attributes:
        name: as the file has it.
        colour: ``(3,)`` sRGB in [0, 1], where there is no texture.
        texture: ``(height, width, 3)`` sRGB, or None.
        opacity: ``(rows, cols)`` 0 to 255 of a texture that cuts holes, or None.
        is_emissive: whether it shines by itself.
        is_lightmapped: whether its light is in the mesh's light map.
        is_lit: whether light is part of its colours already, as in photographs of a scan.
        tile: metres that a texture spans where it is projected along the axes instead of by texture coordinates, or
            None.
    """

    name: str
    colour: Float[np.ndarray, " 3"]
    texture: UInt8[np.ndarray, "height width 3"] | None = None
    opacity: UInt8[np.ndarray, "rows cols"] | None = None
    is_emissive: bool = False
    is_lightmapped: bool = False
    is_lit: bool = False
    tile: float | None = None

    @property
    def is_textured(self) -> bool:
        """Whether it has a texture."""
        return self.texture is not None


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles in metres, y up.

    Attributes:
        vertices: ``(vertices, 3)``.
        faces: ``(faces, 3)`` indices of vertices.
        uv: ``(vertices, 2)`` texture coordinates, (0, 0) in the lower left corner; they wrap.
        face_material: ``(faces,)`` index into ``materials``.
        materials: of all faces.
        vertex_colours: ``(vertices, 3)`` sRGB in [0, 1] instead of materials' colours, or None.
        light_uv: ``(vertices, 2)`` coordinates of the light map, as ``uv`` but clamped, or None.
        light_map: ``(height, width, 3)`` light, 1 is as bright as the texture, or None.
    """

    vertices: Float32[np.ndarray, "vertices 3"]
    faces: Int32[np.ndarray, "faces 3"]
    uv: Float32[np.ndarray, "vertices 2"]
    face_material: Int32[np.ndarray, " faces"]
    materials: tuple[Material, ...]
    vertex_colours: Float32[np.ndarray, "vertices 3"] | None = None
    light_uv: Float32[np.ndarray, "vertices 2"] | None = None
    light_map: Float32[np.ndarray, "height width 3"] | None = None

    def face_areas(self) -> Float[np.ndarray, " faces"]:
        """Square metres."""
        return np.asarray(0.5 * np.linalg.norm(self.face_normals(normalised=False), axis=1))

    def face_normals(self, *, normalised: bool = True) -> Float[np.ndarray, "faces 3"]:
        """Normals by the order of the vertices; of length one, or twice the area."""
        a, b, c = (self.vertices[self.faces[:, k]].astype(np.float64) for k in range(3))
        normals = np.cross(b - a, c - a)
        if not normalised:
            return normals
        return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20))
