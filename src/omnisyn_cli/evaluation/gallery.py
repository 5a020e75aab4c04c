"""The pictures of a report: the worst frames of every method first, and depth beside the true depth.

Pictures are read from the folder of the report, made small and put into the page itself.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from omnisyn_cli.evaluation.grouping import finished, pair_names, pair_of, ranked_methods
from omnisyn_cli.evaluation.records import DepthRecord, FrameRecord, UnitRecord
from omnisyn_cli.evaluation.table import format_value

__all__ = ["Picture", "Section", "Strip", "depth_sections", "embedded_picture", "frame_sections"]

FRAMES_PER_METHOD = 4
"""The worst frames of each method that are shown."""

MOST_PANORAMAS = 8
"""The panoramas whose depth is shown."""

WIDTH = 512
QUALITY = 78
"""Of the JPEG files inside the page; the full pictures stay in the folder."""

FRAME_TITLES = {"truth": "true frame", "frame": "synthesised", "error": "error"}


@dataclass(frozen=True)
class Picture:
    """A picture with its caption; ``uri`` has the whole file in it."""

    caption: str
    uri: str


@dataclass(frozen=True)
class Strip:
    """Pictures side by side."""

    title: str
    pictures: tuple[Picture, ...]


@dataclass(frozen=True)
class Section:
    """Strips of one method or one panorama."""

    title: str
    strips: tuple[Strip, ...]


def frame_sections(folder: Path, records: Sequence[UnitRecord]) -> list[Section]:
    """For each method, the best one first, its worst frames: the true frame, the synthesised one and the error."""
    names = pair_names(records)
    sections = []
    for method in ranked_methods(records):
        worst = sorted(_frames(records, method), key=lambda item: item[1].scores.get("ws_psnr", math.inf))
        strips = [
            Strip(_frame_title(names[pair_of(record)], frame), _pictures(folder, frame.pictures, FRAME_TITLES))
            for record, frame in worst[:FRAMES_PER_METHOD]
        ]
        sections.append(Section(method, tuple(strip for strip in strips if strip.pictures)))
    return [section for section in sections if section.strips]


def depth_sections(folder: Path, records: Sequence[UnitRecord]) -> list[Section]:
    """For each panorama the true depth and the depth of every method, the method with the best frames first."""
    names = pair_names(records)
    found: dict[tuple[str, str], dict[str, DepthRecord]] = {}
    for record in finished(records):
        for depth in record.depths:
            if depth.pictures:
                found.setdefault((names[pair_of(record)], depth.view), {})[record.method] = depth
    sections = []
    for (pair, view), depths in list(found.items())[:MOST_PANORAMAS]:
        ranked = [(method, depths[method]) for method in ranked_methods(records) if method in depths]
        pictures = (*_true_depth(folder, ranked), *_estimates(folder, ranked))
        if pictures:
            sections.append(Section(f"{pair}, {view}", (Strip("", pictures),)))
    return sections


def embedded_picture(path: Path) -> str | None:
    """A picture file as a data URI of a JPEG at most :data:`WIDTH` pixels wide; None if it cannot be read."""
    try:
        samples = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError:
        return None
    image = cv2.imdecode(samples, cv2.IMREAD_COLOR) if samples.size else None
    if image is None:
        return None
    height, width = image.shape[:2]
    if width > WIDTH:
        size = (WIDTH, max(1, round(height * WIDTH / width)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def _frames(records: Sequence[UnitRecord], method: str) -> Iterator[tuple[UnitRecord, FrameRecord]]:
    for record in finished(records):
        if record.method == method:
            yield from ((record, frame) for frame in record.frames if frame.pictures)


def _frame_title(pair: str, frame: FrameRecord) -> str:
    score = format_value(frame.scores.get("ws_psnr", math.nan), 2)
    return f"{pair}, {frame.name}: {score} dB at t = {frame.t:.2f}, {frame.distance:.2f} m from the nearer panorama"


def _pictures(folder: Path, files: Mapping[str, str], titles: Mapping[str, str]) -> tuple[Picture, ...]:
    shown = ((title, _inside(folder, files[key])) for key, title in titles.items() if key in files)
    return tuple(Picture(title, uri) for title, uri in shown if uri is not None)


def _true_depth(folder: Path, depths: Sequence[tuple[str, DepthRecord]]) -> tuple[Picture, ...]:
    for _, depth in depths:
        if pictures := _pictures(folder, depth.pictures, {"truth": "true depth"}):
            return pictures
    return ()


def _estimates(folder: Path, depths: Sequence[tuple[str, DepthRecord]]) -> Iterator[Picture]:
    for method, depth in depths:
        error = depth.weighted.get("imae", math.nan)
        caption = method if math.isnan(error) else f"{method}, IMAE {error:.4f} 1/m"
        yield from _pictures(folder, depth.pictures, {"depth": caption})


def _inside(folder: Path, name: str) -> str | None:
    """A picture of the report; a name that leads out of its folder is ignored."""
    path = (folder / name).resolve()
    return embedded_picture(path) if path.is_relative_to(folder.resolve()) else None
