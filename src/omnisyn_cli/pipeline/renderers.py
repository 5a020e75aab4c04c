"""How surfaces are drawn: the registry of renderers, each with its class and the memory that it takes.

A new renderer is its class, see :class:`omnisyn_cli.render.renderer.RendererClass`, and a row of :data:`RENDERERS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from omnisyn_cli.pipeline.choices import by_name

if TYPE_CHECKING:
    from omnisyn_cli.render.renderer import RendererClass


@dataclass(frozen=True)
class RendererStrategy:
    """A way to draw surfaces."""

    name: str
    help: str  # for that of ``--renderer``
    place: str  # module and name of its class, which is imported when it is asked for
    building_bytes: float  # memory for each vertex while surfaces are made
    kept_bytes: float  # memory for each vertex while frames are made
    pixel_bytes: int = 4  # memory for each pixel of a frame of what one view shows, without colours
    # whether colours are made for some rows at a time, photographs are kept as samples of 8 bits, and pixels at edges
    # can be supersampled
    shades_on_demand: bool = False

    def load(self) -> RendererClass:
        """Its class."""
        from pkgutil import resolve_name

        renderer: RendererClass = resolve_name(f"omnisyn_cli.{self.place}")
        return renderer


# By name, the default first. Memory was measured as the peak of runs that differ in nothing else.
RENDERERS: Mapping[str, RendererStrategy] = by_name(
    RendererStrategy(
        "mesh", "exact rasterisation", "render.renderer:MeshRenderer", building_bytes=57, kept_bytes=57,
        shades_on_demand=True,
    ),
    RendererStrategy(
        "two-pass", "the rasteriser of the paper, a baseline", "baselines.two_pass:TwoPassRenderer",
        building_bytes=660, kept_bytes=150, pixel_bytes=8,
    ),
    RendererStrategy(
        "points", "a cloud of points, a baseline", "baselines.points:PointRenderer", building_bytes=57, kept_bytes=57,
        pixel_bytes=100,
    ),
)  # fmt: skip
