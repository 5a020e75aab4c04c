"""Which checkpoints lie somewhere, and what each of them is."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from omnisyn_cli.errors import InputError
from omnisyn_cli.training.checkpoint import load_checkpoint
from omnisyn_cli.training.tasks import TASKS

SEARCH_PATTERNS = ("*.pt", "*/checkpoint.pt", "*/*/checkpoint.pt", "checkpoints/*.pt", "*/checkpoints/*.pt")
"""Where checkpoints of runs, and compact ones, are looked for: no folder is searched to its bottom."""


@dataclass(frozen=True)
class FoundCheckpoint:
    """A checkpoint.

    Attributes:
        path: the file.
        kind: one of :data:`omnisyn_cli.training.tasks.TASKS`.
        variant: of its network; empty where it holds several.
        step: how far it was trained.
    """

    path: Path
    kind: str
    variant: str
    step: int


def checkpoints_below(folder: Path) -> Iterator[FoundCheckpoint]:
    """The checkpoints in a folder and where runs below it have theirs, by path; other files are passed over."""
    for path in sorted({path for place in SEARCH_PATTERNS for path in folder.glob(place)}):
        try:
            state = load_checkpoint(path)
        except InputError:
            continue
        if state["kind"] in TASKS:
            yield FoundCheckpoint(path, state["kind"], str(state["network"].get("name", "")), int(state["step"]))
