"""Hostile files are read or refused in a sentence: a short run of ``run_fuzz.py``, and what it stands on."""

import json
import os
import random
import subprocess
import sys
import tomllib
import zlib
from pathlib import Path
from unittest.mock import Mock

import pytest
from fuzz_mutations import PNG, mutated
from fuzz_targets import targets
from fuzz_worker import hostile, outcome, put
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from run_fuzz import fuzz

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.results import RESULTS_NAME, UnitRecord, read_records
from omnisyn_cli.runtime.models import MANIFEST, ModelEntry, read_manifest

SHORT = 8  # Hostile files for every target.
BUSY = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def test_every_reader_reads_or_refuses_hostile_files() -> None:
    names = list(targets())
    reports = fuzz(names, SHORT * len(names), seed=7)
    assert {name: report.findings for name, report in reports.items() if report.findings} == {}
    assert all(report.counts.total() == SHORT for report in reports.values())


# Files, by seed, that once ended with another error or a warning of numpy's; one names /dev/zero as a pose file.
FOUND: dict[int, dict[str, tuple[int, ...]]] = {
    9: {"poses opensfm": (724,)},
    45: {
        "recipe toml": (69, 100, 193, 303), "mesh obj": (78,), "mesh glb": (24, 306), "mesh ply": (217, 294),
        "poses colmap": (263,), "poses colmap binary": (61, 96), "poses nerfstudio": (211,), "poses kitti": (202,),
        "poses zind": (158,), "poses authors": (69,),
    },
    4500: {
        "poses.json": (1286,), "batch jsonl": (1257,), "recipe toml": (1523,), "table of costs": (734, 868),
        "mesh obj": (1042,), "poses nerfstudio": (256,),
    },
    45000: {"batch jsonl": (202, 1525), "poses nerfstudio": (1096,)},
}  # fmt: skip


@pytest.mark.filterwarnings("ignore", "error::RuntimeWarning")
def test_what_was_found_is_refused_in_a_sentence(tmp_path: Path) -> None:
    for seed, found in FOUND.items():
        for name, indices in found.items():
            target = targets()[name]()
            for index in indices:
                folder = tmp_path / f"{seed} {name} {index}"
                for file, data in [*target.files.items(), hostile(name, target, seed, index)]:
                    put(folder, file, data)
                assert not outcome(target, folder).startswith("finding"), f"{name} {index}"


def test_a_hostile_file_can_be_made_again() -> None:
    target = targets()["poses.json"]()
    files = [hostile("poses.json", target, 3, index) for index in range(20)]
    assert files == [hostile("poses.json", target, 3, index) for index in range(20)]
    assert len({data for _, data in files}) > 15


def test_checksums_of_changed_pngs_are_right_often_enough() -> None:
    """Otherwise no change would ever get past the first check of the decoder; of unmended ones none would be right."""
    good = targets()["image png"]().files["a.png"]
    changed = [mutated(good, random.Random(seed)) for seed in range(200)]  # noqa: S311 - repeatable
    right = [data for data in changed if _has_right_checksums(data)]
    assert 15 < len(right) < 190
    assert len(set(right) - {good}) > 15


def _has_right_checksums(data: bytes) -> bool:
    at = len(PNG)
    while data.startswith(PNG) and at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        body = data[at + 4 : at + 8 + length]
        if data[at + 8 + length : at + 12 + length] != zlib.crc32(body).to_bytes(4, "big"):
            return False
        at += 12 + length
    return data.startswith(PNG)


@pytest.mark.parametrize(
    ("error", "words"),
    [(KeyError("x"), "finding KeyError"), (InputError("no"), "finding message"), (InputError("expected x"), "refused")],
)
def test_findings_are_found(tmp_path: Path, error: Exception, words: str) -> None:
    target = type(targets()["poses.json"]())({}, (), Mock(side_effect=error))
    assert outcome(target, tmp_path).startswith(words)


GREEDY = """
import sys
from pathlib import Path
import numpy as np
from fuzz_targets import targets
from fuzz_worker import outcome
target = type(targets()["poses.json"]())({}, (), lambda folder: np.ones(48 << 20).sum())
print(outcome(target, Path(sys.argv[1])))
"""


def test_a_reader_that_takes_too_much_memory_is_a_finding(tmp_path: Path) -> None:
    """In a process of its own: what counts is how much its greatest memory grows."""
    command = [sys.executable, "-c", GREEDY, str(tmp_path)]
    search = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = subprocess.run(command, check=True, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": search})
    assert done.stdout.strip().endswith("MiB")


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@BUSY
@given(st.dictionaries(st.sampled_from([*ModelEntry.__dataclass_fields__, "else"]), VALUES))
def test_any_entry_of_a_manifest_is_an_entry_or_an_input_error(tmp_path_factory, entry) -> None:
    lines = [f"{key} = {json.dumps(value)}" for key, value in entry.items() if not isinstance(value, dict)]
    text = "\n".join(["version = 1", "[[models]]", *lines])
    folder = tmp_path_factory.mktemp("models")
    (folder / MANIFEST).write_text(text, encoding="utf-8", errors="surrogatepass")
    try:
        found = read_manifest(folder)
    except InputError as error:
        assert "expected" in str(error)  # noqa: PT017 - both ends are allowed
        return
    assert list(found) == [model["name"] for model in tomllib.loads(text)["models"]]


@BUSY
@given(st.sampled_from([*UnitRecord.__dataclass_fields__, "else"]), VALUES)
def test_any_record_is_a_record_or_an_input_error(tmp_path_factory, key, value) -> None:
    whole = UnitRecord("k", "s", "a", "b", "m", "done", baseline=1.0, size=(4, 8)).to_json()
    folder = tmp_path_factory.mktemp("report")
    (folder / RESULTS_NAME).write_text(json.dumps({**whole, key: value}) + "\n", encoding="utf-8")
    try:
        (record,) = read_records(folder)
    except InputError as error:
        assert "line 1" in str(error)  # noqa: PT017 - both ends are allowed
        return
    assert hash(record.unit)
    assert isinstance(record.baseline, float)
