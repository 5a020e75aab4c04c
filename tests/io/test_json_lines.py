"""What was written before a kill is there after it, and nothing else."""

import json

import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.documents import append_line, complete_lines


@pytest.mark.parametrize("cut", [b'{"step": 2, "lo', b"\xc3", b'{"step": 2}'])
def test_a_line_that_was_cut_short_is_no_line_and_spoils_no_other(tmp_path, cut):
    path = tmp_path / "log.jsonl"
    append_line(path, {"step": 1})
    path.write_bytes(path.read_bytes() + cut)
    assert complete_lines(path) == ['{"step": 1}']
    append_line(path, {"step": 3, "name": "Straße"})
    assert [json.loads(line) for line in complete_lines(path)] == [{"step": 1}, {"step": 3, "name": "Straße"}]
    assert path.read_bytes().count(b"\n") == 2


@pytest.mark.parametrize("content", [None, b"", b'{"step"'])
def test_where_nothing_was_completed_there_are_no_lines(tmp_path, content):
    path = tmp_path / "log.jsonl"
    if content is not None:
        path.write_bytes(content)
    assert complete_lines(path) == []


def test_numbers_that_json_does_not_know_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match="Out of range"):
        append_line(tmp_path / "log.jsonl", {"loss": float("nan")})
    assert not (tmp_path / "log.jsonl").exists()


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_bytes(b"\xff\xfe\n")
    with pytest.raises(InputError, match=r"log\.jsonl: expected results of an earlier run"):
        complete_lines(path)
