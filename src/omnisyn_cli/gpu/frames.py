"""Frames of a pair of views, made on a device from the surfaces to the samples that are written.

For every waypoint both meshes are rasterised and coloured, brought to one exposure, freed of ghosts, blended, filled
and rounded; what comes to the host is the finished frame, once, and besides it only counts (how many pixels lie in the
boxes of quads, how many in holes, whether regions of ghosts still grow).

Memory on the device: see :mod:`omnisyn_cli.gpu.raster` for meshes; both textures with their mip levels, four or 16
bytes a texel; and about 110 bytes for every pixel of the frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32, Shaped, UInt8
from torch import Tensor

from omnisyn_cli.fusion.geometric import hiding_strength
from omnisyn_cli.fusion.options import BlendOptions
from omnisyn_cli.geometry.pose import STILL, Pose
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.gpu.blending import BlendRule, Exposure, Shown, blend, expose, samples_of
from omnisyn_cli.gpu.device import memory_of_device, open_device
from omnisyn_cli.gpu.filling import fill_holes
from omnisyn_cli.gpu.ghosts import GpuGhosts
from omnisyn_cli.gpu.quads import Quads, quads_of
from omnisyn_cli.gpu.raster import GpuRasterizer
from omnisyn_cli.gpu.shading import GpuTexture, GpuTrust, shade, texture_on, trust_on
from omnisyn_cli.photometry import ExposureCurve
from omnisyn_cli.photometry.matching import loss_of_white
from omnisyn_cli.render.mesh import Cut, build_mesh, mask_of_vertices
from omnisyn_cli.render.shade import make_trust
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.types import DepthEstimate

__all__ = ["GpuFrames", "GpuPair", "GpuSurface"]

PIXELS_AT_A_TIME = 1 << 20
"""Pixels that are coloured or blended together."""


class GpuFrames:
    """Makes frames of one size on one device.

    Args:
        size: height and width of the frames.
        device: ``cuda``; ``cpu`` for tests and comparisons.

    Raises:
        InputError: CUDA is asked for and torch sees none.
    """

    def __init__(self, size: tuple[int, int], device: str = "cuda") -> None:
        self.size, self.device, self.options = size, open_device(device), BlendOptions()
        self.rasterizer, self.ghosts = GpuRasterizer(size, self.device), GpuGhosts(size, self.device)
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

        Raises:
            ValueError: on inverse depths that are negative or not finite.
            OmnisynError: the device has no memory left.
        """
        mesh = build_mesh(depth.inverse_depth, cut, mask_of_vertices(mask, depth.inverse_depth.shape), depth.confidence)
        texture = make_texture(image, mask)
        with memory_of_device():
            trust = trust_on(make_trust(mesh, texture), self.device)
            return GpuSurface(self, quads_of(mesh, self.device), trust, texture_on(texture, self.device))

    def pair(self, first: GpuSurface, second: GpuSurface, curve: ExposureCurve) -> GpuPair:
        """Two of its surfaces between which frames are made, the second picture so much brighter than the first."""
        return GpuPair(first, second, curve)

    def bands(self) -> Iterator[slice]:
        """Rows that are coloured or blended together."""
        rows = max(1, PIXELS_AT_A_TIME // self.size[1])
        for top in range(0, self.size[0], rows):
            yield slice(top, min(top + rows, self.size[0]))

    def rays(self, rows: slice) -> Float32[Tensor, "rows width 3"]:
        """Unit vectors through the pixels of some rows."""
        sin_p, cos_p, sin_a, cos_a = self._tables
        sine = sin_p[rows, None]
        return torch.stack([sine * sin_a, cos_p[rows, None].expand(-1, self.size[1]), -sine * cos_a], dim=-1)


@dataclass(frozen=True)
class GpuSurface:
    """A panorama with its depth on a device; implements :class:`omnisyn_cli.render.renderer.Renderer`.

    Attributes:
        frames: what it is drawn for.
        quads: of its mesh.
        trust: in it.
        texture: the photograph.
    """

    frames: GpuFrames
    quads: Quads
    trust: GpuTrust
    texture: GpuTexture

    def __call__(self, target_from_source: Pose) -> tuple[np.ndarray, np.ndarray]:
        """The rendering, on the host and in memory of its own."""
        seen = self.seen_from(target_from_source)
        return seen.inverse_depth.cpu().numpy(), seen.colour.cpu().numpy()

    def seen_from(self, target_from_source: Pose, exposure: Exposure | None = None) -> Shown:
        """The rendering, exposed otherwise if that is asked for."""
        rho = self.frames.rasterizer(self.quads, target_from_source)
        colour = torch.empty((*rho.shape, 4), device=rho.device)
        for rows in self.frames.bands():
            rays = self.frames.rays(rows)
            shaded = shade(rho[rows], self.trust, rays, self.texture, target_from_source, self.frames.size[0])
            colour[rows] = expose(shaded, exposure)
        return Shown(colour, rho, torch.as_tensor(target_from_source.position, dtype=rho.dtype, device=rho.device))


class GpuPair:
    """Two surfaces between which frames are made.

    Args:
        first: of the first view.
        second: of the second view, made for the same frames.
        curve: how much brighter the second picture is than the first.
    """

    def __init__(self, first: GpuSurface, second: GpuSurface, curve: ExposureCurve) -> None:
        self.surfaces, self._curve, self._frames = (first, second), curve, first.frames
        self._nearest: Tensor | None = None

    @property
    def triangles(self) -> int:
        """How many are drawn for a frame."""
        return sum(surface.quads.triangles for surface in self.surfaces)

    @property
    def nearest(self) -> float:
        """The greatest inverse depth in the last frame, 1/metre; infinite before there is one."""
        return math.inf if self._nearest is None else float(self._nearest)

    @memory_of_device()
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

        Raises:
            OmnisynError: the device has no memory left.
        """
        poses = (target_from_first, target_from_second)
        first, second = (
            surface.seen_from(pose, self._exposure(t, end))
            for end, (surface, pose) in enumerate(zip(self.surfaces, poses, strict=True))
        )
        self._nearest = torch.maximum(first.inverse_depth.max(), second.inverse_depth.max())
        is_in_place = bool(np.abs(target_from_first.position - target_from_second.position).max() <= STILL)
        image = self._fused(first, second, t, is_in_place=is_in_place)
        torch.from_numpy(out).copy_(samples_of(image) if out.dtype == np.uint8 else image)

    def _exposure(self, t: float, end: int) -> Exposure | None:
        """What brings a view to the exposure of a share of the way; None where nothing changes."""
        if self._curve.is_identity or t == end:
            return None
        table = self._curve.table(t, of_second=end == 1)
        return Exposure(torch.from_numpy(table).to(self._frames.device), float(loss_of_white(table)))

    def _fused(self, first: Shown, second: Shown, t: float, *, is_in_place: bool) -> Float32[Tensor, "height width 3"]:
        """The picture, ghosts silenced and holes filled, see :class:`omnisyn_cli.fusion.GeometricFuser`."""
        frames, options = self._frames, self._frames.options
        strictness = hiding_strength(t, options.ends)
        rule = BlendRule(t, options.disagreement, options.hidden**strictness)
        losers = None
        if not is_in_place:
            one, other = (_crossings(view, frames.ghosts.rows, frames.ghosts.cols) for view in (first, second))
            losers = frames.ghosts.losers(one, other, t, strictness)
        image, weight = first.colour.new_empty((*frames.size, 3)), first.colour.new_empty(frames.size)
        for rows in frames.bands():
            one, other = (Shown(view.colour[rows], view.inverse_depth[rows], view.offset) for view in (first, second))
            if losers is not None:
                frames.ghosts.silence(one.colour, other.colour, losers, rows.start)
            image[rows], weight[rows] = blend(one, other, frames.rays(rows), rule)
        fill_holes(image, weight)
        return image


def _crossings(view: Shown, rows: Tensor, cols: Tensor) -> Shown:
    """A rendering where some rows and columns cross."""
    return Shown(view.colour[rows][:, cols], view.inverse_depth[rows][:, cols], view.offset)
