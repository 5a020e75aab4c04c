"""How much time accuracy is worth: named bundles of settings, from fast to accurate; and the paper's own method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = [
    "DEFAULT_PRESET",
    "FUSIONS",
    "FUSION_CHOICES",
    "FUSION_MODELS",
    "METHODS",
    "OMNISYN",
    "PRESETS",
    "REPRODUCTIONS",
    "SCALE",
    "SYNSIN_MODELS",
    "SYNSIN_SOURCES",
    "Preset",
]


@dataclass(frozen=True)
class Preset:
    """Settings that are chosen together.

    Attributes:
        name: what users call it.
        summary: one line for them.
        depth_rows: rows that depth is looked for at, see :mod:`omnisyn_cli.estimators`; estimates have half of them,
            or as many where a network finds depth alone.
        fusion: how renderings with depth of that kind become one picture, one of :data:`FUSIONS`.
        depth: where depth comes from unless files have it, see :mod:`omnisyn_cli.estimators`.
        model: network that refines or replaces matching, by its name in the manifest; None where there is none.
        renderer: how surfaces are drawn, see :mod:`omnisyn_cli.render.renderer`.
        cut_metres: step of depth at which surfaces are cut; None where that is relative, see
            :class:`omnisyn_cli.render.mesh.Cut`.
    """

    name: str
    summary: str
    depth_rows: int
    fusion: str
    depth: str = "refined"
    model: str | None = "refine-balanced"
    renderer: str = "mesh"
    cut_metres: float | None = None


def _by_name(*presets: Preset) -> Mapping[str, Preset]:
    return MappingProxyType({preset.name: preset for preset in presets})


SCALE: Mapping[str, Preset] = _by_name(
    Preset("fast", "matching at ¾ of the size, refined by a network", 384, "geometric"),
    Preset("balanced", "matching, refined by a network, sharpened at twice the size", 1024, "geometric"),
    Preset("accurate", "sharpened once more at four times the size; a network fuses", 2048, "network"),
)
"""By name, from the fastest to the most accurate."""

REPRODUCTIONS: Mapping[str, Preset] = _by_name(
    Preset(
        "paper", "the method of the paper with narrower networks, to compare with; far less accurate", 256, "painting",
        depth="network", model="depth-paper-narrow", renderer="two-pass", cut_metres=2.0,
    ),
)  # fmt: skip
"""By name: what others do, to compare with. They have no place on the scale, and no budget of time chooses them."""

PRESETS: Mapping[str, Preset] = MappingProxyType({**SCALE, **REPRODUCTIONS})
"""By name: those of :data:`SCALE` in their order, then :data:`REPRODUCTIONS`."""

DEFAULT_PRESET = "balanced"

FUSIONS = ("geometric", "network", "painting")
"""How two renderings become one picture, see :mod:`omnisyn_cli.fusers`."""

FUSION_CHOICES = ("auto", *FUSIONS)
"""What users choose from: ``auto`` is the preset's where depth is estimated, and geometric where it is known."""

FUSION_MODELS: Mapping[str, str] = MappingProxyType({"network": "fusion-residual", "painting": "fusion-paper-narrow"})
"""Name in the manifest of the network that has a part in a fusion."""

OMNISYN = "omnisyn"

METHODS = (OMNISYN, "synsin", "synsin-2view")
"""How frames are made: this program's way or, to compare it with, SynSin from the nearer panorama or from both."""

SYNSIN_MODELS = ("synsin-depth", "synsin-encoder", "synsin-decoder")
"""Names of SynSin's networks in the manifest; the first finds depth in one panorama."""

SYNSIN_SOURCES: Mapping[str, int] = MappingProxyType({"synsin": 1, "synsin-2view": 2})
"""How many panoramas a frame is made of, by method."""
