"""What a result depends on, as a hash: files, poses, method, options and the version of the program."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omnisyn_cli import __version__
from omnisyn_cli.errors import ImageError
from omnisyn_cli.evaluation.datasets import Pair

__all__ = ["Fingerprints"]

FORM = 1
"""Counts up when the same inputs are measured or recorded in another way."""


class Fingerprints:
    """Hashes of units; every file is read once."""

    def __init__(self) -> None:
        self._files: dict[Path, str] = {}

    def of(self, pair: Pair, method: Sequence[str], options: Mapping[str, Any]) -> str:
        """Hexadecimal digest of everything that the result of a method on a pair depends on.

        Args:
            pair: files and poses.
            method: its name and ingredients.
            options: what else was asked for, plain values.

        Raises:
            ImageError: a file is missing or cannot be read.
        """
        frames = [
            [frame.name, frame.pose.position.tolist(), frame.pose.rotation.tolist(), *map(self.of_file, frame.files)]
            for frame in (pair.first, pair.second, *pair.between)
        ]
        described = [FORM, __version__, list(method), dict(options), frames]
        return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()

    def of_file(self, path: Path) -> str:
        """Hexadecimal digest of a file's content.

        Raises:
            ImageError: it is missing or cannot be read.
        """
        if path not in self._files:
            try:
                with path.open("rb") as file:
                    self._files[path] = hashlib.file_digest(file, "sha256").hexdigest()
            except OSError as error:
                raise ImageError(f"{path}: expected a file, got '{error.strerror}'; check the scene") from error
        return self._files[path]
