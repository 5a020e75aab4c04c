"""What settings cost and what they are worth: figures, the time that a job will take, and which settings to choose.

The model of time: what is done once, plus what each pair takes, plus what each frame takes in proportion to its
pixels, all in proportion to how fast the machine is at one fixed piece of work (:mod:`.calibration`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, TypeAdapter

from omnisyn_cli import __version__
from omnisyn_cli.errors import InputError
from omnisyn_cli.io.outputs import write_parts

__all__ = ["write_table"]

FRAME_STAGES = ("render", "fuse", "encode", "convert")
"""``encode`` is the time that the other stages waited for the encoder; ``convert`` makes samples of floats."""

STANDARD_FRAMES = 90
"""Frames of the clip that settings are compared by: three seconds between two panoramas."""

VERSION = 1


@dataclass(frozen=True)
class Setting:
    """What can be chosen.

    Attributes:
        preset: a name of :data:`omnisyn_cli.synthesis.presets.PRESETS`.
        depth_rows: that depth is looked for at, which is the density of the mesh as well.
        size: height and width of the frames.
        threads: at most this many.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    preset: str
    depth_rows: int
    size: tuple[int, int]
    threads: int

    @property
    def name(self) -> str:
        """In a few words."""
        threads = "1 thread" if self.threads == 1 else f"{self.threads} threads"
        return f"{self.preset}, {self.depth_rows} rows, {self.size[1]}x{self.size[0]}, {threads}"


@dataclass(frozen=True)
class Figures:
    """What was measured of a setting.

    Attributes:
        setting: which.
        status: ``failed`` has a ``reason``.
        key: hash of everything that the figures depend on, the machine excepted.
        source: height and width of the panoramas.
        seconds: wall time by stage: ``start`` once, :data:`FRAME_STAGES` for each frame, all others for each pair.
        calibration: seconds of the fixed piece of work, beside these.
        memory: bytes at the peak, without the encoder; None where the system does not tell.
        ws_psnr: mean over the true frames, dB; None where there are none.
        pairs: how many it is the mean of.
        encoder: wall time that the encoder alone takes for each frame of the first clip, beside these.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    setting: Setting
    status: Literal["done", "failed"] = "done"
    reason: str = ""
    key: str = ""
    source: tuple[int, int] = (0, 0)
    seconds: Mapping[str, float] = field(default_factory=dict)
    calibration: float = 0.0
    memory: int | None = None
    ws_psnr: float | None = None
    pairs: int = 0
    encoder: float | None = None

    @property
    def to_encoder(self) -> float | None:
        """Time of a standard clip in that of encoding its frames alone."""
        return None if self.encoder is None else standard_seconds(self) / (STANDARD_FRAMES * self.encoder)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


FIGURES = TypeAdapter(Figures)
"""Makes figures of the plain values again."""


@dataclass(frozen=True)
class Workload:
    """A job as far as time depends on it, and the machine that does it.

    Attributes:
        panoramas: two or more.
        frames: of the whole video.
        size: height and width of the frames.
        source: height and width of the largest panorama.
        calibration: seconds that this machine takes for the fixed piece of work now.
        finds_depth: False where depth is read from files.
    """

    panoramas: int
    frames: int
    size: tuple[int, int]
    source: tuple[int, int]
    calibration: float
    finds_depth: bool = True


def expected_seconds(figures: Figures, work: Workload) -> float:
    """Seconds that a job is expected to take with a setting that was measured."""
    seconds = _seconds(figures)
    source = math.prod(work.source) / math.prod(figures.source)
    decode = seconds["decode"] * source * work.panoramas / 2
    skipped = {"decode"} if work.finds_depth else {"decode", "depth"}
    pairs = (work.panoramas - 1) * math.fsum(seconds[s] for s in pair_stages(figures) if s not in skipped)
    frames = work.frames * frame_seconds(figures) * math.prod(work.size) / math.prod(figures.setting.size)
    return (seconds["start"] + decode + pairs + frames) * work.calibration / figures.calibration


def standard_seconds(figures: Figures) -> float:
    """Seconds for :data:`STANDARD_FRAMES` between two panoramas, on the machine and of the size that was measured."""
    return first_seconds(figures) + STANDARD_FRAMES * frame_seconds(figures)


def first_seconds(figures: Figures) -> float:
    """Seconds before the first frame."""
    seconds = _seconds(figures)
    return seconds["start"] + math.fsum(seconds[stage] for stage in pair_stages(figures))


def pair_stages(figures: Figures) -> list[str]:
    """Stages that each pair goes through, in order."""
    return [stage for stage in _seconds(figures) if stage not in {"start", *FRAME_STAGES}]


def frame_seconds(figures: Figures) -> float:
    """Seconds for each further frame."""
    return math.fsum(_seconds(figures)[stage] for stage in FRAME_STAGES)


def pareto_front(measured: Iterable[Figures]) -> list[Figures]:
    """Those that no other one is both faster and more accurate than, the fastest first.

    Of several equally fast ones only the most accurate is in it. Figures without accuracy are not.
    """
    rated = [figures for figures in measured if figures.status == "done" and figures.ws_psnr is not None]
    front: list[Figures] = []
    for figures in sorted(rated, key=lambda each: (standard_seconds(each), -quality(each))):
        if not front or quality(figures) > quality(front[-1]):
            front.append(figures)
    return front


def nearest_figures(
    measured: Iterable[Figures], preset: str, rows: int, size: tuple[int, int], threads: int
) -> Figures | None:
    """The figures of a preset whose threads and, among those, whose frames are the nearest; None: not measured."""
    return min(
        (f for f in measured if f.setting.preset == preset and f.setting.depth_rows == rows),
        key=lambda f: (_ratio(f.setting.threads, threads), _ratio(math.prod(f.setting.size), math.prod(size))),
        default=None,
    )


def write_table(path: Path, machine: str, measured: Sequence[Figures]) -> None:
    """Write the figures of all settings that were measured as JSON; an existing file is replaced.

    Raises:
        WriteError: the disk is full, or there is no such folder.
    """
    done = [figures.to_json() for figures in measured if figures.status == "done"]
    content = {"version": VERSION, "omnisyn": __version__, "machine": machine, "figures": done}
    write_parts(path, [(json.dumps(content, indent=1, allow_nan=False) + "\n").encode()])


def read_table(path: Path) -> tuple[Figures, ...]:
    """The figures that :func:`write_table` wrote, all of one machine.

    Raises:
        InputError: it cannot be read, or is none.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["version"] != VERSION:
            raise ValueError(f"version {content['version']}")
        return tuple(FIGURES.validate_python(values) for values in content["figures"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: expected a table of version {VERSION} from `omnisyn bench --store`, got '{error}'; write it anew"
        ) from error


def _seconds(figures: Figures) -> Mapping[str, float]:
    return figures.seconds or dict.fromkeys(("start", "decode", "depth", *FRAME_STAGES), math.nan)


def quality(figures: Figures) -> float:
    """WS-PSNR in dB; minus infinity where it is not known."""
    return -math.inf if figures.ws_psnr is None else figures.ws_psnr


def _ratio(first: float, second: float) -> float:
    """How far two positive numbers are from equal."""
    return abs(math.log(first / second))
