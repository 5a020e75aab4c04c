"""A chain of panoramas in the hall of :mod:`synthesis_samples`, and jobs about it."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import pytest

from omnisyn_cli.interpolation.job import InterpolationJob, TourJob
from synthesis_samples import posed

T = TypeVar("T", bound=TourJob)

CHAIN = [posed((0, 0, 0.6)), posed((0.1, 0.1, 0), 0.4), posed((0.6, 0, -0.1), 0.8, 0.1)]


def job_of(folder: Path, images: list[Path], **changes: object) -> InterpolationJob:
    """Frames as PNG in ``out``: no encoder is needed and samples come back exactly."""
    job = InterpolationJob(tuple(images), folder / "poses.json", folder / "out", frames=3, threads=1)
    return replace(job, **changes)


def tour_job(kind: type[T], folder: Path, images: list[Path], output: str, **changes: Any) -> T:
    """A job for something that is made of surfaces."""
    return kind(tuple(images), folder / "poses.json", folder / output, threads=1, **changes)


def use_ffmpeg(monkeypatch: pytest.MonkeyPatch, folder: Path, script: str, encoder: str = "libx264") -> None:
    """One that lists an encoder, writes half a file and does what ``script`` says, in place of the program's own."""
    program = folder / "fake-ffmpeg"
    program.write_text(
        f"#!{sys.executable}\nimport sys, time\n"
        f"if '-encoders' in sys.argv:\n    print(' V....D {encoder}  H.264')\n    sys.exit(0)\n"
        "output = next(word[5:] for word in sys.argv if word.startswith('file:'))\n"
        f"open(output, 'w').write('half')\n{script}\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr("omnisyn_cli.io.encoders.ffmpeg_program", lambda: str(program))


def listing(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
