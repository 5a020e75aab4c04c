"""Places for frames on the command line: what ends in a slash is a folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    PathType = click.ParamType[Path]
else:
    PathType = click.ParamType  # older releases of click have no generic one

__all__ = ["FramePlace"]

SEPARATORS = tuple(filter(None, (os.sep, os.altsep)))


class FramePlace(PathType):
    """A video, a folder or a pattern. ``Path`` drops the slash of ``walk.final/``, without which that is a file."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; for a folder with a dot in its name, the pattern of what comes into it."""
        path = Path(value)
        is_folder = str(value).endswith(SEPARATORS) and path.suffix != ""
        return path / "%06d" if is_folder else path
