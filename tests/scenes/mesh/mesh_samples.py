"""Rooms of triangles: a textured box, with a thing in it or without."""

import numpy as np
from PIL import Image

from omnisyn_cli.geometry.textured_mesh import Material, TexturedMesh

SIZE = np.array([6.0, 3.0, 8.0])
"""Metres, of the box room, which stands on y = 0 around the origin."""


def checks(seed=0, cells=8, pixels=64):
    """A texture of random squares."""
    colours = np.random.default_rng(seed).integers(30, 226, (cells, cells, 3), dtype=np.uint8)
    return np.kron(colours, np.ones((pixels // cells, pixels // cells, 1), np.uint8))


def box(size=SIZE, centre=(0.0, SIZE[1] / 2, 0.0)):
    """Vertices (24), faces (12) and texture coordinates of a box, four vertices a side."""
    vertices, uv = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = np.empty(3)
                corner[axis] = sign / 2
                corner[(axis + 1) % 3], corner[(axis + 2) % 3] = u - 0.5, v - 0.5
                vertices.append(corner * size + centre)
                uv.append((u, v))
    faces = [[4 * k + a for a in corners] for k in range(6) for corners in ((0, 1, 2), (0, 2, 3))]
    return np.array(vertices, np.float32), np.array(faces, np.int32), np.array(uv, np.float32)


def box_room(materials=None, **options):
    """The room as a mesh; every side has a material of its own."""
    vertices, faces, uv = box()
    if materials is None:
        materials = tuple(Material(f"side {k}", np.full(3, 0.5), texture=checks(k), **options) for k in range(6))
    return TexturedMesh(vertices, faces, uv, np.repeat(np.arange(6, dtype=np.int32), 2), materials)


def joined(one, other):
    """Two meshes as one."""
    return TexturedMesh(
        np.concatenate([one.vertices, other.vertices]),
        np.concatenate([one.faces, other.faces + len(one.vertices)]).astype(np.int32),
        np.concatenate([one.uv, other.uv]),
        np.concatenate([one.face_material, other.face_material + len(one.materials)]).astype(np.int32),
        one.materials + other.materials,
    )


def wall_ahead(distance, material):
    """A square wall of two metres straight ahead (−z) of a camera at eye height in the middle of the room."""
    vertices = np.array([[x, 1.5 + y, -distance] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], np.float32)
    faces, uv = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return TexturedMesh(vertices, faces, uv, np.zeros(2, np.int32), (material,))


def depth_in_box(position, directions, size=SIZE, centre=(0.0, SIZE[1] / 2, 0.0)):
    """Distance to the inner sides of a box, in closed form."""
    with np.errstate(divide="ignore"):
        to_sides = (np.sign(directions) * size / 2 - (position - np.array(centre))) / directions
    return np.where(directions == 0, np.inf, to_sides).min(axis=-1)


def write_glb(path, colours=None):
    """The box room as glTF: a texture, or vertex colours."""
    import trimesh

    vertices, faces, uv = box()
    if colours is None:
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(checks()), name="paint")
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    else:
        visual = trimesh.visual.ColorVisuals(vertex_colors=colours)
    trimesh.Scene(trimesh.Trimesh(vertices, faces, visual=visual, process=False)).export(path)
    return path
