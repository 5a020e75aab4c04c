"""The report of an evaluation: a page to read, tables to paste, figures to compute with.

It is made of the records alone, whatever number of them there is, so that an unfinished evaluation has one as well.
The page shows the worst frames of every method first, and depth beside the true depth: pictures are read from the
folder of the report, made small and put into the page itself.
"""

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np

from omnisyn_cli import __version__
from omnisyn_cli.evaluation.grouping import figures_of, finished, gaps, pair_names, ranked_methods
from omnisyn_cli.evaluation.plots import PLOT_TITLES, report_plots
from omnisyn_cli.evaluation.results import DepthRecord, FrameRecord, UnitRecord, json_values, latest_records
from omnisyn_cli.evaluation.tables import (
    ERROR_NOTE,
    Table,
    about_units,
    data_uri,
    format_value,
    render_markdown,
    render_page,
    report_tables,
)
from omnisyn_cli.evaluation.visualization import ERROR_SCALE
from omnisyn_cli.io.outputs import real_path, staged_folder, write_errors

REPORT_NAME = "report"
"""Of the files, before the extensions ``.html``, ``.md``, ``.json`` and ``.csv``."""

CSV_COLUMNS = (
    "scene", "first", "second", "method", "baseline", "subject", "name", "t", "distance", "metric", "value",
)  # fmt: skip
"""``subject`` is what was measured: ``frame``, ``kind-psnr``, ``kind-area``, ``kind-error`` (of the pixels of a kind,
which ``metric`` names), ``depth``, ``depth-weighted``, ``doubt``, ``reliability-area``, ``reliability-confidence``,
``reliability-within_5``, ``reliability-within_10`` (of a bin of confidence, whose middle ``metric`` is), ``temporal``
or ``seconds``; ``name`` is that of the frame or panorama; ``distance`` is to the nearer panorama; lengths in metres."""

FRAMES_PER_METHOD = 4
"""The worst frames of each method that are shown."""

MAX_PANORAMAS = 8
"""The panoramas whose depth is shown."""

THUMBNAIL_WIDTH, THUMBNAIL_JPEG_QUALITY = 512, 78
"""Columns and JPEG quality of the pictures inside the page; the full ones stay in the folder."""

FRAME_CAPTIONS = {"truth": "true frame", "frame": "synthesised", "error": "error", "kinds": "error by kind"}
"""Of the pictures of a frame, by kind."""

Pictures = dict[str, str]
"""Pictures side by side: a caption -> the whole file as an address."""

Sections = dict[str, dict[str, Pictures]]
"""By method or panorama, then by a title, which may be empty."""


def write_report(folder: Path, records: Iterable[UnitRecord], about: Mapping[str, str] = MappingProxyType({})) -> None:
    """Write ``report.html``, ``report.md``, ``report.json``, ``report.csv`` and the diagrams as PNG files.

    Files of an earlier report are replaced all together at the end. Of several records of one unit the last one counts.
    ``about`` says what was asked for, such as the data set and the command. Pictures that the records name lie in
    ``folder``, whose parent exists. WriteError: the disk is full, or the folder went away.
    """
    units = latest_records(records)
    about = {**about, **about_units(units)}
    tables, plots = report_tables(units), report_plots(units)
    page = render_page(
        "report.html.j2", about=about, error_note=ERROR_NOTE, counts=Counter(unit.status for unit in units),
        tables=tables, gaps=gaps(units), plots=plots, titles=PLOT_TITLES, frames=frame_sections(folder, units),
        depths=depth_sections(folder, units), error_scale=ERROR_SCALE,
    )  # fmt: skip
    texts = {
        "html": page,
        "md": render_markdown(tables, gaps(units), about),
        "json": _json(units, tables, about),
        "csv": _csv(units),
    }
    with staged_folder(folder) as staged, write_errors(folder):
        for extension, text in texts.items():
            (staged / f"{REPORT_NAME}.{extension}").write_bytes(text.encode("utf-8", "backslashreplace"))
        for name, data in plots.items():
            (staged / f"{name}.png").write_bytes(data)


def _json(units: Sequence[UnitRecord], tables: Sequence[Table], about: Mapping[str, str]) -> str:
    """Strict JSON: tables of means and all units; what is infinite or undefined is a string or null."""
    content = {
        "version": __version__,
        "about": about,
        "tables": [asdict(table) for table in tables],
        "gaps": [asdict(gap) for gap in gaps(units)],
        "units": [asdict(unit) for unit in units],
    }
    return json.dumps(json_values(content), ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _csv(units: Sequence[UnitRecord]) -> str:
    """One line for each figure."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for unit in units:
        about = (unit.scene, unit.first, unit.second, unit.method, unit.baseline)
        writer.writerows(
            (*about, *rest, metric, value) for rest, scores in figures_of(unit) for metric, value in scores.items()
        )
    return file.getvalue()


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
