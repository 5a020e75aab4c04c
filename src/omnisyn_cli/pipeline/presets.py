"""How much time accuracy is worth: configurations with a name, from fast to balanced; and the paper's own method."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from omnisyn_cli.pipeline.choices import by_name
from omnisyn_cli.pipeline.config import DepthSource, RunConfig


@dataclass(frozen=True)
class Preset:
    """A config for estimated depth, with time and quality in a few words (units: :mod:`omnisyn_cli.cli.options`)."""

    name: str
    summary: str
    config: RunConfig


def _refined(rows: int, prior: str | None = None, **changes: Any) -> RunConfig:
    depth = DepthSource("refined", rows, "completion-balanced", prior, descriptors="descriptors")
    return RunConfig(depth, adaptive=True, **changes)


# By name, from the fastest to the most accurate.
SCALE: Mapping[str, Preset] = by_name(
    Preset("fast", "10 s, 24.3 dB; for drafts", _refined(384, edges=False)),
    Preset("balanced", "29 s, 26.7 dB; the default", _refined(1024, "depth-guided", fusion="network")),
)
# By name: what others do, to compare with. They have no place on the scale, and no budget of time chooses them.
REPRODUCTIONS: Mapping[str, Preset] = by_name(
    Preset(
        "paper", "for comparison; less accurate than fast",
        RunConfig(
            DepthSource("network", 256, "depth-paper-narrow"), renderer="two-pass", cut=None, cut_metres=2.0,
            fusion="painting",
        ),
    ),
)  # fmt: skip
# By name: those of :data:`SCALE` in their order, then :data:`REPRODUCTIONS`.
PRESETS: Mapping[str, Preset] = MappingProxyType({**SCALE, **REPRODUCTIONS})
DEFAULT_PRESET = "balanced"  # taken where the user names none
