"""What options take: numbers that are finite and within their range, names of files, sizes."""

import math
import os
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.pipeline.config import frame_size


class FiniteRange(click.FloatRange):
    """A range without NaN, which compares with nothing and so lies in all of click's, and without infinity."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """A finite number in the range."""
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"expected a finite number, got {value}", param, ctx)
        return number


class Seconds(FiniteRange):
    """Seconds as a number, or with an s behind it."""

    name = "seconds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The seconds."""
        return super().convert(value.removesuffix("s") if isinstance(value, str) else value, param, ctx)


class DegreeRange(FiniteRange):
    """Degrees on the command line, radians in the program."""

    name = "degrees"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The angle in radians."""
        return math.radians(super().convert(value, param, ctx))


class NadirRange(DegreeRange):
    """The same; ``auto`` is None."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The angle, or None."""
        return None if value in ("auto", None) else super().convert(value, param, ctx)


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


class FilePath(click.Path):
    """A file or folder. ``Path`` takes an empty name, as of a variable that the shell has not set, for this folder."""

    def __init__(self, *, file_okay: bool = True, dir_okay: bool = True) -> None:
        super().__init__(file_okay=file_okay, dir_okay=dir_okay, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path."""
        if os.fsdecode(value) == "":
            self.fail("expected the name of a file or folder, got an empty one", param, ctx)
        return Path(os.fsdecode(super().convert(value, param, ctx)))


FOLDER, FILE = FilePath(file_okay=False), FilePath(dir_okay=False)  # any path that is no file, or no folder


class FramePlace(FilePath):
    """A video, a folder or a pattern. ``Path`` drops the slash of ``walk.final/``, without which that is a file."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; for a folder with a dot in its name, the pattern of what comes into it."""
        path = super().convert(value, param, ctx)
        is_folder = str(value).endswith((os.sep, os.altsep or os.sep)) and path.suffix != ""
        return path / "%06d" if is_folder else path


class Size(click.ParamType):  # type: ignore[type-arg]
    """``WIDTHxHEIGHT`` on the command line, ``(height, width)`` in the program; twice as wide as high unless free."""

    name = "WxH"

    def __init__(self, *, is_free: bool = False) -> None:
        self._is_free = is_free

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Two positive numbers."""
        if isinstance(value, tuple):
            return value
        width, _, height = str(value).lower().partition("x")
        if self._is_free and width.isdecimal() and height.isdecimal() and int(width) * int(height) > 0:
            return int(height), int(width)
        if self._is_free:
            self.fail(f"expected WIDTHxHEIGHT, such as 2048x1024 or a flat 1920x1080, got {value!r}", param, ctx)
        try:
            return frame_size(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)
