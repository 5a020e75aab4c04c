"""What the configurations of all networks have in common."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Self

__all__ = ["NetworkConfig"]


@dataclass(frozen=True)
class NetworkConfig:
    """What makes one network differ from another: plain values and tuples of them."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """The inverse of :meth:`as_dict`; unknown and missing keys are errors."""
        return cls(**{key: tuple(v) if isinstance(v, list) else v for key, v in values.items()})
