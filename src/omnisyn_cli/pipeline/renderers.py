"""How surfaces are drawn: the registry of renderers, each with its class and the memory that it takes.

A new renderer is its class, see :class:`omnisyn_cli.render.renderer.RendererClass`, and a row of :data:`RENDERERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from omnisyn_cli.render.renderer import RendererClass


@dataclass(frozen=True)
class RendererStrategy:
    """A way to draw surfaces.

    Attributes:
        name: as users choose it.
        help: what it is, for the help of ``--renderer``.
        load: imports its class.
        building_bytes: memory for each vertex while surfaces are made.
        kept_bytes: memory for each vertex while frames are made.
        pixel_bytes: memory for each pixel of a frame of what one view shows, without colours.
        shades_on_demand: whether colours are made for some rows at a time, photographs are kept as samples of 8 bits,
            and pixels at edges can be supersampled.
    """

    name: str
    help: str
    load: Callable[[], RendererClass]
    building_bytes: float
    kept_bytes: float
    pixel_bytes: int = 4
    shades_on_demand: bool = False


def _mesh() -> RendererClass:
    from omnisyn_cli.render.renderer import MeshRenderer

    return MeshRenderer


def _two_pass() -> RendererClass:
    from omnisyn_cli.baselines.two_pass import TwoPassRenderer

    return TwoPassRenderer


def _points() -> RendererClass:
    from omnisyn_cli.baselines.points import PointRenderer

    return PointRenderer


RENDERERS: Mapping[str, RendererStrategy] = MappingProxyType({
    renderer.name: renderer
    for renderer in (
        RendererStrategy(
            "mesh", "exact rasterisation", _mesh, building_bytes=57, kept_bytes=57, shades_on_demand=True,
        ),
        RendererStrategy(
            "two-pass", "the rasteriser of the paper, a baseline", _two_pass, building_bytes=660, kept_bytes=150,
            pixel_bytes=8,
        ),
        RendererStrategy(
            "points", "a cloud of points, a baseline", _points, building_bytes=57, kept_bytes=57, pixel_bytes=100,
        ),
    )
})  # fmt: skip
"""By name, the default first. Memory was measured as the peak of runs that differ in nothing else."""
