"""A hall whose exact surface is known, written for an export, and jobs about it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from interpolation_samples import CHAIN, tour_job
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.export.formats import ExportJob, ExportSummary, plan_export
from omnisyn_cli.interpolation.export.run import run_export
from synthesis_samples import PHASES, RADIUS, WAVES, write_hall

OPENCV = np.diag([1.0, -1.0, -1.0])  # Our axes and those of OpenCV, either way: x stays, y and z turn round.


def job_in(folder: Path, output: str, *, chain: Sequence[Pose] = CHAIN, **options: object) -> ExportJob:
    """Panoramas of the hall with their depth; two of the usual three are turned, and one is held askew as well."""
    images = write_hall(folder, chain)
    return tour_job(ExportJob, folder, images, output, **options)


def exported(folder: Path, output: str, **options: object) -> ExportSummary:
    return run_export(plan_export(job_in(folder, output, **options)))


def off_wall(points: np.ndarray) -> np.ndarray:
    """Metres between points of the world, in our axes, and the wall of the hall, which is a ball about its origin."""
    return np.abs(np.linalg.norm(points, axis=-1) - RADIUS)


def wall_colour(points: np.ndarray) -> np.ndarray:
    """Of the wall at points of the world, in our axes: 0 to 255."""
    return np.asarray(255 * (0.5 + 0.4 * np.sin(points @ WAVES.T + PHASES)))
