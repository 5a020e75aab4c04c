"""One panorama seen from elsewhere, by a method chosen by name.

``mesh``: the exact rasteriser, the default. ``points``: every pixel of the inverse depth is a disc, no surface is
assumed. ``two-pass``: the paper's (section 3.4), kept for comparison.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.mesh import Cut, build_mesh, mask_of_vertices
from omnisyn_cli.render.points import PointRenderer
from omnisyn_cli.render.rasterize import Rasterizer
from omnisyn_cli.render.shade import Shader, make_texture
from omnisyn_cli.render.two_pass import TwoPassRenderer
from omnisyn_cli.types import RowRendering

__all__ = ["RENDERERS", "MeshRenderer", "Renderer", "make_renderer"]

Image = Float[np.ndarray, "height width 3"]
Mask = Bool[np.ndarray, "height width"]
VertexImage = Float[np.ndarray, "rows cols"]


class Renderer(Protocol):
    """A panorama with its depth, ready to be seen from any number of places."""

    def __call__(
        self, target_from_source: Pose
    ) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width 4"]]:
        """What the target sees: inverse depth (1/metre, negative where nothing is seen), and RGB with trust in [0, 1].

        Both are buffers that the next call overwrites. Not to be called from two threads at once.
        """
        ...


class MeshRenderer:
    """A mesh cut at depth discontinuities, rasterised exactly, with the photograph as its texture."""

    def __init__(
        self,
        image: Image,
        mask: Mask | None,
        inverse_depth: VertexImage,
        confidence: VertexImage | None,
        size: tuple[int, int],
        cut: Cut | None = None,
        threads: int | None = None,
    ) -> None:
        self._mesh = build_mesh(inverse_depth, cut, mask_of_vertices(mask, inverse_depth.shape), confidence)
        self._texture = make_texture(image, mask)
        self._rasterizer = Rasterizer(self._mesh.size, size, threads)
        self._shader = Shader(size, threads)

    def __call__(self, target_from_source: Pose) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Renderer`."""
        fragments = self._rasterizer(self._mesh, target_from_source)
        return fragments.inverse_depth, self._shader(fragments, self._mesh, self._texture, target_from_source)

    def by_rows(self, target_from_source: Pose) -> RowRendering:
        """The same, with colours made as they are asked for: from any number of threads, until the next call."""
        fragments = self._rasterizer(self._mesh, target_from_source)
        seen, trust = (fragments.inverse_depth, fragments.face), (self._mesh.trust.ravel(),)
        what = (seen, trust, self._texture, target_from_source)
        return RowRendering(
            fragments.inverse_depth, partial(self._shader.some_rows, *what), partial(self._shader.crossings, *what),
            target_from_source,
        )  # fmt: skip


RENDERERS: dict[str, Callable[..., Renderer]] = {
    "mesh": MeshRenderer,
    "points": PointRenderer,
    "two-pass": TwoPassRenderer,
}
"""Classes by name; all are made with the arguments of :class:`MeshRenderer`."""


def make_renderer(
    name: str,
    image: Image,
    mask: Mask | None,
    inverse_depth: VertexImage,
    confidence: VertexImage | None,
    size: tuple[int, int],
    cut: Cut | None = None,
    threads: int | None = None,
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

    Raises:
        ValueError: on an unknown name or inverse depths that are negative or not finite.
    """
    if name not in RENDERERS:
        raise ValueError(f"expected one of {', '.join(RENDERERS)} as renderer, got {name!r}")
    return RENDERERS[name](image, mask, inverse_depth, confidence, size, cut, threads)
