"""Places for frames on the command line: what ends in a slash is a folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

__all__ = ["FramePlace"]

SEPARATORS = tuple(filter(None, (os.sep, os.altsep)))


class FramePlace(click.Path):
    """A video, a folder or a pattern. ``Path`` drops the slash of ``walk.final/``, without which that is a file."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; for a folder with a dot in its name, the pattern of what comes into it."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        is_folder = str(value).endswith(SEPARATORS) and path.suffix != ""
        return path / "%06d" if is_folder else path
