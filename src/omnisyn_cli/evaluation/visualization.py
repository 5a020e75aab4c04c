"""Errors and depth in colours, and the pictures of a report: frames, truths, errors and depth as JPEG files.

The page of a report shows the worst frames of every method first, and depth beside the true depth: pictures are read
from the folder of the report, made small and put into the page itself.
"""

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from omnisyn_cli.evaluation.datasets.sources import Pair
from omnisyn_cli.evaluation.grouping import finished, pair_names, ranked_methods
from omnisyn_cli.evaluation.measure import Measurement
from omnisyn_cli.evaluation.metrics.image import Picture, check_same_size
from omnisyn_cli.evaluation.results import DepthRecord, FrameRecord, UnitRecord
from omnisyn_cli.evaluation.tables import format_value
from omnisyn_cli.evaluation.views import LoadedPair, TrueFrame
from omnisyn_cli.io import write_image
from omnisyn_cli.io.encode import data_uri
from omnisyn_cli.io.outputs import real_path, write_errors
from omnisyn_cli.types import DepthEstimate

# Mean absolute difference of the channels that has the brightest colour; fixed, so that maps can be compared.
ERROR_SCALE = 0.25
# Percentile of inverse depth that has the last colour: a few stray near pixels do not darken all the others.
NEAREST_PERCENTILE = 99.0
PICTURES_FOLDER = "pictures"  # in the folder of a report
MAX_NAME_CHARS = 80  # of a scene in a file name: file systems take 255 bytes for all of it
# The worst frames of each method that are shown, and the panoramas whose depth is.
FRAMES_PER_METHOD, MAX_PANORAMAS = 4, 8
# Columns and JPEG quality of the pictures inside the page; the full ones stay in the folder.
THUMBNAIL_WIDTH, THUMBNAIL_JPEG_QUALITY = 512, 78
# Of the pictures of a frame, by kind.
FRAME_CAPTIONS = {"truth": "true frame", "frame": "synthesised", "error": "error"}

Pictures = dict[str, str]  # Pictures side by side: a caption -> the whole file as an address.
Sections = dict[str, dict[str, Pictures]]  # By method or panorama, then by a title, which may be empty.


def error_map(image: Picture, truth: Picture) -> UInt8[np.ndarray, "height width 3"]:
    """Mean difference in [0, 1] in Inferno: black 0, pale yellow :data:`ERROR_SCALE`; ValueError: other sizes."""
    check_same_size(image, truth)
    return _coloured(np.abs(image.astype(np.float32) - truth).mean(axis=-1) / ERROR_SCALE, cv2.COLORMAP_INFERNO)


def turbo(
    inverse_depth: Float[np.ndarray, "height width"], *, largest: float | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Inverse depth in the Turbo colours: red is near, dark blue infinitely far, black unknown (negative or NaN).

    The colour is that of √(inverse_depth / largest), 1/m, which by default is the 99th percentile of what is positive
    and finite, else 1. Source: Mikhailov, Turbo, an improved rainbow colormap for visualization, 2019.
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

    def frames(self, pair: LoadedPair, made: Measurement) -> tuple[FrameRecord, ...]:
        """The records with ``frame`` and, of true frames, ``truth`` and ``error``."""
        found = []
        for record, target, image in zip(made.frames, pair.targets, made.images, strict=True):
            pictures = {"frame": self._write(self._method, target.name, image)}
            if isinstance(target, TrueFrame):
                pictures["truth"] = self._write("truth", target.name, target.image)
                error = error_map(image, target.image)
                pictures["error"] = self._write(self._method, f"{target.name}-error", error)
            found.append(replace(record, pictures=pictures))
        return tuple(found)

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


def frame_sections(folder: Path, records: Sequence[UnitRecord]) -> Sections:
    """For each method, the best one first, its worst frames: the true frame, the synthesised one and the error."""
    names = pair_names(records)
    sections: Sections = {}
    for method in ranked_methods(records):
        frames = ((record, f) for record in finished(records, method) for f in record.frames if f.pictures)
        worst = sorted(frames, key=lambda item: item[1].scores.get("ws_psnr", math.inf))[:FRAMES_PER_METHOD]
        for record, frame in worst:
            if pictures := _pictures(folder, frame.pictures, FRAME_CAPTIONS):
                sections.setdefault(method, {})[_frame_title(names[record.pair], frame)] = pictures
    return sections


def depth_sections(folder: Path, records: Sequence[UnitRecord]) -> Sections:
    """For each panorama the true depth and the depth of every method, the method with the best frames first."""
    names, ranked = pair_names(records), ranked_methods(records)
    found: dict[str, dict[str, DepthRecord]] = {}
    for record in finished(records):
        for depth in record.depths:
            if depth.pictures:
                found.setdefault(f"{names[record.pair]}, {depth.view}", {})[record.method] = depth
    sections: Sections = {}
    for panorama, depths in list(found.items())[:MAX_PANORAMAS]:
        if pictures := _depth_pictures(folder, {method: depths[method] for method in ranked if method in depths}):
            sections[panorama] = {"": pictures}
    return sections


def embedded_picture(path: Path) -> str | None:
    """A picture file as a data URI of a JPEG at most :data:`THUMBNAIL_WIDTH` pixels wide; None if it cannot be read."""
    try:
        samples = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError:
        return None
    image = cv2.imdecode(samples, cv2.IMREAD_COLOR) if samples.size else None
    if image is None:
        return None
    height, width = image.shape[:2]
    if width > THUMBNAIL_WIDTH:
        size = (THUMBNAIL_WIDTH, max(1, round(height * THUMBNAIL_WIDTH / width)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, THUMBNAIL_JPEG_QUALITY])
    return data_uri(encoded.tobytes(), "jpeg")


def _frame_title(pair: str, frame: FrameRecord) -> str:
    shards = f"{frame.scores.get('shards', 0.0):.1%} shards"
    score = f"{format_value(frame.scores['ws_psnr'], 2)} dB" if "ws_psnr" in frame.scores else shards
    return f"{pair}, {frame.name}: {score} at t = {frame.t:.2f}, {frame.distance:.2f} m from the nearer panorama"


def _depth_pictures(folder: Path, depths: Mapping[str, DepthRecord]) -> Pictures:
    """The first true depth that can be read, then the estimate of every method."""
    truths = (_pictures(folder, depth.pictures, {"truth": "true depth"}) for depth in depths.values())
    shown = next(filter(None, truths), {})
    for method, depth in depths.items():
        error = depth.weighted.get("imae", math.nan)
        caption = method if math.isnan(error) else f"{method}, IMAE {error:.4f} 1/m"
        shown |= _pictures(folder, depth.pictures, {"depth": caption})
    return shown


def _pictures(folder: Path, files: Mapping[str, str], captions: Mapping[str, str]) -> Pictures:
    """Those of the pictures with a caption that can be read; a name that leads out of the folder is ignored."""
    paths = {caption: real_path(folder / files[key]) for key, caption in captions.items() if key in files}
    inside = {caption: path for caption, path in paths.items() if path.is_relative_to(real_path(folder))}
    return {caption: uri for caption, path in inside.items() if (uri := embedded_picture(path)) is not None}
