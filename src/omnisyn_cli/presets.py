"""How much time accuracy is worth: named bundles of settings, from fast to accurate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["DEFAULT_FUSION", "DEFAULT_PRESET", "FUSIONS", "FUSION_MODEL", "PRESETS", "Preset"]


@dataclass(frozen=True)
class Preset:
    """Settings that are chosen together.

    Attributes:
        name: what users call it.
        summary: one line for them.
        depth: where depth comes from unless files have it, see :mod:`omnisyn_cli.estimators`.
        depth_rows: rows that matching works towards.
        model: network that refines or replaces matching, by its name in the manifest; None where there is none.
    """

    name: str
    summary: str
    depth: str
    depth_rows: int
    model: str | None


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        preset.name: preset
        for preset in (
            Preset("fast", "matching at ¾ of the size, refined by a network", "refined", 384, "refine-balanced"),
            Preset("balanced", "matching, refined by a network", "refined", 512, "refine-balanced"),
            Preset("accurate", "matching at twice the size, refined by a network", "refined", 1024, "refine-balanced"),
        )
    }
)
"""By name, from the fastest to the most accurate."""

DEFAULT_PRESET = "balanced"

FUSIONS = ("geometric", "network")
"""How two renderings become one picture, see :mod:`omnisyn_cli.fusers`."""

DEFAULT_FUSION = "geometric"

FUSION_MODEL = "fusion-residual"
"""Name of the fusion network in the manifest."""
