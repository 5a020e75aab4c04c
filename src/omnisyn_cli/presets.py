"""How much time accuracy is worth: named bundles of settings, from fast to accurate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = [
    "DEFAULT_PRESET",
    "FUSIONS",
    "FUSION_CHOICES",
    "FUSION_MODEL",
    "METHODS",
    "OMNISYN",
    "PRESETS",
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
        depth_rows: rows that matching works towards.
        fusion: how renderings with depth of that kind become one picture, one of :data:`FUSIONS`.
        depth: where depth comes from unless files have it, see :mod:`omnisyn_cli.estimators`.
        model: network that refines or replaces matching, by its name in the manifest; None where there is none.
    """

    name: str
    summary: str
    depth_rows: int
    fusion: str
    depth: str = "refined"
    model: str | None = "refine-balanced"


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        preset.name: preset
        for preset in (
            Preset("fast", "matching at ¾ of the size, refined by a network", 384, "geometric"),
            Preset("balanced", "matching, refined by a network", 512, "geometric"),
            Preset("accurate", "matching at two sizes, refined by a network; another fuses", 1024, "network"),
        )
    }
)
"""By name, from the fastest to the most accurate."""

DEFAULT_PRESET = "balanced"

FUSIONS = ("geometric", "network")
"""How two renderings become one picture, see :mod:`omnisyn_cli.fusers`."""

FUSION_CHOICES = ("auto", *FUSIONS)
"""What users choose from: ``auto`` is the preset's where depth is estimated, and geometric where it is known."""

FUSION_MODEL = "fusion-residual"
"""Name of the fusion network in the manifest."""

OMNISYN = "omnisyn"

METHODS = (OMNISYN, "synsin", "synsin-2view")
"""How frames are made: this program's way or, to compare it with, SynSin from the nearer panorama or from both."""

SYNSIN_MODELS = ("synsin-depth", "synsin-encoder", "synsin-decoder")
"""Names of SynSin's networks in the manifest; the first finds depth in one panorama."""

SYNSIN_SOURCES: Mapping[str, int] = MappingProxyType({"synsin": 1, "synsin-2view": 2})
"""How many panoramas a frame is made of, by method."""
