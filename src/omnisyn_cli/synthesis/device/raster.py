"""The exact equirectangular rasteriser for arrays: quads × the pixels of their boxes, and one maximum per pixel.

The rule is that of :mod:`omnisyn_cli.render.rasterize`, quads are split as in :mod:`omnisyn_cli.render.quad_kernels`.
All of it is float64: the work is reading and writing memory, on a GPU too, and nothing has to be done twice where
float32 would be too coarse. The nearest surface is the maximum of the inverse depths; that does not depend on the order
in which pixels are visited, so neither does the picture.

Memory: 1 kB for each of :data:`QUADS_PER_STEP` quads, 0.3 kB for each of :data:`CANDIDATES_PER_STEP` pixels in boxes,
24 bytes for every point of the mesh and 4 for every pixel of the target.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32, Integer
from torch import Tensor

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables, pixel_scale
from omnisyn_cli.render.box_kernels import WIDE_QUAD_RADIANS
from omnisyn_cli.render.quad_kernels import EDGE_ON_DETERMINANT, split_quad
from omnisyn_cli.synthesis.device.quads import Quads

MIN_POLE_SINE = 1e-8
"""A point that is less than this (radians) from a pole of the target has no azimuth of its own."""

QUADS_PER_STEP = 1 << 18
CANDIDATES_PER_STEP = 1 << 21
"""Quads, and pixels to be tested, of a step: they bound its memory. Set by hand."""

EDGE_OVERLAP_RADIANS = 1e-9
"""Radians by which edges are moved outwards, far beyond rounding: no gap opens between neighbours or at a vertex."""

BOX_MARGIN_PIXELS = 1e-3
"""Pixels added around boxes, for what is moved outwards and for rounding."""


@dataclass(frozen=True)
class _QuadSetup:
    """Quads as their rays see them.

    Attributes:
        cut: the edge between both triangles, not negative on the side of the first, and by how much it is moved.
        triangle: of both: left or right edge, top or bottom edge, plane, and by how much each edge is moved.
        is_seen: whether either triangle is seen from its front.
    """

    cut: Float[Tensor, "quads 4"]
    triangle: Float[Tensor, "quads 2 11"]
    is_seen: Tensor


@dataclass(frozen=True)
class _Boxes:
    """Pixels in which quads are looked for; columns may lie outside the image."""

    row: Integer[Tensor, " quads"]
    col: Integer[Tensor, " quads"]
    rows: Integer[Tensor, " quads"]
    cols: Integer[Tensor, " quads"]


class GpuRasterizer:
    """Tables for one target size on one device; what it answers is the caller's."""

    def __init__(self, size: tuple[int, int], device: torch.device) -> None:
        self.size, self.device = size, device
        self._tables = tuple(torch.from_numpy(table).to(device) for table in direction_tables(*size))
        self._scale = pixel_scale(size)

    def __call__(self, quads: Quads, target_from_source: Pose) -> Float32[Tensor, "height width"]:
        """Inverse depth at every pixel of the target, 1/metre, negative where nothing is seen.

        Args:
            quads: on this device.
            target_from_source: rigid transform from the panorama's camera frame to the target's.
        """
        rotation = torch.as_tensor(target_from_source.rotation).to(quads.direction)
        position = torch.as_tensor(target_from_source.position).to(quads.direction)
        points = quads.direction @ rotation.T + quads.inverse_depth[:, None] * position
        nearest = torch.full((self.size[0] * self.size[1],), -1.0, device=self.device)
        for begin in range(0, len(quads.corner), QUADS_PER_STEP):
            corner = quads.corner[begin : begin + QUADS_PER_STEP]
            corners = points[corner]
            plan = _set_up_quads(corners, quads.inverse_depth[corner])
            self._draw(plan, self._boxes(corners), nearest)
        return nearest.reshape(self.size)

    def _draw(self, plan: _QuadSetup, boxes: _Boxes, nearest: Tensor) -> None:
        """Write the greater of ``nearest`` and the inverse depths of these quads."""
        sin_p, cos_p, sin_a, cos_a = self._tables
        triangles = plan.triangle.reshape(-1, 11)
        for quad, row, col in self._candidates(boxes, plan.is_seen):
            sine = sin_p[row]
            ray = (sine * sin_a[col], cos_p[row], -sine * cos_a[col])
            cut = plan.cut[quad]
            which = 2 * quad + (_dot(ray, cut[:, :3]) + cut[:, 3] < 0.0)
            triangle = triangles[which]
            is_hit = _dot(ray, triangle[:, :3]) >= triangle[:, 9]
            is_hit &= _dot(ray, triangle[:, 3:6]) >= triangle[:, 10]
            seen = _dot(ray, triangle[:, 6:9])[is_hit].clamp_min(0.0).to(torch.float32)
            nearest.scatter_reduce_(0, (row * self.size[1] + col)[is_hit], seen, "amax")

    def _candidates(self, boxes: _Boxes, is_seen: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Quad, row and column of every pixel in the boxes of quads that are seen, some at a time.

        Their number is all that comes to the host.
        """
        area = torch.where(is_seen, boxes.rows * boxes.cols, 0)
        ends = area.cumsum(0)
        begins, total = ends - area, int(ends[-1])
        for begin in range(0, total, CANDIDATES_PER_STEP):
            number = torch.arange(begin, min(begin + CANDIDATES_PER_STEP, total), device=self.device)
            quad = torch.searchsorted(ends, number, right=True)
            number, cols = number - begins[quad], boxes.cols[quad]
            down = torch.div(number, cols, rounding_mode="floor")
            yield quad, boxes.row[quad] + down, (boxes.col[quad] + number - down * cols) % self.size[1]

    def _boxes(self, corners: Float[Tensor, "quads 4 3"]) -> _Boxes:
        """Boxes around quads on the sphere, see :mod:`omnisyn_cli.render.box_kernels`."""
        height, width = self.size
        row_scale, row_zero, col_scale, col_zero = self._scale
        x, y, z = corners.unbind(-1)
        row = torch.atan2(torch.hypot(x, z), y) * row_scale + row_zero
        col = torch.atan2(x, -z) * col_scale + col_zero
        is_pole = torch.maximum(x.abs(), z.abs()) <= MIN_POLE_SINE * y.abs()
        col = torch.where(is_pole, col.roll(2, dims=1), col)
        turn = col - col[:, :1]
        turn = turn - width * torch.round(turn / width)
        left, right = turn.amin(1), turn.amax(1)
        top, bottom, is_wide = self._row_range(row.amin(1), row.amax(1), (right - left) / col_scale)
        first = torch.where(is_wide, 0.0, torch.ceil(col[:, 0] + left - BOX_MARGIN_PIXELS))
        last = torch.where(is_wide, width - 1.0, torch.floor(col[:, 0] + right + BOX_MARGIN_PIXELS))
        return _Boxes(
            top.to(torch.int64), first.to(torch.int64),
            (bottom - top + 1.0).clamp(0.0, height).to(torch.int64),
            (last - first + 1.0).clamp(0.0, width).to(torch.int64),
        )  # fmt: skip

    def _row_range(self, low: Tensor, high: Tensor, span: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """First and last row of quads with corners between two rows, so many radians wide, and whether that is wide.

        A great circle bulges towards the nearer pole, by at most ``span²/16`` radians where the span is narrow; wide
        arcs between two northern points stay north of the southernmost.
        """
        height = self.size[0]
        middle = 0.5 * height - 0.5
        is_wide = span >= WIDE_QUAD_RADIANS
        bulge = span * span * (self._scale[0] * 1.1 / 16.0) + BOX_MARGIN_PIXELS
        north = torch.where(low > middle, low - BOX_MARGIN_PIXELS, -1.0)
        south = torch.where(high < middle, high + BOX_MARGIN_PIXELS, float(height))
        first = torch.where(is_wide, north, low - bulge).ceil().clamp_min(0.0)
        last = torch.where(is_wide, south, high + bulge).floor().clamp_max(height - 1.0)
        return first, last, is_wide


def _set_up_quads(corners: Float[Tensor, "quads 4 3"], rho: Float[Tensor, "quads 4"]) -> _QuadSetup:
    """Edges and planes, see :mod:`omnisyn_cli.render.quad_kernels`."""
    points = ((*corners[:, k].unbind(-1), rho[:, k]) for k in range(4))
    cut, left, bottom, right, top, det_a, plane_a, det_b, plane_b = split_quad(*points)  # type: ignore[no-untyped-call]
    has_a, has_b = det_a > EDGE_ON_DETERMINANT, det_b > EDGE_ON_DETERMINANT
    shift = _gap_offset(cut) * (has_b.to(det_b) - has_a.to(det_a))  # towards the triangle that is not seen
    triangle = torch.stack([
        _triangle(left, bottom, plane_a, det_a, has_a), _triangle(right, top, plane_b, det_b, has_b)
    ], dim=1)  # fmt: skip
    return _QuadSetup(torch.stack([*cut, shift], dim=1), triangle, has_a | has_b)


Vector = tuple[Tensor, Tensor, Tensor]


def _triangle(side: Vector, other: Vector, plane: Vector, det: Tensor, is_seen: Tensor) -> Float[Tensor, "quads 11"]:
    """Two edges, a plane and the offsets of the edges; no ray passes those of a triangle that is not seen."""
    scale = torch.where(is_seen, det, 1.0)
    offsets = [torch.where(is_seen, _gap_offset(edge), math.inf) for edge in (side, other)]
    return torch.stack([*side, *other, *(number / scale for number in plane), *offsets], dim=1)


def _gap_offset(edge: Vector) -> Float[Tensor, " quads"]:
    """What a ray's product with an edge is compared with."""
    return -EDGE_OVERLAP_RADIANS * (edge[0].abs() + edge[1].abs() + edge[2].abs())


def _dot(ray: Vector, vector: Float[Tensor, "candidates 3"]) -> Float[Tensor, " candidates"]:
    x, y, z = vector.unbind(-1)
    return ray[0] * x + ray[1] * y + ray[2] * z
