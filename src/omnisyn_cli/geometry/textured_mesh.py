"""A triangle mesh with materials, as it comes from a file and goes to a ray caster."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8


@dataclass(frozen=True)
class Material:
    """What a surface looks like."""

    name: str  # as the file has it
    colour: Float[np.ndarray, " 3"]  # sRGB in [0, 1], where there is no texture
    texture: UInt8[np.ndarray, "height width 3"] | None = None  # sRGB, or None
    opacity: UInt8[np.ndarray, "rows cols"] | None = None  # 0 to 255 of a texture that cuts holes, or None
    is_emissive: bool = False  # whether it shines by itself
    is_lightmapped: bool = False  # whether its light is in the mesh's light map
    is_lit: bool = False  # whether light is part of its colours already, as in photographs of a scan
    # metres that a texture spans where it is projected along the axes instead of by texture coordinates, or None
    tile: float | None = None

    @property
    def is_textured(self) -> bool:
        """Whether it has a texture."""
        return self.texture is not None


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles in metres, y up."""

    vertices: Float32[np.ndarray, "vertices 3"]  # ``(vertices, 3)``
    faces: Int32[np.ndarray, "faces 3"]  # indices of vertices
    uv: Float32[np.ndarray, "vertices 2"]  # texture coordinates, (0, 0) in the lower left corner; they wrap
    face_material: Int32[np.ndarray, " faces"]  # index into ``materials``
    materials: tuple[Material, ...]  # of all faces
    # sRGB in [0, 1] instead of materials' colours, or None
    vertex_colours: Float32[np.ndarray, "vertices 3"] | None = None
    # coordinates of the light map, as ``uv`` but clamped, or None
    light_uv: Float32[np.ndarray, "vertices 2"] | None = None
    light_map: Float32[np.ndarray, "height width 3"] | None = None  # light, 1 is as bright as the texture, or None

    def face_areas(self) -> Float[np.ndarray, " faces"]:
        """Square metres."""
        a, b, c = (self.vertices[self.faces[:, k]].astype(np.float64) for k in range(3))
        return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
