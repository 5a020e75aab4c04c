"""The rasteriser of the paper (section 3.4), kept to compare the exact one with.

Triangles between vertices in the target are drawn flat, in the plane of the equirectangular image, inverse depth linear
there. Each pass leaves out what is wider than half the image, which is across its seam, and a second one draws an image
turned by 180°; of both, the nearer counts. It differs from :mod:`omnisyn_cli.render.rasterize` where a triangle is
large in the image, as around the poles: one that holds a pole is drawn wrongly or not at all, and the source's own
polar caps are missing.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from omnisyn_cli.baselines.two_pass_kernels import draw_flat_triangles, flatten_triangles
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_scale
from omnisyn_cli.render.mesh import Mesh, Triangles
from omnisyn_cli.render.quad_blocks import FACES_PER_QUAD
from omnisyn_cli.render.rasterize import NO_FACE, Fragments
from omnisyn_cli.render.renderer import RendererInputs
from omnisyn_cli.render.reprojection import Reprojector
from omnisyn_cli.render.shade import Shader, make_confidence_map
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
