"""Numbers on the command line: within their range, and neither NaN nor infinite."""

from __future__ import annotations

import math
from typing import Any

import click

__all__ = ["FiniteRange", "FrameRate", "WholeRange"]


class FiniteRange(click.FloatRange):
    """A range without NaN, which compares with nothing and so lies in all of click's, and without infinity."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """A finite number in the range."""
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"expected a finite number, got {value}", param, ctx)
        return number


class WholeRange(click.IntRange):
    """A range of integers, called by what is in it: click says of a word that it is no valid integer range."""

    name = "integer"


class FrameRate(FiniteRange):
    """Frames per second, at most 1000, as a number or, as television has them, as a fraction: ``30000/1001``."""

    name = "rate"

    def __init__(self) -> None:
        super().__init__(0, 1000, min_open=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The rate as a number."""
        if not isinstance(value, str) or "/" not in value:
            return super().convert(value, param, ctx)
        try:
            frames, seconds = (int(part) for part in value.split("/"))
            rate = frames / seconds
        except (ValueError, ArithmeticError):
            self.fail(f"expected frames per second such as 30 or 30000/1001, got {value!r:.40}", param, ctx)
        return super().convert(rate, param, ctx)
