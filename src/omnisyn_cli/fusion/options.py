"""What decides between two views, for everything that blends them or foresees how they will be blended."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BlendOptions"]


@dataclass(frozen=True)
class BlendOptions:
    """What decides between two views that see different things.

    Attributes:
        disagreement: relative difference of inverse depth at which the farther surface has lost most of its weight.
        hidden: the least share of its weight that a hidden surface keeps.
        ends: share of the way at either end over which the rule sets in, so that nothing pops up next to an end.
    """

    disagreement: float = 0.06
    hidden: float = 0.003
    ends: float = 0.1
