"""The rasteriser of the paper (section 3.4), kept to compare the exact one with.

Triangles between vertices in the target are drawn flat, in the plane of the equirectangular image, inverse depth linear
there. Each pass leaves out what is wider than half the image, which is across its seam, and a second one draws an image
turned by 180°; of both, the nearer counts. It differs from :mod:`omnisyn_cli.render.rasterize` where a triangle is
large in the image, as around the poles: one that holds a pole is drawn wrongly or not at all; polar caps are missing.
"""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from omnisyn_cli.compute.jit import kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_scale
from omnisyn_cli.render.mesh import Mesh, Triangles
from omnisyn_cli.render.quad_blocks import FACES_PER_QUAD
from omnisyn_cli.render.rasterize import NO_FACE, Fragments
from omnisyn_cli.render.renderer import RendererInputs
from omnisyn_cli.render.shade import Reprojector, Shader, make_confidence_map
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.types import Layer


def rasterize_two_pass(
    triangles: Triangles, target_from_source: Pose, size: tuple[int, int], threads: int | None = None
) -> Fragments:
    """:func:`omnisyn_cli.render.rasterize.rasterize`, as far as flat triangles keep its contract; even widths only."""
    rotation, translation = np.ascontiguousarray(target_from_source.rotation), np.asarray(target_from_source.position)
    corners = np.empty((*triangles.inverse_depth.shape, 3))
    fragments = Fragments(np.full(size, -1.0, np.float32), np.full(size, NO_FACE, np.int32))
    scale = np.array(pixel_scale(size))

    def flatten(begin: int, end: int) -> None:
        flatten_triangles(
            triangles.direction, triangles.inverse_depth, rotation, translation, scale, corners, begin, end
        )

    def draw(begin: int, end: int) -> None:
        for turn in (0, size[1] // 2):
            draw_flat_triangles(triangles.face, corners, turn, fragments.inverse_depth, fragments.face, begin, end)

    run_ranges(flatten, len(corners), threads)
    run_ranges(draw, size[0], threads)
    return fragments


@kernel()
def flatten_triangles(direction, rho, rotation, t, scale, corners, begin, end):  # type: ignore[no-untyped-def]
    """Row, column and inverse depth in the target of the corners of triangles ``begin`` to ``end``."""
    for face in range(begin, end):
        for k in range(3):
            x, y, z, w = direction[face, k, 0], direction[face, k, 1], direction[face, k, 2], rho[face, k]
            vx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + w * t[0]
            vy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + w * t[1]
            vz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + w * t[2]
            length = math.sqrt(vx * vx + vy * vy + vz * vz)
            corners[face, k, 0] = math.atan2(math.sqrt(vx * vx + vz * vz), vy) * scale[0] + scale[1]
            corners[face, k, 1] = math.atan2(vx, -vz) * scale[2] + scale[3]
            corners[face, k, 2] = w / length if length > 0.0 else 0.0


@kernel()
def draw_flat_triangles(numbers, corners, turn, out_rho, out_face, begin, end):  # type: ignore[no-untyped-def]
    """Draw in an image turned by ``turn`` columns; none from behind, or wider than half of it (across its seam)."""
    width = out_rho.shape[1]
    for face in range(corners.shape[0]):
        r0, r1, r2 = corners[face, 0, 0], corners[face, 1, 0], corners[face, 2, 0]
        low, high = min(r0, min(r1, r2)), max(r0, max(r1, r2))
        if high < begin or low > end - 1:
            continue
        c0, c1, c2 = (
            (corners[face, 0, 1] + turn) % width,
            (corners[face, 1, 1] + turn) % width,
            (corners[face, 2, 1] + turn) % width,
        )
        left, right = min(c0, min(c1, c2)), max(c0, max(c1, c2))
        area = (c1 - c0) * (r2 - r0) - (c2 - c0) * (r1 - r0)
        if right - left > 0.5 * width or area <= 0.0:
            continue
        for row in range(max(begin, math.ceil(low)), min(end - 1, math.floor(high)) + 1):
            for turned in range(math.ceil(left), math.floor(right) + 1):
                b0 = (c1 - turned) * (r2 - row) - (c2 - turned) * (r1 - row)
                b1 = (c2 - turned) * (r0 - row) - (c0 - turned) * (r2 - row)
                b2 = (c0 - turned) * (r1 - row) - (c1 - turned) * (r0 - row)
                if b0 < 0.0 or b1 < 0.0 or b2 < 0.0:
                    continue
                col = (turned - turn) % width
                seen = (b0 * corners[face, 0, 2] + b1 * corners[face, 1, 2] + b2 * corners[face, 2, 2]) / area
                if np.float32(seen) > out_rho[row, col]:
                    out_rho[row, col] = seen
                    out_face[row, col] = numbers[face]


def triangles_without_caps(mesh: Mesh) -> Triangles:
    """All triangles but those at the poles: a pole has no azimuth, so no place in the plane."""
    triangles = mesh.triangles()
    kept = triangles.face < FACES_PER_QUAD * mesh.quads.size
    return Triangles(triangles.face[kept], triangles.direction[kept], triangles.inverse_depth[kept])


class TwoPassRenderer:
    """See :class:`omnisyn_cli.render.renderer.Renderer`: the mesh, drawn flat in two passes."""

    shades_on_demand: ClassVar[bool] = False

    def __init__(self, inputs: RendererInputs) -> None:
        mesh = inputs.mesh()
        self._triangles = triangles_without_caps(mesh)
        self._texture = make_texture(inputs.image, inputs.mask)
        self._confidence_map = make_confidence_map(mesh, self._texture)
        self._shader = Shader(inputs.size, inputs.threads)
        self._reprojector = Reprojector(lambda: self._texture, inputs.inverse_depth, self._shader)

    def __call__(self, target_from_source: Pose) -> Layer:
        """See :class:`omnisyn_cli.render.renderer.Renderer`."""
        seen = rasterize_two_pass(self._triangles, target_from_source, self._shader.size, self._shader.threads)
        colour = self._shader(seen.inverse_depth, self._confidence_map, self._texture, target_from_source)
        source_sampler = self._reprojector.sampler(target_from_source)
        return replace(Layer.from_arrays(seen.inverse_depth, colour, target_from_source), source_sampler=source_sampler)
