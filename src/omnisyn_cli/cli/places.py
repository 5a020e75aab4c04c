"""Names of files and folders on the command line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

__all__ = ["FilePath", "FramePlace"]

SEPARATORS = tuple(filter(None, (os.sep, os.altsep)))


class FilePath(click.Path):
    """A file or folder. ``Path`` takes an empty name, as of a variable that the shell has not set, for this folder."""

    def __init__(self, *, exists: bool = False, file_okay: bool = True, dir_okay: bool = True) -> None:
        super().__init__(exists, file_okay, dir_okay, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path."""
        if os.fsdecode(value) == "":
            self.fail("expected the name of a file or folder, got an empty one", param, ctx)
        return Path(os.fsdecode(super().convert(value, param, ctx)))


class FramePlace(FilePath):
    """A video, a folder or a pattern. ``Path`` drops the slash of ``walk.final/``, without which that is a file."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; for a folder with a dot in its name, the pattern of what comes into it."""
        path = super().convert(value, param, ctx)
        is_folder = str(value).endswith(SEPARATORS) and path.suffix != ""
        return path / "%06d" if is_folder else path
