"""Lines of results: what is written comes back, whatever happened to the last line."""

import math

import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.results import RESULTS_NAME, DepthRecord, FrameRecord, UnitRecord, read_records
from omnisyn_cli.io.documents import append_line

FRAME = FrameRecord("b.png", 0.5, 1.25, {"ws_psnr": math.inf, "ssim": 1.0}, {"frame": "pictures/b.jpg"})
DEPTH = DepthRecord("a.png", {"imae": 0.1}, {"imae": 0.2})
DONE = UnitRecord(
    "k1", "hall – «1»", "a.png", "c.png", "matching", "done", baseline=2.5, size=(64, 128), frames=(FRAME,),
    depths=(DEPTH,), temporal={"flicker": 0.01}, seconds={"depth": 1.5, "total": 1.5},
)  # fmt: skip
SKIPPED = UnitRecord("", "street", "", "", "", "skipped", 'no "truth"\n')


def append_record(folder, record):
    append_line(folder / RESULTS_NAME, record.to_json())


def test_records_come_back_as_they_were_written(tmp_path):
    for record in (DONE, SKIPPED):
        append_record(tmp_path, record)
    done, skipped = read_records(tmp_path)
    assert done == DONE
    assert math.isnan(skipped.baseline)
    assert skipped.to_json() == SKIPPED.to_json()
    assert read_records(tmp_path / "nosuch") == []


def test_lines_are_strict_json(tmp_path):
    append_record(tmp_path, DONE)
    append_record(tmp_path, SKIPPED)
    text = (tmp_path / RESULTS_NAME).read_text(encoding="utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text
    assert len(text.splitlines()) == 2


@pytest.mark.parametrize("line", ["{}", "[]", "nonsense", '{"key": 1}'])
def test_a_line_that_is_no_record_is_refused_with_its_number(tmp_path, line):
    append_record(tmp_path, DONE)
    path = tmp_path / RESULTS_NAME
    path.write_bytes(path.read_bytes() + f"{line}\n".encode())
    with pytest.raises(InputError, match="line 2"):
        read_records(tmp_path)
