"""Registries: what users choose by its name."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol, TypeVar


class Named(Protocol):
    """What is called something."""

    @property
    def name(self) -> str:
        """As users choose it."""


T = TypeVar("T", bound=Named)


def by_name(*strategies: T) -> Mapping[str, T]:
    """A registry, in the order of the help."""
    return MappingProxyType({strategy.name: strategy for strategy in strategies})


def chosen(registry: Mapping[str, T], name: str, what: str) -> T:
    """What a registry has of a name; ValueError for an unknown one."""
    if name not in registry:
        raise ValueError(f"expected a {what} of {', '.join(registry)}, got {name!r}")
    return registry[name]
