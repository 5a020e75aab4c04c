"""How a name is looked up in a registry."""

from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")


def chosen(registry: Mapping[str, T], name: str, what: str) -> T:
    """What a registry has of a name; ValueError for an unknown one."""
    if name not in registry:
        raise ValueError(f"expected a {what} of {', '.join(registry)}, got {name!r}")
    return registry[name]
