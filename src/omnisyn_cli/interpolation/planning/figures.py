"""What settings cost and what they are worth: figures of a bench, and which settings are worth choosing.

Cost is computing: seconds of one core, those of the encoder included, so that it hardly depends on what else the
machine does. :mod:`.duration` makes seconds on the clock of them.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import fmean, stdev
from typing import Literal

from pydantic import ConfigDict, TypeAdapter

from omnisyn_cli import __version__
from omnisyn_cli.errors import InputError
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.pipeline.config import RunConfig

# ``encode`` is what is in no other stage: samples are converted, and the encoder works.
FRAME_STAGES = ("render", "fuse", "encode")
STANDARD_FRAMES = 90  # frames of the clip that settings are compared by: three seconds between two panoramas
TABLE_VERSION = 2  # raised whenever old tables cannot be read any more


@dataclass(frozen=True)
class Setting:
    """What can be chosen: a method (:func:`omnisyn_cli.evaluation.methods.find_method`), (height, width), threads."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    method: str
    size: tuple[int, int]
    threads: int

    @property
    def name(self) -> str:
        """In a few words."""
        threads = "1 thread" if self.threads == 1 else f"{self.threads} threads"
        return f"{self.method}, {self.size[1]}x{self.size[0]}, {threads}"


@dataclass(frozen=True)
class Figures:
    """What was measured of a setting, or the ``reason`` why that failed."""

    setting: Setting
    status: Literal["done", "failed"] = "done"
    reason: str = ""
    config: RunConfig = field(default_factory=RunConfig)  # what the method stands for
    key: str = ""  # digest of what the figures depend on
    source: tuple[int, int] = (0, 0)  # height and width of the panoramas
    # of computing by stage: ``start`` once; those of :data:`FRAME_STAGES` for each frame; others for each pair
    seconds: Mapping[str, float] = field(default_factory=dict)
    probe: float = 0.0  # seconds of :func:`omnisyn_cli.interpolation.planning.duration.probe` on that machine
    memory: int | None = None  # bytes at most, without the encoder; None where nobody knows
    # WS-PSNR in dB by the name of the pair, the mean of its true frames
    scores: Mapping[str, float] = field(default_factory=dict)
    pairs: int = 0  # panoramas between which clips were made

    @property
    def ws_psnr(self) -> float | None:
        """Mean over pairs in dB."""
        return fmean(self.scores.values()) if self.scores else None


FIGURES = TypeAdapter(Figures)  # makes figures of the plain values again


def gain(figures: Figures, other: Figures) -> tuple[float, float]:
    """Mean and standard error, in dB, of how much better one is on pairs that both have; NaN without enough of them."""
    gains = [score - other.scores[pair] for pair, score in figures.scores.items() if pair in other.scores]
    error = stdev(gains) / math.sqrt(len(gains)) if len(gains) > 1 else math.nan
    return (fmean(gains) if gains else math.nan), error


def _seconds(figures: Figures) -> Mapping[str, float]:
    return figures.seconds or dict.fromkeys(("start", "decode", "depth", *FRAME_STAGES), math.nan)


def pair_stages(figures: Figures) -> list[str]:
    """Stages that each pair goes through, in order."""
    return [stage for stage in _seconds(figures) if stage not in {"start", *FRAME_STAGES}]


def first_seconds(figures: Figures) -> float:
    """Computing before the first frame."""
    return math.fsum(_seconds(figures)[stage] for stage in ("start", *pair_stages(figures)))


def frame_seconds(figures: Figures) -> float:
    """Computing for each further frame."""
    return math.fsum(_seconds(figures)[stage] for stage in FRAME_STAGES)


def standard_seconds(figures: Figures) -> float:
    """Computing for :data:`STANDARD_FRAMES` between two panoramas, of the size that was measured."""
    return first_seconds(figures) + STANDARD_FRAMES * frame_seconds(figures)


def quality(figures: Figures) -> float:
    """WS-PSNR in dB; minus infinity where it is not known."""
    return -math.inf if figures.ws_psnr is None else figures.ws_psnr


def pareto_front(measured: Iterable[Figures]) -> list[Figures]:
    """Those with an accuracy that no other one is both as fast and as accurate as, the fastest first."""
    rated = [figures for figures in measured if figures.status == "done" and figures.ws_psnr is not None]
    front: list[Figures] = []
    for figures in sorted(rated, key=lambda each: (standard_seconds(each), -quality(each))):
        if not front or quality(figures) > quality(front[-1]):
            front.append(figures)
    return front


def write_table(path: Path, machine: str, measured: Sequence[Figures]) -> None:
    """Write all figures as JSON over what is there; WriteError: the disk is full, or there is no such folder."""
    done = [asdict(figures) for figures in measured if figures.status == "done"]
    content = {"version": TABLE_VERSION, "omnisyn": __version__, "machine": machine, "figures": done}
    text = json.dumps(content, allow_nan=False).replace('{"setting"', '\n{"setting"')  # a line for each
    write_parts(path, [f"{text}\n".encode()])


def read_table(path: Path) -> tuple[Figures, ...]:
    """The figures that :func:`write_table` wrote, all of one machine; InputError: it cannot be read, or is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["version"] != TABLE_VERSION:
            raise ValueError(f"version {content['version']!s:.60}")
        return tuple(FIGURES.validate_python(values) for values in content["figures"])
    except (OSError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: expected a table of version {TABLE_VERSION} from `omnisyn bench --store`, got '{error!s:.200}'; "
            "write it anew"
        ) from error
