"""How much time accuracy is worth: named bundles of settings, from fast to accurate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["DEFAULT_PRESET", "FUSIONS", "FUSION_CHOICES", "FUSION_MODEL", "PRESETS", "Preset"]


@dataclass(frozen=True)
class Preset:
    """Settings that are chosen together.

    Attributes:
        name: what users call it.
        summary: one line for them.
        depth_rows: rows that depth is looked for at, see :mod:`omnisyn_cli.estimators`; estimates have half of them.
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
            Preset("balanced", "matching, refined by a network, sharpened at twice the size", 1024, "geometric"),
            Preset("accurate", "sharpened once more at four times the size; a network fuses", 2048, "network"),
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
