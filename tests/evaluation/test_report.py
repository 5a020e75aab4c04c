"""The report: complete, self-contained, safe to open, and there whatever was measured."""

import base64
import csv
import io
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from report_samples import absent, some_records, unit, with_pictures

from omnisyn_cli.errors import WriteError
from omnisyn_cli.evaluation import report
from omnisyn_cli.evaluation.report import CSV_COLUMNS, write_report
from omnisyn_cli.evaluation.results import RECORD, FrameRecord, UnitRecord
from omnisyn_cli.evaluation.visualization import FRAMES_PER_METHOD, THUMBNAIL_WIDTH, embedded_picture, frame_sections
from omnisyn_cli.io import write_image

NASTY = '<script>alert("x")</script>|`*a*`\n# b & "c"'


@pytest.fixture(autouse=True)
def _quick_diagrams(monkeypatch):
    """A small picture in the place of the diagrams, which take seconds; they have tests of their own."""
    _, png = cv2.imencode(".png", np.full((4, 8, 3), 128, np.uint8))

    def quick(records: list[UnitRecord]) -> dict[str, bytes]:
        return {"ws-psnr-by-seconds": png.tobytes()} if any(r.status == "done" for r in records) else {}

    monkeypatch.setattr(report, "report_plots", quick)


class Document(HTMLParser):
    """Tags with their attributes, visible text, and whether every tag is closed in its turn."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes) -> None:
        self.tags.append((tag, dict(attributes)))
        if tag not in {"meta", "img", "br"}:
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.text.append(data)

    def names(self) -> set[str]:
        return {tag for tag, _ in self.tags}

    def pictures(self) -> list[str]:
        return [attributes["src"] for tag, attributes in self.tags if tag == "img"]


def written(folder: Path, records: list[UnitRecord]) -> Document:
    write_report(folder, records)
    return Document((folder / "report.html").read_text(encoding="utf-8"))


def strict(path: Path):
    def refuse(name: str) -> None:
        raise AssertionError(name)

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def test_the_page_needs_nothing_but_itself(tmp_path, monkeypatch):
    """With the diagrams as they are."""
    monkeypatch.undo()
    document = written(tmp_path, [with_pictures(tmp_path, r) if r.status == "done" else r for r in some_records()])
    assert len(document.pictures()) > 15
    assert all(re.match("data:image/(png|jpeg);base64,", picture) for picture in document.pictures())
    assert not document.names() & {"script", "link", "iframe", "object", "form"}
    for _, attributes in document.tags:
        assert not any(name.startswith("on") or name == "href" for name in attributes)
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in next(a["content"] for _, a in document.tags if "http-equiv" in a)
    assert "prefers-color-scheme: dark" in source
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in [a for _, a in document.tags]
    assert not re.search(r"https?://|url\(|@import", source)


def test_the_page_shows_figures_and_reasons(tmp_path):
    document = written(tmp_path, some_records())
    for text in ("24.00", "32.00", "unavailable: expected the network 'synsin', this version has none", "campus"):
        assert text in document.text, text
    best = [index for index, (_, attributes) in enumerate(document.tags) if attributes.get("class") == "best"]
    assert best
    headings = [text for text in document.text if text.startswith(("Means", "Not measured", "Diagrams", "Depth, "))]
    assert headings[:3] == ["Means per method", "Not measured", "Diagrams"]


def test_names_of_the_user_are_text_everywhere(tmp_path):
    records = [
        unit(NASTY, NASTY, first=NASTY, second=NASTY),
        unit(NASTY, "other", first="c", second=NASTY),
        absent(NASTY, "flow", "failed", NASTY),
    ]
    document = written(tmp_path, records)
    assert "script" not in document.names()
    assert any(NASTY in text for text in document.text)
    for line in (tmp_path / "report.md").read_text(encoding="utf-8").splitlines():
        assert not re.search(r"(?<!\\)<script", line)
        assert not line.startswith("# b")
    rows = list(csv.reader(io.StringIO((tmp_path / "report.csv").read_text(encoding="utf-8"))))
    assert rows[1][:4] == [NASTY] * 4
    assert strict(tmp_path / "report.json")["units"][0]["scene"] == NASTY


def test_every_line_of_a_markdown_table_has_equally_many_cells(tmp_path):
    write_report(tmp_path, [*some_records(), unit("a|b", "m|n")])
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    tables = [part.splitlines() for part in text.split("\n\n") if part.startswith("|")]
    assert len(tables) == 16
    for lines in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1
    assert r"| street | 28.00 t0\.50.png |" not in text
    assert "| matching | 24.00 ± 2.00 |" in text, "it lacks the frames of the scene a|b"
    records = [replace(record, scene=f"{record.scene}-{k}") for record in some_records() for k in range(3)]
    write_report(tmp_path, records)
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "| matching | **24.00 ± 0.89** |" in text
    assert "| oracle-depth (upper bound) | 32.00 ± 0.00 |" in text


def test_a_report_says_what_it_is_about(tmp_path):
    write_report(tmp_path, some_records(), {"data set": "scenes/<b>", "command": "omnisyn eval 'scenes/<b>'"})
    about = strict(tmp_path / "report.json")["about"]
    assert about["scenes"] == "2, with 2 pairs and 6 frames"
    assert about["sizes"] == "64x32"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", about["date"])
    markdown = (tmp_path / "report.md").read_text(encoding="utf-8")
    page = Document((tmp_path / "report.html").read_text(encoding="utf-8"))
    shown = " ".join(" ".join(page.text).split())
    for name, value in about.items():
        assert f"- {name}: " in markdown
        assert " ".join(value.split()) in shown


def test_the_csv_file_has_every_figure_once(tmp_path):
    records = some_records()
    write_report(tmp_path, records)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "report.csv").read_text(encoding="utf-8"))))
    assert tuple(rows[0]) == CSV_COLUMNS
    frames = [row for row in rows if row["subject"] == "frame" and row["metric"] == "ws_psnr"]
    truth = {
        (r.scene, r.method, f.name): (f.t, f.distance, f.scores["ws_psnr"]) for r in records for f in r.frames
    }  # fmt: skip
    assert len(frames) == len(truth)
    for row in frames:
        expected = truth[row["scene"], row["method"], row["name"]]
        assert tuple(float(row[key]) for key in ("t", "distance", "value")) == expected
    assert len({tuple(row.values())[:-1] for row in rows}) == len(rows)
    subjects = {row["subject"] for row in rows}
    assert subjects == {
        "frame", "kind-psnr", "kind-area", "kind-error", "depth", "depth-weighted", "doubt", "reliability-area",
        "reliability-confidence", "reliability-within_5", "reliability-within_10", "temporal", "seconds",
    }  # fmt: skip


def test_the_json_file_is_strict_and_has_all_records(tmp_path):
    records = [*some_records(), unit("still", "matching", (math.inf, 20.0))]
    write_report(tmp_path, records)
    content = strict(tmp_path / "report.json")
    assert [RECORD.validate_python(values) for values in content["units"]][:5] == records[:5]
    assert RECORD.validate_python(content["units"][-1]).frames[0].scores["ws_psnr"] == math.inf
    assert content["tables"][0]["rows"][0]["name"] == "matching"
    assert {gap["method"] for gap in content["gaps"]} == {"", "oracle-depth", "synsin"}


@pytest.mark.parametrize(
    "records", [[], [absent("a", "", "skipped", "no truth")], [absent("a", "flow", "failed", "broken")]]
)
def test_nothing_finished_gives_a_report_as_well(tmp_path, records):
    document = written(tmp_path, records)
    assert not document.pictures()
    assert ("Nothing has been measured yet." in document.text) == (not records)
    assert strict(tmp_path / "report.json")["units"] == [record.to_json() for record in records]
    assert (tmp_path / "report.csv").read_text(encoding="utf-8").splitlines() == [",".join(CSV_COLUMNS)]
    assert {path.suffix for path in tmp_path.iterdir()} == {".html", ".md", ".json", ".csv"}


def test_of_several_records_of_a_unit_the_last_one_counts(tmp_path):
    first, last = unit("hall", "matching", (10.0,)), unit("hall", "matching", (30.0,))
    document = written(tmp_path, [first, unit("hall", "flow", (20.0,)), last])
    assert "30.00" in document.text
    assert "10.00" not in document.text
    assert len(strict(tmp_path / "report.json")["units"]) == 2


def test_a_second_report_replaces_the_first_and_nothing_else(tmp_path):
    (tmp_path / "results.jsonl").write_text("kept", encoding="utf-8")
    record = with_pictures(tmp_path, unit("hall", "matching", (20.0,)))
    pictures = sorted((tmp_path / "pictures").iterdir())
    write_report(tmp_path, [record])
    document = written(tmp_path, [record, unit("hall", "flow", (12.34,))])
    assert "12.34" in document.text
    assert (tmp_path / "results.jsonl").read_text(encoding="utf-8") == "kept"
    assert sorted((tmp_path / "pictures").iterdir()) == pictures
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_pictures_are_embedded_small_and_as_they_are(tmp_path):
    wide = np.zeros((600, 1200, 3), np.uint8)
    wide[:, 600:] = (200, 100, 50)
    write_image(tmp_path / "wide.png", wide)
    uri = embedded_picture(tmp_path / "wide.png")
    samples = np.frombuffer(base64.b64decode(uri.partition(",")[2]), np.uint8)
    image = cv2.imdecode(samples, cv2.IMREAD_COLOR)[..., ::-1]
    assert image.shape == (THUMBNAIL_WIDTH // 2, THUMBNAIL_WIDTH, 3)
    assert np.abs(image[10, THUMBNAIL_WIDTH - 10].astype(int) - (200, 100, 50)).max() < 8
    assert image[10, 10].max() < 8


def test_pictures_that_are_missing_broken_or_elsewhere_are_left_out(tmp_path):
    folder = tmp_path / "report"
    folder.mkdir()
    write_image(tmp_path / "secret.png", np.zeros((8, 16, 3), np.uint8))
    (folder / "broken.png").write_bytes(b"no picture")
    (folder / "empty.png").write_bytes(b"")
    files = {"frame": "../secret.png", "truth": "broken.png", "error": "absent.png"}
    frames = [
        FrameRecord("x", 0.5, 1.0, {"ws_psnr": 20.0}, files),
        FrameRecord("y", 0.6, 1.0, {}, {"frame": "empty.png"}),
    ]
    assert frame_sections(folder, [unit("hall", "matching", (), frames=tuple(frames))]) == {}
    assert embedded_picture(tmp_path / "secret.png") is not None


def test_the_worst_frames_come_first(tmp_path):
    records = [with_pictures(tmp_path, unit(scene, "matching", scores))
               for scene, scores in (("a", (20.0, 30.0, 10.0)), ("b", (15.0, 5.0, 40.0)))]  # fmt: skip
    ((method, strips),) = frame_sections(tmp_path, records).items()
    assert method == "matching"
    assert len(strips) == FRAMES_PER_METHOD
    assert [re.search(r": (\S+) dB", title)[1] for title in strips] == ["5.00", "10.00", "15.00", "20.00"]
    assert all(list(pictures) == ["true frame", "synthesised", "error"] for pictures in strips.values())


def test_a_folder_that_cannot_be_written_is_an_error_of_its_own(tmp_path):
    with pytest.raises(WriteError, match="gone"):
        write_report(tmp_path / "gone" / "report", [])


def test_a_full_disk_is_said_of_the_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "write_bytes", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(WriteError, match="report: expected to write it, got 'No space"):
        write_report(tmp_path / "report", [])
    assert list(tmp_path.iterdir()) == []
