"""Records survive whatever ends a run, and one run at a time writes them."""

import json
import sys

import pytest

from omnisyn_cli.batch.folder import Records
from omnisyn_cli.errors import OutputPathError, WriteError
from process_limits import file_size_limit


def test_the_last_line_of_a_job_counts(tmp_path):
    with Records(tmp_path / "r.jsonl") as records:
        for value in (1, 2):
            records.append({"id": "ä", "value": value})
    with Records(tmp_path / "r.jsonl") as records:
        assert records.last("ä") == {"id": "ä", "value": 2}
        records.append({"id": "b"})
    with Records(tmp_path / "r.jsonl") as records:
        assert (records.last("ä"), records.last("b")) == ({"id": "ä", "value": 2}, {"id": "b"})


def test_a_line_is_on_the_disk_when_append_returns(tmp_path):
    with Records(tmp_path / "r.jsonl") as records:
        records.append({"id": "a"})
        assert json.loads((tmp_path / "r.jsonl").read_text()) == {"id": "a"}


@pytest.mark.parametrize("cut", range(1, 12))
def test_half_a_line_is_as_if_it_had_not_been_written(tmp_path, cut):
    path, whole, torn = tmp_path / "r.jsonl", b'{"id": "a"}\n', b'{"id": "b"}\n'
    path.write_bytes(whole + torn[:cut])
    with Records(path) as records:
        assert (records.last("a"), records.last("b")) == ({"id": "a"}, None)
        records.append({"id": "c"})
    assert path.read_bytes() == whole + b'{"id": "c"}\n'


def test_a_second_run_is_refused(tmp_path):
    with Records(tmp_path / "r.jsonl"), pytest.raises(OutputPathError, match="in use"), Records(tmp_path / "r.jsonl"):
        pass
    with Records(tmp_path / "r.jsonl") as records:
        assert records.last("a") is None


@pytest.mark.parametrize("content", [b"text\n", b"[]\n", b'{"name": 1}\n'])
def test_a_file_of_something_else_is_left_alone(tmp_path, content):
    (tmp_path / "r.jsonl").write_bytes(content)
    with pytest.raises(OutputPathError, match="expected records"), Records(tmp_path / "r.jsonl"):
        pass
    assert (tmp_path / "r.jsonl").read_bytes() == content


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limits there")
def test_a_full_disk_is_said_of_the_records_also_when_they_are_closed(tmp_path):
    path = tmp_path / "r.jsonl"
    with file_size_limit(4), pytest.raises(WriteError, match=r"r\.jsonl: expected to write"), Records(path) as records:
        records.append({"id": "a"})
