"""How two renderings become one frame: the registry of fusions, each with its fuser and the memory that it takes.

A new fusion is its fuser's module and a row of :data:`FUSIONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from omnisyn_cli.pipeline.choices import by_name, chosen

if TYPE_CHECKING:
    from omnisyn_cli.types import Fuser

MAX_PAINTED_PIXELS = 2 * 1024**2  # of the largest picture that a network paints; larger frames are enlarged


@dataclass(frozen=True)
class FuserSettings:
    """What a fuser is made for: (height, width) of frames, threads at most (None is one per core).

    A network that corrects the rules looks at so many rows at most; pixels at edges are supersampled where that goes.
    """

    size: tuple[int, int]
    threads: int | None = None
    rows: int = 96
    edges: bool = True


@dataclass(frozen=True)
class FusionStrategy:
    """A way to make one frame of two renderings."""

    name: str
    help: str  # for that of ``--fusion``
    # makes the fuser of its settings and a function that opens its network
    make: Callable[[FuserSettings, Callable[[], Any]], Fuser]
    model: str | None = None  # name in the manifest of its network; None has none
    network_bytes: Callable[[int], float] = lambda pixels: 0.0  # memory of the network for a frame of so many pixels
    by_rules: bool = True  # whether the blend rule decides: ghosts are removed and pixels at edges can be supersampled
    is_residual: bool = False  # whether a network corrects that rule


def _make_geometric(settings: FuserSettings, network: Callable[[], Any]) -> Fuser:
    from omnisyn_cli.fusion.geometric import GeometricFuser

    return GeometricFuser(settings.size, threads=settings.threads, edges=settings.edges)


def _make_residual(settings: FuserSettings, network: Callable[[], Any]) -> Fuser:
    from omnisyn_cli.fusion.residual import ResidualFuser
    from omnisyn_cli.runtime.image_networks import FusionSession

    session = FusionSession(network(), "shares")
    return ResidualFuser(settings.size, session, settings.rows, threads=settings.threads, edges=settings.edges)


def _make_direct(settings: FuserSettings, network: Callable[[], Any]) -> Fuser:
    from omnisyn_cli.baselines.direct_fuser import DirectFuser
    from omnisyn_cli.runtime.image_networks import FusionSession

    return DirectFuser(settings.size, FusionSession(network(), "colour"), threads=settings.threads)


# By name, the default first. Memory was measured as the peak of runs that differ in nothing else.
FUSIONS: Mapping[str, FusionStrategy] = by_name(
    FusionStrategy("geometric", "a visibility rule", _make_geometric),
    FusionStrategy(
        "network", "the rule, corrected by a network", _make_residual, "fusion-residual",
        network_bytes=lambda pixels: 50e6, is_residual=True,
    ),
    FusionStrategy(
        "painting", "a network, as in the paper", _make_direct, "fusion-paper-narrow",
        network_bytes=lambda pixels: 230.0 * min(pixels, MAX_PAINTED_PIXELS), by_rules=False,
    ),
)  # fmt: skip


def make_fuser(name: str, settings: FuserSettings, *, model: str | None = None, device: str = "auto") -> Fuser:
    """Of :data:`FUSIONS`, with its or another ``model``. ValueError: unknown name; InputError: it does not load."""
    fusion = chosen(FUSIONS, name, "fusion")

    def open_network() -> Any:
        from omnisyn_cli.runtime.session import open_model

        return open_model(model or fusion.model or "", device=device, threads=settings.threads)

    return fusion.make(settings, open_network)
