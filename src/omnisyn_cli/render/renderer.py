"""One panorama with its depth, ready to be seen from elsewhere."""

from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import Bool, Float, Shaped

from omnisyn_cli.geometry.perspective import equivalent_rows
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.mesh import Cut, Mesh, build_mesh, mask_of_vertices
from omnisyn_cli.render.rasterize import Rasterizer
from omnisyn_cli.render.shade import Reprojector, Shader, make_confidence_map
from omnisyn_cli.render.simplify import simplify
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.types import EdgePixels, EdgeSamples, Layer, SourceSampler


@dataclass(frozen=True)
class RendererInputs:
    """A panorama with its depth, and what it is drawn for."""

    image: Shaped[np.ndarray, "height width 3"]  # the photograph, RGB in [0, 1] or 8 bits; it becomes the texture
    mask: Bool[np.ndarray, "height width"] | None  # False where the image shows nothing usable
    inverse_depth: Float[np.ndarray, "rows cols"]  # 1/metre, finite and >= 0; its resolution is that of the mesh
    confidence: Float[np.ndarray, "rows cols"] | None  # of the inverse depths, in [0, 1]; None is 1 everywhere
    size: tuple[int, int]  # height and width of the targets
    cut: Cut | None = None  # where surfaces are separated
    threads: int | None = None  # at most this many; None is one per core
    # metres in the panorama's frame: all targets lie between the panorama and this point, so that flat surfaces may be
    # drawn with fewer triangles; None lets targets lie anywhere
    path_end: Float[np.ndarray, " 3"] | None = None

    def mesh(self) -> Mesh:
        """The surface; ValueError for inverse depths that are negative or not finite."""
        mask = mask_of_vertices(self.mask, self.inverse_depth.shape)
        return build_mesh(self.inverse_depth, self.cut, mask, self.confidence)


class Renderer(Protocol):
    """A panorama with its depth, ready to be seen from any number of places."""

    def __call__(self, target_from_source: Pose) -> Layer:
        """What the target sees, in buffers that the next call overwrites. Not to be called from two threads at once."""
        ...


class RendererClass(Protocol):
    """What makes renderers."""

    @property
    def shades_on_demand(self) -> bool:
        """Whether colours are made for some rows at a time, from textures of 8 bits where they do."""
        ...

    def __call__(self, inputs: RendererInputs) -> Renderer:
        """A renderer of one panorama."""
        ...


class MeshRenderer:
    """A mesh cut at depth discontinuities, rasterised exactly, with the photograph as its texture."""

    shades_on_demand: ClassVar[bool] = True

    def __init__(self, inputs: RendererInputs) -> None:
        mesh, size, threads = inputs.mesh(), inputs.size, inputs.threads
        self.texture, self._shader = make_texture(inputs.image, inputs.mask), Shader(size, threads)
        self.confidence_map = make_confidence_map(mesh, self.texture)
        every = mesh.face_count()
        self.quads, drawn = mesh.blocks, every
        if inputs.path_end is not None:
            self.quads, drawn = simplify(mesh, inputs.path_end, equivalent_rows(size), threads=threads)
        self.triangles = drawn, every  # drawn for a frame, and of the mesh
        self._rasterizer = Rasterizer(size, threads)
        self._reprojector = Reprojector(lambda: self.texture, inputs.inverse_depth, self._shader)

    def twin(self, threads: int) -> "MeshRenderer":
        """The same surface with the same texture, and buffers of its own: for another thread."""
        twin, size = copy(self), self._shader.size
        twin._shader, twin._rasterizer = Shader(size, threads), Rasterizer(size, threads)
        twin._reprojector = Reprojector(lambda: self.texture, self._reprojector.inverse_depth, twin._shader)
        return twin

    def __call__(self, target_from_source: Pose) -> Layer:
        """See :class:`Renderer`; colours are shaded on demand."""
        seen = self._rasterizer(self.quads, target_from_source)
        surface = (seen, self.confidence_map, self.texture, target_from_source)
        return Layer(
            seen,
            partial(self._shader.shade_rows_into, *surface),
            partial(self._shader.shade_grid, *surface),
            target_from_source,
            edge_samples=partial(self._edge_samples, target_from_source) if self._rasterizer.samples_edges else None,
            source_sampler=self.source_sampler(target_from_source),
        )

    def source_sampler(self, target_from_source: Pose) -> SourceSampler:
        """Looks up what the panorama shows of points of the target."""
        return self._reprojector.sampler(target_from_source)

    def _edge_samples(self, target_from_source: Pose, edge_pixels: EdgePixels) -> EdgeSamples:
        """Samples of the surface that the last call rasterised."""
        seen = self._rasterizer.edge_samples(self.quads, target_from_source, edge_pixels)
        colour = self._shader.shade_edges(seen, edge_pixels, self.confidence_map, self.texture, target_from_source)
        return seen, colour
