"""A command line run in this process or in one of its own, and a small pair of panoramas to give it."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import omnisyn_cli
from omnisyn_cli.cli import main
from omnisyn_cli.cli.progress import COMPILING_NOTE
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses

SIZE = (16, 32)

# What is said of the plan and of each stage where there is no terminal.
STAGE_LINE = re.compile(r"^\[\d+:\d\d\] .*\n", re.MULTILINE)


@dataclass(frozen=True)
class Result:
    """What a command left behind; ``err`` without its stages, and without the word that kernels are compiled."""

    code: int
    out: str
    raw_err: str

    @property
    def err(self) -> str:
        """What was printed on standard error but for how far it is, whether this was the first run or not."""
        return STAGE_LINE.sub("", self.raw_err.replace(f"{COMPILING_NOTE}\n", ""))


@dataclass(frozen=True)
class Omnisyn:
    """``omnisyn arguments…`` in this process; ``folder`` is where a command that fails leaves nothing."""

    capsys: pytest.CaptureFixture[str]
    folder: Path

    def __call__(self, *arguments: object) -> Result:
        self.capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        out, err = self.capsys.readouterr()
        assert isinstance(left.value.code, int)
        return Result(left.value.code, out, err)

    def ended(self, code: int, *arguments: object) -> Result:
        """The same, with an exit code that is known."""
        result = self(*arguments)
        assert result.code == code, result.err
        return result

    def made(self, *arguments: object) -> Result:
        """The same, which has to succeed."""
        return self.ended(0, *arguments)

    def quiet(self, *arguments: object) -> Result:
        """The same, without a word on standard error."""
        result = self.made(*arguments)
        assert result.err == ""
        return result

    def json(self, *arguments: object) -> Any:
        """What is printed with ``--json``."""
        return json.loads(self.made(*arguments, "--json").out)

    def refused(self, *arguments: object, code: int = 3) -> str:
        """The one line that is said of unusable input, or of another failure; nothing else is printed or written."""
        result = self._failed(code, *arguments)
        assert result.strip().count("\n") == 0
        return result

    def misused(self, *arguments: object) -> str:
        """What is said of wrong usage; nothing is written."""
        result = self._failed(2, *arguments)
        assert "Error: " in result
        assert "Traceback" not in result
        return result

    def _failed(self, code: int, *arguments: object) -> str:
        before = listing(self.folder)
        result = self(*arguments)
        assert (result.code, result.out) == (code, "")
        assert listing(self.folder) == before
        return result.err


def start_cli(*arguments: object, folder: Path, **environment: str) -> subprocess.Popen[bytes]:
    """``python -m omnisyn_cli arguments…`` in a process of its own."""
    command = [sys.executable, "-m", "omnisyn_cli", *map(str, arguments)]
    here = str(Path(omnisyn_cli.__file__).parents[1])
    variables = {**os.environ, "PYTHONPATH": here, **environment}
    return subprocess.Popen(
        command, cwd=folder, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        preexec_fn=None if sys.platform == "win32" else heed_signals,
    )  # fmt: skip


def heed_signals() -> None:
    """Undo what whoever started the tests in the background, or under nohup, told them to ignore."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def write_pair(folder: Path, names: tuple[str, ...] = ("a.png", "b.png"), size: tuple[int, int] = SIZE) -> list[Path]:
    """Panoramas 1 m apart that see colours by direction at 3 m, and their ``poses.json``."""
    entries = {}
    for index, name in enumerate(names):
        image = (0.5 + 0.4 * pixel_directions(*size)) * 255
        write_image(folder / name, np.rint(image).astype(np.uint8))
        write_depth(folder / f"depth{index}.exr", np.full(size, 3.0))
        entries[name] = PosedPanorama(Pose(np.eye(3), np.array([0.0, 0.0, -index])), folder / f"depth{index}.exr")
    write_poses(folder / "poses.json", entries)
    return [folder / name for name in names]


def pair_arguments(folder: Path, images: list[Path], output: object = "out.mp4", *more: object) -> list[object]:
    """A short and cheap interpolation; relative outputs are put into ``folder``."""
    return ["interpolate", *images, "--poses", folder / "poses.json", "-o", folder / str(output),
            "--frames", 3, "--threads", 1, "--encoder-preset", "ultrafast", *more]  # fmt: skip


def folder_arguments(folder: Path, images: list[Path], *more: object) -> list[object]:
    """The same into a folder of frames, which needs no encoder."""
    return ["interpolate", *images, "--poses", folder / "poses.json", "-o", folder / "out", "--frames", 3,
            "--threads", 1, *more]  # fmt: skip


def listing(folder: Path) -> dict[str, int]:
    """Every file below a folder, hidden ones too, with its size; folders end in a slash."""
    return {
        str(path.relative_to(folder)) + ("/" if path.is_dir() else ""): 0 if path.is_dir() else path.lstat().st_size
        for path in sorted(folder.rglob("*"))
    }
