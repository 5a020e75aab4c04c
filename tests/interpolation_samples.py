"""A chain of panoramas in the hall of :mod:`synthesis_samples`, and jobs about it."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import pytest

from omnisyn_cli.interpolation.job import InterpolationJob, TourJob
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.io.encoders import ffmpeg_program
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from synthesis_samples import posed

T = TypeVar("T", bound=TourJob)
CHAIN = [posed((0, 0, 0.6)), posed((0.1, 0.1, 0), 0.4), posed((0.6, 0, -0.1), 0.8, 0.1)]


def job_of(folder: Path, images: list[Path], **changes: object) -> InterpolationJob:
    """Frames as PNG in ``out``: no encoder is needed and samples come back exactly."""
    job = InterpolationJob(tuple(images), folder / "poses.json", folder / "out", frames=3, threads=1)
    return replace(job, **changes)


def write_entries(
    folder: Path, images: list[Path], depth: str | None = "p{}_depth.exr", mask: str | None = None
) -> None:
    """Another ``poses.json`` for the chain: names of panoramas, and of the depth and the mask of each."""
    companions = [[name and folder / name.format(k) for name in (depth, mask)] for k in range(len(images))]
    entries = [PosedPanorama(pose, *files) for pose, files in zip(CHAIN, companions, strict=False)]
    write_poses(folder / "poses.json", dict(zip([path.name for path in images], entries, strict=True)))


@dataclass(frozen=True)
class Hall:
    """Panoramas of the chain in a folder, with their depth, and what is planned with them."""

    folder: Path
    images: list[Path]

    def job(self, **changes: object) -> InterpolationJob:
        return job_of(self.folder, self.images, **changes)

    def plan(self, **changes: object) -> InterpolationPlan:
        return plan_interpolation(self.job(**changes))

    def refuses(self, error: type[Exception], words: str, **changes: object) -> None:
        """Such a job is refused before any work, with these words."""
        with pytest.raises(error, match=words):
            self.plan(**changes)


def tour_job(kind: type[T], folder: Path, images: list[Path], output: str, **changes: Any) -> T:
    """A job for something that is made of surfaces."""
    return kind(tuple(images), folder / "poses.json", folder / output, threads=1, **changes)


def edit_poses(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the panoramas in ``poses.json`` by hand, as its author might."""
    document = json.loads((folder / "poses.json").read_text())
    change(document["panoramas"])
    (folder / "poses.json").write_text(json.dumps(document))


def ffmpeg(*arguments: object) -> subprocess.CompletedProcess[bytes]:
    """What the ffmpeg of the program does and says."""
    command = [ffmpeg_program(), "-hide_banner", "-y", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, check=False)


def described_by_ffmpeg(path: Path) -> str:
    return ffmpeg("-i", f"file:{path}").stderr.decode()


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
