"""Errors and depth in colours, and the pictures of a report: frames, truths, errors and depth as JPEG files."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from omnisyn_cli.evaluation.datasets import Pair
from omnisyn_cli.evaluation.measure import Measurement
from omnisyn_cli.evaluation.metrics.image import check_same_size
from omnisyn_cli.evaluation.results import DepthRecord, UnitRecord
from omnisyn_cli.evaluation.views import LoadedPair
from omnisyn_cli.io import write_image
from omnisyn_cli.io.outputs import write_errors
from omnisyn_cli.types import DepthEstimate

ERROR_SCALE = 0.25
"""Mean absolute difference of the channels that has the brightest colour; fixed, so that maps can be compared."""

NEAREST_PERCENTILE = 99.0
"""Percentile of inverse depth that has the last colour: a few stray near pixels do not darken all the others."""

KIND_COLOURS = {
    "agree": (255, 255, 255),
    "disagree": (255, 80, 255),
    "one_view": (255, 190, 40),
    "hole": (60, 200, 255),
}
"""RGB of the largest error of each kind: white, magenta, orange, blue."""

KIND_MIN_BRIGHTNESS = 0.15
"""Brightness without any error, so that the area of a kind is seen as well."""

PICTURES_FOLDER = "pictures"
"""In the folder of a report."""

MAX_NAME_CHARS = 80
"""Of a scene in a file name: file systems take 255 bytes for all of it."""


def error_map(
    image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Mean difference of the channels in the Inferno colours: black 0, pale yellow :data:`ERROR_SCALE` or more.

    Both are RGB in [0, 1]; ValueError: they differ in size.
    """
    return _coloured(_error_share(image, truth), cv2.COLORMAP_INFERNO)


def kind_map(
    image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"],
    kinds: Mapping[str, Bool[np.ndarray, "height width"]],
) -> UInt8[np.ndarray, "height width 3"]:  # fmt: skip
    """The error as of :func:`error_map`, as brightness of the colour of its kind of pixel, :data:`KIND_COLOURS`.

    ``kinds`` says where pixels of each kind are; those without a colour are not shown.
    """
    brightness = KIND_MIN_BRIGHTNESS + (1.0 - KIND_MIN_BRIGHTNESS) * np.clip(_error_share(image, truth), 0.0, 1.0)
    colour = np.zeros(image.shape)
    for kind, of_kind in KIND_COLOURS.items():
        colour[kinds[kind]] = of_kind
    return np.asarray(np.rint(brightness[..., None] * colour), np.uint8)


def _error_share(
    image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]
) -> Float[np.ndarray, "height width"]:
    """Mean difference of the channels, 1 where it is :data:`ERROR_SCALE`."""
    check_same_size(image, truth)
    return np.asarray(np.abs(image.astype(np.float32) - truth).mean(axis=-1) / ERROR_SCALE)


def turbo(
    inverse_depth: Float[np.ndarray, "height width"], *, largest: float | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Inverse depth in the Turbo colours: red is near, dark blue infinitely far, black unknown (negative or NaN).

    The colour is that of the square root of ``inverse_depth / largest``, so that far surfaces differ as well.

    Args:
        inverse_depth: 1/m.
        largest: inverse depth that has the last colour; give both of two pictures that are to be compared the same.
            By default the 99th percentile of what is positive and finite, else 1.

    Source of the colours: Mikhailov, Turbo, an improved rainbow colormap for visualization, 2019.
    """
    known = np.nan_to_num(inverse_depth, nan=-1.0) >= 0
    largest = _nearest_shown(inverse_depth) if largest is None else largest
    share = np.where(known, inverse_depth, 0.0) / largest
    coloured = _coloured(np.sqrt(np.clip(share, 0.0, 1.0)), cv2.COLORMAP_TURBO)
    return np.where(known[..., None], coloured, np.uint8(0))


def _nearest_shown(inverse_depth: Float[np.ndarray, "height width"]) -> float:
    positive = inverse_depth[(inverse_depth > 0) & np.isfinite(inverse_depth)]
    return float(np.percentile(positive, NEAREST_PERCENTILE)) if positive.size else 1.0


def _coloured(share: np.ndarray, colours: int) -> np.ndarray:
    """RGB of values in [0, 1]; beyond, the last colour."""
    level = np.rint(np.clip(share, 0.0, 1.0) * 255.0).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(level, colours)[..., ::-1])


class PictureWriter:
    """Writes the pictures of one method on one pair below ``pictures`` in a report and says where they are."""

    def __init__(self, report: Path, pair: Pair, method: str) -> None:
        self._report, self._method = report, _slug(method)
        self._pair = _slug("/".join((pair.scene, pair.first.name, pair.second.name)))

    def frames(self, pair: LoadedPair, made: Measurement) -> list[dict[str, str]]:
        """``frame``, ``truth``, ``error`` and, where all kinds are known, ``kinds``; without true frames ``frame``."""
        if not pair.truths:
            return [{"frame": self._write(self._method, pair.targets[0].name, made.images[0])}]
        found = []
        for truth, image, kinds in zip(pair.truths, made.images, made.kinds, strict=True):
            pictures = {
                "frame": self._write(self._method, truth.name, image),
                "truth": self._write("truth", truth.name, truth.image),
                "error": self._write(self._method, f"{truth.name}-error", error_map(image, truth.image)),
            }
            if KIND_COLOURS.keys() <= kinds.keys():
                shown = kind_map(image, truth.image, kinds)
                pictures["kinds"] = self._write(self._method, f"{truth.name}-kinds", shown)
            found.append(pictures)
        return found

    def depths(self, pair: LoadedPair, made: Measurement) -> tuple[DepthRecord, ...]:
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
        return {
            "depth": self._write(self._method, title, turbo(found, largest=_nearest_shown(truth))),
            "truth": self._write("truth", title, turbo(truth)),
        }

    def _write(self, owner: str, title: str, image: np.ndarray) -> str:
        """Write a picture; its name relative to the report."""
        path = Path(PICTURES_FOLDER, self._pair, owner, f"{_slug(title)}.jpg")
        folder = (self._report / path).parent
        with write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        write_image(self._report / path, image)
        return path.as_posix()


def has_all_pictures(report: Path, record: UnitRecord) -> bool:
    """Whether every picture that a record names is still there."""
    shown = [part.pictures for parts in (record.frames, record.depths) for part in parts]
    return all((report / path).is_file() for pictures in shown for path in pictures.values())


def _slug(name: str) -> str:
    """A file name that every system takes; names that had to be changed get a hash, so that they stay different."""
    safe = re.sub(r"[^A-Za-z0-9._-]+", "_", name).lstrip(".")[:MAX_NAME_CHARS]
    return safe if safe == name else f"{safe}-{hashlib.sha256(name.encode('utf-8', 'replace')).hexdigest()[:8]}"
