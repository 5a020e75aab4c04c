"""Work for workers to do, workers that do it in this process, and a small batch to give them."""

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import numpy as np

from omnisyn_cli.batch.executor import Job, Report, Work, Worker
from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses

SIZE = (16, 32)


class InlineExecutor:
    def __init__(self, work: Work) -> None:
        self._worker = Worker(work)
        self._reports: list[Report] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._reports.clear()

    def ready(self) -> list[int]:
        return [0]

    def submit(self, worker: int, job: Job) -> None:
        self._reports.append((worker, self._worker.perform(job.payload)))

    def wait(self) -> list[Report]:
        reports, self._reports = self._reports, []
        return reports


def make_tricks(folder: str) -> Callable[[tuple[str, Any]], Any]:
    """A work function of small tricks; ``folder`` is where workers leave a trace."""
    done: list[Any] = []

    def do(trick: tuple[str, Any]) -> Any:
        name, value = trick
        done.append(value)
        match name:
            case "echo":
                return os.getpid(), list(done)
            case "sleep":
                time.sleep(value)
            case "environment":
                return Path("/proc/self/environ").read_bytes().split(b"\0")  # which it was started with
            case "refuse":
                raise InputError(f"expected better, got\n{value}")
            case "stumble":
                raise ZeroDivisionError(value)
            case "die":
                os.kill(os.getpid(), signal.SIGKILL)
            case "die once":
                stamp = Path(folder) / str(value)
                if not stamp.exists():
                    stamp.touch()
                    os.kill(os.getpid(), signal.SIGKILL)
        return os.getpid()

    return do


def write_row(folder: Path, count: int, *, size: tuple[int, int] = SIZE) -> None:
    """Panoramas ``p0.png`` … in a row, 1 m apart, with depth and ``poses.json``."""
    entries = {}
    for index in range(count):
        image = (0.5 + 0.4 * np.roll(pixel_directions(*size), index, axis=1)) * 255
        write_image(folder / f"p{index}.png", np.rint(image).astype(np.uint8))
        write_depth(folder / f"depth{index}.exr", np.full(size, 3.0))
        place = Pose(np.eye(3), np.array([0.0, 0.0, -float(index)]))
        entries[f"p{index}.png"] = PosedPanorama(place, folder / f"depth{index}.exr")
    write_poses(folder / "poses.json", entries)


def line(first: int, second: int, **options: Any) -> dict[str, Any]:
    """A job between two panoramas of :func:`write_row`: three frames in a folder, without an encoder."""
    name = f"{first}-{second}"
    common = {"id": name, "inputs": [f"p{first}.png", f"p{second}.png"], "poses": "poses.json", "output": name}
    return {**common, "frames": 3, **options}


def write_lines(path: Path, lines: list[Any]) -> Path:
    path.write_text("".join((one if isinstance(one, str) else json.dumps(one)) + "\n" for one in lines))
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder but the records."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file() and file.name != "results.jsonl")
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def records(folder: Path) -> list[dict[str, Any]]:
    """Whole lines; the last one may just be on its way."""
    return [json.loads(text) for text in (folder / "results.jsonl").read_text().split("\n")[:-1]]


CAN_KILL = sys.platform == "linux"
