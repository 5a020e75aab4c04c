"""The pictures of a report: frames, truths, errors and depth, as JPEG below ``pictures``."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import WriteError
from omnisyn_cli.evaluation.datasets import Pair
from omnisyn_cli.evaluation.measure import Measurement
from omnisyn_cli.evaluation.pictures import error_map, nearest_shown, turbo
from omnisyn_cli.evaluation.records import DepthRecord, UnitRecord
from omnisyn_cli.evaluation.views import LoadedPair
from omnisyn_cli.io import write_image
from omnisyn_cli.types import DepthEstimate

__all__ = ["Album", "has_all_pictures"]

FOLDER = "pictures"

LONGEST_NAME = 80


class Album:
    """Writes the pictures of one method on one pair into the folder of a report and says where they are."""

    def __init__(self, report: Path, pair: Pair, method: str) -> None:
        self._report, self._method = report, _slug(method)
        self._pair = _slug("/".join((pair.scene, pair.first.name, pair.second.name)))

    def of_frames(self, pair: LoadedPair, made: Measurement) -> list[dict[str, str]]:
        """``frame``, ``truth`` and ``error`` of every true frame."""
        return [
            {
                "frame": self._write(self._method, truth.name, image),
                "truth": self._write("truth", truth.name, truth.image),
                "error": self._write(self._method, f"{truth.name}-error", error_map(image, truth.image)),
            }
            for truth, image in zip(pair.truths, made.images, strict=True)
        ]

    def of_depths(self, pair: LoadedPair, made: Measurement) -> tuple[DepthRecord, ...]:
        """The depth records of a measurement with the picture ``depth`` and, where it is known, ``truth``."""
        if made.found is None:
            return made.depths
        return tuple(
            replace(record, pictures=self._depth_pictures(record.view, found.inverse_depth, view.known_depth))
            for record, found, view in zip(made.depths, made.found, pair.views, strict=True)
        )

    def _depth_pictures(self, view: str, found: np.ndarray, known: DepthEstimate | None) -> dict[str, str]:
        """Both in the same colours, those of the truth."""
        title = f"{view}-depth"
        if known is None or not (known.inverse_depth > 0).any():
            return {"depth": self._write(self._method, title, turbo(found))}
        truth = known.inverse_depth
        largest = nearest_shown(truth)
        return {
            "depth": self._write(self._method, title, turbo(found, largest=largest)),
            "truth": self._write("truth", title, turbo(truth, largest=largest)),
        }

    def _write(self, owner: str, title: str, image: np.ndarray) -> str:
        """Write a picture; its place relative to the report."""
        path = Path(FOLDER, self._pair, owner, f"{_slug(title)}.jpg")
        folder = (self._report / path).parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"{folder}: expected to make it, got '{error.strerror}'; check the disk") from error
        write_image(self._report / path, image)
        return path.as_posix()


def has_all_pictures(report: Path, record: UnitRecord) -> bool:
    """Whether every picture that a record names is still there."""
    return all((report / path).is_file() for path in _pictures(record))


def _pictures(record: UnitRecord) -> Iterator[str]:
    for shown in (part.pictures for parts in (record.frames, record.depths) for part in parts):
        yield from shown.values()


def _slug(name: str) -> str:
    """A file name that every system takes; names that had to be changed get a hash, so that they stay different."""
    safe = re.sub(r"[^A-Za-z0-9._-]+", "_", name).lstrip(".")[:LONGEST_NAME]
    return safe if safe == name else f"{safe}-{hashlib.sha256(name.encode('utf-8', 'replace')).hexdigest()[:8]}"
