"""What was measured, as values that a line of JSON can hold, and what that depends on, as a hash.

``results.jsonl`` in the folder of a report has one line for each finished unit, one method on one pair. It is appended
and never changed; a later line about the same unit counts instead, a last one that was cut short does not.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any, Literal

from pydantic import ConfigDict, TypeAdapter

import omnisyn_cli
from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.evaluation.datasets.sources import Pair
from omnisyn_cli.io.documents import complete_lines
from omnisyn_cli.runtime.models import sha256_of

RESULTS_NAME = "results.jsonl"  # a line per finished unit

# ``done``: measured. ``unavailable``: the method cannot work on this pair. ``skipped``: a scene has no pair that can
# be measured. ``failed``: a file is damaged, or the method broke. All but ``done`` have a ``reason``.
Status = Literal["done", "unavailable", "skipped", "failed"]


@dataclass(frozen=True)
class FrameRecord:
    """One frame between two panoramas, compared with the truth if there is one."""

    name: str  # of the true frame, as the data set calls it, or ``half way``
    t: float  # share of the way from the first panorama to the second, by distance, in (0, 1)
    distance: float  # metres to the nearer of the two panoramas
    # ``ws_psnr``, ``psnr``, ``psnr_top`` and ``psnr_bottom``, which may be infinite, ``ws_ssim``, ``ssim``, ``lrce``;
    # ``change_psnr`` of all but the first, see :func:`omnisyn_cli.evaluation.measure.change_psnr`; ``flying``
    # where true depth is known, and ``shards`` of all frames, the only one without a true frame, see
    # :mod:`omnisyn_cli.evaluation.metrics.artefacts`.
    scores: Mapping[str, float]
    # ``frame``, ``truth``, ``error`` -> file, relative to the report, with "/"; may be empty
    pictures: Mapping[str, str] = field(default_factory=dict)
    # ``psnr`` (dB), ``area`` (share of the sphere), ``error`` (share of the squared error) -> kind of pixel -> number;
    # kinds that there are no pixels of are missing
    by_kind: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class DepthRecord:
    """The depth that a method found for one of the two panoramas, compared with the truth where there is one."""

    view: str  # name of the panorama
    # see :func:`omnisyn_cli.evaluation.metrics.depth.depth_metrics`, every pixel counts alike; empty without truth
    plain: Mapping[str, float] = field(default_factory=dict)
    weighted: Mapping[str, float] = field(default_factory=dict)  # the same, pixels weighted by solid angle
    # ``depth`` and ``truth`` -> file in the Turbo colours, relative to the folder of the report
    pictures: Mapping[str, str] = field(default_factory=dict)
    # ``unsure_area``, ``within_5_unsure``, ``within_5_sure``, ``rank_correlation``, ``calibration_error``, see
    # :mod:`omnisyn_cli.evaluation.metrics.depth`; some are missing where nothing was matched or doubted
    doubt: Mapping[str, float] = field(default_factory=dict)
    # ``area``, ``confidence``, ``within_5``, ``within_10`` -> middle of a bin of confidence -> number
    reliability: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class UnitRecord:
    """What became of one method on one pair of panoramas."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    key: str  # hash of everything the result depends on: files, poses, method, options, program
    scene: str  # name of the scene
    # names of the two panoramas; empty where the scene could not be read
    first: str
    second: str
    method: str  # name of the method; empty where the scene itself was skipped or is broken
    status: Status  # see :data:`Status`
    reason: str = ""  # one line; empty if done
    baseline: float = math.nan  # metres from the first to the second panorama; NaN where the scene could not be read
    # metres, of the first panorama: true, or as found where the truth are photographs; else None
    median_depth: float | None = None
    size: tuple[int, int] = (0, 0)  # height and width of the frames that were compared, (0, 0) where there are none
    # one for every true frame between, in walking order; one half way where there are none
    frames: tuple[FrameRecord, ...] = ()
    depths: tuple[DepthRecord, ...] = ()  # of the first and of the second panorama; empty for methods without depth
    # ``warping_error``, ``flicker`` (see :mod:`omnisyn_cli.evaluation.measure`), and ``end_first``,
    # ``end_second``: root mean square difference, weighted by solid angle, between what the method makes at the place
    # of a panorama and that panorama. Measures that a method does not allow are missing.
    temporal: Mapping[str, float] = field(default_factory=dict)
    # wall time by stage: ``depth``, ``mesh``, ``render``, ``fuse`` and the like; ``total`` is their sum
    seconds: Mapping[str, float] = field(default_factory=dict)
    # ``ws_psnr`` and ``change_psnr`` -> name of the frame that has the least of it
    worst: Mapping[str, str] = field(default_factory=dict)

    @property
    def pair(self) -> tuple[str, str, str]:
        """Scene, first and second panorama."""
        return self.scene, self.first, self.second

    @property
    def unit(self) -> tuple[str, str, str, str]:
        """What the record is about: scene, both panoramas, method."""
        return self.scene, self.first, self.second, self.method

    def to_json(self) -> dict[str, Any]:
        """Plain values for strict JSON, see :func:`json_values`."""
        return dict(json_values(asdict(self)))


RECORD = TypeAdapter(UnitRecord)  # makes records of the plain values of :meth:`UnitRecord.to_json` again


def mean(values: Iterable[float]) -> float:
    """Arithmetic mean; NaN of nothing, infinite if one value is."""
    listed = list(values)
    return fmean(listed) if listed else math.nan


def worst_frames(frames: Sequence[FrameRecord]) -> dict[str, str]:
    """The name of the frame with the least ``ws_psnr``, and of that with the least ``change_psnr``, if any has it."""
    having = {score: [frame for frame in frames if score in frame.scores] for score in ("ws_psnr", "change_psnr")}
    return {score: min(some, key=lambda f: f.scores[score]).name for score, some in having.items() if some}


def json_values(value: Any) -> Any:
    """Plain values for strict JSON; infinite and undefined numbers become the strings "inf", "-inf" and "nan"."""
    if isinstance(value, Mapping):
        return {key: json_values(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_values(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def read_records(folder: Path) -> list[UnitRecord]:
    """All complete lines of ``folder/results.jsonl``, if any; InputError: unreadable, or a line is no record."""
    path, records = folder / RESULTS_NAME, []
    for number, line in enumerate(complete_lines(path), start=1):
        try:
            records.append(RECORD.validate_python(json.loads(line)))
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"{path}: expected a record in line {number}, got '{error!s:.200}'; remove the file or name another "
                "folder"
            ) from error
    return records


RECORD_VERSION = 3  # counts up when the same inputs are measured or recorded in another way
IGNORED_ROOMS = frozenset({"batch", "cli", "networks", "training"})  # parts of the program that no method goes through


@cache
def digest_of_sources(package: Path) -> str:
    """Of a package's files but for :data:`IGNORED_ROOMS`: between two releases only this tells a change."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package)
        if name.parts[0] not in IGNORED_ROOMS:
            digest.update(f"{name.as_posix()}\n{path.stat().st_size}\n".encode() + path.read_bytes())
    return digest.hexdigest()


class Fingerprints:
    """Hashes of units; every file is read once."""

    def __init__(self) -> None:
        self._files: dict[Path, str] = {}
        self._program = [RECORD_VERSION, omnisyn_cli.__version__, digest_of_sources(Path(omnisyn_cli.__file__).parent)]

    def of(self, pair: Pair, method: Sequence[str], options: Mapping[str, Any]) -> str:
        """Digest of all that a method (name, ingredients) on a pair depends on; ImageError: an unreadable file."""
        frames = [
            [frame.name, frame.pose.position.tolist(), frame.pose.rotation.tolist(), *map(self.of_file, frame.files)]
            for frame in (pair.first, pair.second, *pair.between, pair.before, pair.after)
            if frame is not None
        ]
        described = [*self._program, list(method), dict(options), frames]
        return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()

    def of_file(self, path: Path) -> str:
        """Hexadecimal digest of a file's content; ImageError: it is missing or cannot be read."""
        if path not in self._files:
            try:
                self._files[path] = sha256_of(path)
            except OSError as error:
                raise ImageError(f"{path}: expected a file, got '{error.strerror}'; check the scene") from error
        return self._files[path]
