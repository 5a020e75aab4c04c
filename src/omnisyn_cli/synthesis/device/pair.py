"""Frames of a pair of views, made on a device from the surfaces to the samples that are written.

For every waypoint both meshes are rasterised and coloured, brought to one exposure, freed of ghosts, blended, filled
and rounded; what comes to the host is the finished frame, once, and besides it only counts (how many pixels lie in the
boxes of quads, how many in holes, whether regions of ghosts still grow).

Memory on the device: see :mod:`omnisyn_cli.synthesis.device.raster` for meshes; both textures with their mip levels,
four or 16 bytes a texel; and at most about 110 bytes for every pixel of the frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32, Integer, Shaped, UInt8
from torch import Tensor

from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, blend_layers, view_weights
from omnisyn_cli.fusion.ghosts import GhostRemover, have_same_position
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.fusion.photometry import ExposureCurve, ExposureMatcher
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.render.mesh import Cut, build_mesh, mask_of_vertices
from omnisyn_cli.render.shade import make_confidence_map
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.synthesis.device.device import open_device, report_out_of_memory
from omnisyn_cli.synthesis.device.pictures import change_colours, fill_holes, samples_of
from omnisyn_cli.synthesis.device.quads import Quads, quads_of
from omnisyn_cli.synthesis.device.raster import GpuRasterizer
from omnisyn_cli.synthesis.device.shading import GpuConfidenceMap, GpuTexture, confidence_on, shade, texture_on
from omnisyn_cli.types import DepthEstimate, Layer

__all__ = ["GpuFrames"]

PIXELS_PER_STEP = 1 << 20
"""Pixels that are coloured or blended together."""


class GpuFrames:
    """Makes frames of one size on one device.

    Args:
        size: height and width of the frames.
        device: ``cuda``; ``cpu`` for tests and comparisons.

    Raises InputError: CUDA is asked for and torch sees none.
    """

    def __init__(self, size: tuple[int, int], device: str = "cuda") -> None:
        self.size, self.device = size, open_device(device)
        self.rasterizer, self.ghosts = GpuRasterizer(size, self.device), GhostRemover(size)
        self._tables = [torch.from_numpy(table).to(self.device, torch.float32) for table in direction_tables(*size)]

    def surface(
        self,
        image: Shaped[np.ndarray, "height width 3"],
        mask: Bool[np.ndarray, "height width"] | None,
        depth: DepthEstimate,
        cut: Cut | None = None,
    ) -> GpuSurface:
        """A panorama with its depth, on the device.

        Args:
            image: RGB in [0, 1], or samples of 8 bits.
            mask: of the image's size, False where it shows nothing usable.
            depth: at the resolution of the mesh.
            cut: where surfaces are separated.

        Raises ValueError: on inverse depths that are negative or not finite; OmnisynError: the device has no
        memory left.
        """
        mesh = build_mesh(depth.inverse_depth, cut, mask_of_vertices(mask, depth.inverse_depth.shape), depth.confidence)
        texture = make_texture(image, mask)
        with report_out_of_memory():
            surface_confidence = confidence_on(make_confidence_map(mesh, texture), self.device)
            return GpuSurface(self, quads_of(mesh, self.device), surface_confidence, texture_on(texture, self.device))

    def pair(self, first: GpuSurface, second: GpuSurface, curve: ExposureCurve, *, dissolves: bool = False) -> GpuPair:
        """Two of its surfaces between which frames are made; arguments as of :class:`GpuPair`."""
        return GpuPair(first, second, curve, dissolves=dissolves)

    def bands(self) -> Iterator[slice]:
        """Rows that are coloured or blended together."""
        rows = max(1, PIXELS_PER_STEP // self.size[1])
        for top in range(0, self.size[0], rows):
            yield slice(top, min(top + rows, self.size[0]))

    def rays(
        self, rows: slice | Integer[Tensor, " rows"], cols: slice | Integer[Tensor, " cols"] = slice(None)
    ) -> Float32[Tensor, "rows cols 3"]:
        """Unit vectors through the pixels of some rows and columns."""
        sin_p, cos_p, sin_a, cos_a = self._tables
        sine, x, z = sin_p[rows][:, None], sin_a[cols], -cos_a[cols]
        return torch.stack([sine * x, cos_p[rows][:, None].expand(-1, len(x)), sine * z], dim=-1)


@dataclass(frozen=True)
class GpuSurface:
    """A panorama with its depth on a device; implements :class:`omnisyn_cli.render.renderer.Renderer`.

    Attributes:
        frames: what it is drawn for.
        quads: of its mesh.
        surface_confidence: of its depth, on the device.
        texture: the photograph.
    """

    frames: GpuFrames
    quads: Quads
    surface_confidence: GpuConfidenceMap
    texture: GpuTexture

    def __call__(self, target_from_source: Pose) -> Layer:
        """The rendering, on the host and in memory of its own."""
        seen = self.with_cached_colour(self.seen_from(target_from_source))
        return Layer.from_arrays(seen.inverse_depth.cpu().numpy(), seen.colour.cpu().numpy(), target_from_source)

    def seen_from(self, target_from_source: Pose) -> Layer:
        """The rendering, on the device."""
        rho = self.frames.rasterizer(self.quads, target_from_source)

        def shaded(seen: Tensor, rays: Tensor) -> Tensor:
            return shade(seen, self.surface_confidence, rays, self.texture, target_from_source, self.frames.size[0])

        def colour_rows(begin: int, end: int, out: Tensor) -> None:
            out[:] = shaded(rho[begin:end], self.frames.rays(slice(begin, end)))

        def subsampled_colours(rows: np.ndarray, cols: np.ndarray) -> Tensor:
            row, col = (torch.from_numpy(index).to(rho.device) for index in (rows, cols))
            return shaded(rho[row][:, col], self.frames.rays(row, col))

        return Layer(rho, colour_rows, subsampled_colours, target_from_source)

    def with_cached_colour(self, seen: Layer) -> Layer:
        """A rendering on the device with all of its colours at hand."""
        colour = torch.empty((*self.frames.size, 4), device=self.frames.device)
        for rows in self.frames.bands():
            seen.colour_rows(rows.start, rows.stop, colour[rows])
        return Layer.from_arrays(seen.inverse_depth, colour, seen.target_from_source)


class GpuPair:
    """Two surfaces between which frames are made.

    Args:
        first: of the first view.
        second: of the second view, made for the same frames.
        curve: how much brighter the second picture is than the first.
        dissolves: whether ghosts stay, see :meth:`omnisyn_cli.fusion.geometric.GeometricFuser.blend_by_rule`.
    """

    def __init__(self, first: GpuSurface, second: GpuSurface, curve: ExposureCurve, *, dissolves: bool = False) -> None:
        self.surfaces, self._frames, self._dissolves = (first, second), first.frames, dissolves
        self._expose = ExposureMatcher(curve, change_colours)
        self._nearest: Tensor | None = None

    @property
    def triangles(self) -> int:
        """How many are drawn for a frame."""
        return sum(surface.quads.triangles for surface in self.surfaces)

    @property
    def nearest(self) -> float:
        """The greatest inverse depth in the last frame, 1/metre; infinite before there is one."""
        return math.inf if self._nearest is None else float(self._nearest)

    @report_out_of_memory()
    def frame(
        self, target_from_first: Pose, target_from_second: Pose, t: float,
        out: UInt8[np.ndarray, "height width 3"] | Float32[np.ndarray, "height width 3"],
    ) -> None:  # fmt: skip
        """The frame at a share ``t`` of the way.

        Args:
            target_from_first: rigid transform from the first view's camera frame to the target's.
            target_from_second: likewise of the second.
            t: share of the way.
            out: written: rounded to 8 bits, or as numbers, never negative.

        Raises OmnisynError: the device has no memory left.
        """
        poses = (target_from_first, target_from_second)
        seen = [surface.seen_from(pose) for surface, pose in zip(self.surfaces, poses, strict=True)]
        self._nearest = torch.maximum(*(view.inverse_depth.max() for view in seen))
        first, second = self._expose(seen[0], seen[1], t)
        image = self._fused(first, second, BlendRule.at(t, dissolves=self._dissolves))
        torch.from_numpy(out).copy_(samples_of(image) if out.dtype == np.uint8 else image)

    def _fused(self, first: Layer, second: Layer, rule: BlendRule) -> Float32[Tensor, "height width 3"]:
        """The picture, ghosts suppressed and holes filled, see :class:`omnisyn_cli.fusion.geometric.GeometricFuser`."""
        frames = self._frames
        if frames.ghosts.is_full_resolution:
            first, second = (
                surface.with_cached_colour(view) for surface, view in zip(self.surfaces, (first, second), strict=True)
            )
        keeps_ghosts = self._dissolves or have_same_position(first, second)
        suppression = None if keeps_ghosts else frames.ghosts(first, second, rule)
        views = LayerPair(first, second).with_step(suppression)
        image = torch.empty((*frames.size, 3), device=frames.device)
        weight = torch.empty(frames.size, device=frames.device)
        for rows in frames.bands():
            colours = torch.empty((2, rows.stop - rows.start, frames.size[1], 4), device=frames.device)
            views.shade_rows(rows.start, rows.stop, colours)
            one, other = (
                _layer_arrays(view, rows, colour) for view, colour in zip((first, second), colours, strict=True)
            )
            weights = view_weights(one, other, frames.rays(rows), rule)
            image[rows], weight[rows] = blend_layers(one, other, weights)
        fill_holes(image, weight)
        return image


def _layer_arrays(view: Layer, rows: slice, colour: Float32[Tensor, "rows width 4"]) -> LayerArrays:
    offset = torch.as_tensor(view.target_from_source.position).to(colour)
    return LayerArrays(colour[..., :3], colour[..., 3], view.inverse_depth[rows], offset)
