"""A chain of panoramas in the hall of :mod:`synthesis_samples`, and jobs about it."""

from dataclasses import replace
from pathlib import Path

from omnisyn_cli.interpolation.job import InterpolationJob
from synthesis_samples import posed

CHAIN = [posed((0, 0, 0.6)), posed((0.1, 0.1, 0), 0.4), posed((0.6, 0, -0.1), 0.8, 0.1)]


def job_of(folder: Path, images: list[Path], **changes: object) -> InterpolationJob:
    """Frames as PNG in ``out``: no encoder is needed and samples come back exactly."""
    job = InterpolationJob(tuple(images), folder / "poses.json", folder / "out", frames=3, threads=1)
    return replace(job, **changes)


def listing(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
