"""What is committed is what belongs there: no stray file at the root, nothing large that nobody has asked for."""

import shutil
import subprocess
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parents[1]
ROOT_FILES = {".gitignore", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "README.md", "pyproject.toml"}

# Folders at the root, and the endings of files in them.
KINDS = {
    ".ci": {""}, "docs": {".md", ".png"}, "examples": {".html", ".jpg", ".json", ".md", ".py"},
    "models": {".md", ".onnx", ".toml"}, "src": {".css", ".html", ".j2", ".js", ".json", ".py", ".typed"},
    "tests": {".json", ".py"},
}  # fmt: skip
MOST = 32 << 10  # Bytes of a file whose ending says nothing else: a text that somebody reads.
# Bytes by ending.
MOST_OF = {".html": 3 << 20, ".jpg": 768 << 10, ".png": 96 << 10, ".json": 24 << 10, ".onnx": 12 << 20}
MOST_TOGETHER = 42 << 20  # Bytes of all of them.


def committed() -> dict[PurePosixPath, int]:
    """Bytes of every file that git knows and that is there, by its path below the root."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("needs git and a checkout: nobody else knows what is committed")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip(f"git does not say what is committed: {listed.stderr.strip()}")
    paths = (PurePosixPath(name) for name in listed.stdout.split("\0") if name)
    return {path: (ROOT / path).lstat().st_size for path in paths if (ROOT / path).is_file()}


def is_expected(path: PurePosixPath) -> bool:
    if len(path.parts) == 1:
        return path.name in ROOT_FILES
    return path.suffix in KINDS.get(path.parts[0], ())


def is_small(path: PurePosixPath, size: int) -> bool:
    return size <= MOST_OF.get(path.suffix, MOST)


def test_every_committed_file_has_a_place_and_a_size_that_is_expected() -> None:
    """Whoever adds another kind of file says so above."""
    sizes = committed()
    assert [str(path) for path in sizes if not is_expected(path)] == []
    assert [f"{path}: {size} bytes" for path, size in sizes.items() if not is_small(path, size)] == []
    assert sum(sizes.values()) <= MOST_TOGETHER


def test_every_expected_place_is_in_use() -> None:
    """A place that is no longer needed is not kept open."""
    paths = committed()
    assert {path.name for path in paths if len(path.parts) == 1} == ROOT_FILES
    kinds: dict[str, set[str]] = {}
    for path in paths:
        if len(path.parts) > 1:
            kinds.setdefault(path.parts[0], set()).add(path.suffix)
    assert kinds == KINDS
    assert set(MOST_OF) <= set().union(*KINDS.values())


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("t.json", 100), ("src/omnisyn_cli/frames.mp4", 1), ("tests/io/t.json", 100_000), ("notes/a.md", 1),
        ("Makefile", 9),
    ],
)  # fmt: skip
def test_a_stray_file_is_found(name: str, size: int) -> None:
    path = PurePosixPath(name)
    assert not (is_expected(path) and is_small(path, size))
