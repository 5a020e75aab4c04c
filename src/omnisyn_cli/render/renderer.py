"""One panorama seen from elsewhere, by a method chosen by name.

``mesh``: the exact rasteriser, the default. ``two-pass``: the paper's (section 3.4), kept for comparison.
"""

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.baselines.two_pass import TwoPassRenderer
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.mesh import Cut, build_mesh, mask_of_vertices
from omnisyn_cli.render.rasterize import Rasterizer
from omnisyn_cli.render.reprojection import Reprojector
from omnisyn_cli.render.shade import Shader, make_confidence_map
from omnisyn_cli.render.simplify import simplify
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.types import EdgePixels, EdgeSamples, Layer

__all__ = ["MeshRenderer", "Renderer", "make_renderer"]

Image = Float[np.ndarray, "height width 3"]
Mask = Bool[np.ndarray, "height width"]
VertexImage = Float[np.ndarray, "rows cols"]
Way = Float[np.ndarray, " 3"]


class Renderer(Protocol):
    """A panorama with its depth, ready to be seen from any number of places."""

    def __call__(self, target_from_source: Pose) -> Layer:
        """What the target sees, in buffers that the next call overwrites. Not to be called from two threads at once."""
        ...


class MeshRenderer:
    """A mesh cut at depth discontinuities, rasterised exactly, with the photograph as its texture.

    Attributes:
        triangles: how many are drawn for a frame, and how many the mesh has.
    """

    def __init__(
        self,
        image: Image,
        mask: Mask | None,
        inverse_depth: VertexImage,
        confidence: VertexImage | None,
        size: tuple[int, int],
        cut: Cut | None = None,
        threads: int | None = None,
        way: Way | None = None,
    ) -> None:
        mesh = build_mesh(inverse_depth, cut, mask_of_vertices(mask, inverse_depth.shape), confidence)
        self._texture, self._shader = make_texture(image, mask), Shader(size, threads)
        self._trust = make_confidence_map(mesh, self._texture)
        every = mesh.face_count()
        self._quads, drawn = (mesh.blocks, every) if way is None else simplify(mesh, way, size[0], threads=threads)
        self.triangles, self._rasterizer = (drawn, every), Rasterizer(size, threads)
        self._asked = Reprojector(lambda: self._texture, inverse_depth, self._shader)

    def __call__(self, target_from_source: Pose) -> Layer:
        """See :class:`Renderer`; colours are made as they are asked for."""
        seen = self._rasterizer(self._quads, target_from_source)
        what = (seen, self._trust, self._texture, target_from_source)
        return Layer(
            seen, partial(self._shader.shade_rows_into, *what), partial(self._shader.shade_grid, *what), target_from_source,
            samples=partial(self._samples, target_from_source), source_sampler=self._asked.seen_from(target_from_source),
        )  # fmt: skip

    def _samples(self, target_from_source: Pose, edge_pixels: EdgePixels) -> EdgeSamples:
        """Of spots of what was seen last."""
        seen = self._rasterizer.samples(self._quads, target_from_source, edge_pixels)
        return seen, self._shader.samples(seen, edge_pixels, self._trust, self._texture, target_from_source)


RENDERERS: dict[str, Callable[..., Renderer]] = {
    "mesh": MeshRenderer,
    "two-pass": TwoPassRenderer,
}
"""Classes by name; all are made with the arguments of :class:`MeshRenderer`, which alone knows a way."""


def make_renderer(
    name: str,
    image: Image,
    mask: Mask | None,
    inverse_depth: VertexImage,
    confidence: VertexImage | None,
    size: tuple[int, int],
    cut: Cut | None = None,
    threads: int | None = None,
    way: Way | None = None,
) -> Renderer:
    """A renderer of one panorama.

    Args:
        name: one of :data:`RENDERERS`.
        image: RGB in [0, 1], at the resolution of the photograph; it becomes the texture.
        mask: of the image's size, False where it shows nothing usable.
        inverse_depth: 1/metre, finite and >= 0, at a resolution of its own: that of the mesh.
        confidence: in [0, 1], of the inverse depths' size; by default 1 everywhere.
        size: height and width of the targets.
        cut: where surfaces are separated.
        threads: at most this many; by default one per core.
        way: metres in the panorama's frame: all targets will lie between the panorama and this point, so that ``mesh``
            may draw what is flat as far as they can tell with fewer triangles. By default they may lie anywhere.

    Raises:
        ValueError: on an unknown name or inverse depths that are negative or not finite.
    """
    if name not in RENDERERS:
        raise ValueError(f"expected one of {', '.join(RENDERERS)} as renderer, got {name!r}")
    options = {"way": way} if name == "mesh" else {}
    return RENDERERS[name](image, mask, inverse_depth, confidence, size, cut, threads, **options)
