"""Every row of docs/stability.md names tests that exist, and every test of this folder is in it."""

import ast
import re
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "stability.md"
TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")
ROWS = [
    line for line in DOCUMENT.read_text(encoding="utf-8").splitlines() if line.startswith("| ") and "|---" not in line
]
HERE = Path(__file__).name


@lru_cache
def names_in(file: Path) -> frozenset[str]:
    """Names of the test functions of a file, methods of classes among them."""
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return frozenset(node.name for node in nodes if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"))


@pytest.mark.parametrize("row", [row for row in ROWS if not row.rstrip(" |").endswith("| test")])
def test_the_names_in_a_row_exist(row: str) -> None:
    named = TEST.findall(row.rsplit(" | ", 1)[1])
    assert named, f"no test: {row}"
    for file, name in named:
        assert name in names_in(ROOT / file), f"{file} has no {name}"


def test_every_table_is_read() -> None:
    assert len(ROWS) > 30


def test_what_is_tested_here_is_documented() -> None:
    named = {name for _, name in TEST.findall(DOCUMENT.read_text(encoding="utf-8"))}
    files = [file for file in Path(__file__).parent.glob("test_*.py") if file.name != HERE]
    missing = {name for file in files for name in names_in(file)} - named
    assert missing == set()
