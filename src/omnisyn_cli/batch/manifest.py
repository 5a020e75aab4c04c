"""The manifest of a batch: a job a line, JSONL or CSV, checked whole before anything starts; see ``docs/batch.md``."""

import math
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import ValidationError

from omnisyn_cli.batch.schema import LINE_FIELDS, Line, problem_sentences, read_lines
from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.interpolation import checks
from omnisyn_cli.interpolation import job as jobs
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import frame_count
from omnisyn_cli.io import check_encoding
from omnisyn_cli.io.encode import NUMBER
from omnisyn_cli.io.outputs import TEMPORARY_PREFIX, real_path
from omnisyn_cli.poses.file import POSES_NAME, PoseFile, read_poses

RECORDS = "results.jsonl"  # file in the folder of a batch that says what became of every job
MIN_EVEN_SIZE = (2, 4)  # rows and columns that every encoder takes
NETWORK_OPTIONS = ("model", "depth_prior")  # options that may be paths of networks, from the folder of the manifest


@dataclass(frozen=True)
class BatchJob:
    """One line that has been checked."""

    id: str  # unique in the manifest
    images: tuple[Path, ...]  # panoramas, in walking order
    poses: Path  # pose file that names them all, or ``auto`` where they are found in the pictures
    outputs: dict[str, str]  # by kind (``output``, ``save_depth``, …) the place below the folder of the batch
    # of the interpolation, as the manifest names and writes them (angles in degrees), but for file names, which are
    # absolute; defaults are left out
    options: dict[str, Any]
    group: str | None = None  # jobs that share panoramas
    folder: Path = Path()  # of the manifest, absolute: records name files relative to it

    @property
    def places(self) -> list[str]:
        """Files and folders below the folder of the batch that the job makes; for numbered images their folder."""
        return [str(_inside(place)) for place in self.outputs.values()]

    @property
    def size(self) -> tuple[int, int] | None:
        """Height and width of the video, if the line says them."""
        width, _, height = self.options.get("size", "").partition("x")
        return (int(height), int(width)) if height else None

    @property
    def input_files(self) -> tuple[Path, ...]:
        """What is read besides panoramas, their poses and what these name."""
        return jobs.input_files(self.interpolation(Path()))

    def interpolation(self, folder: Path, threads: int | None = None) -> InterpolationJob:
        """The job as ``omnisyn interpolate`` would do it, with outputs in ``folder``."""
        options = {**self.options, "size": self.size}
        options |= {key: Path(options[key]) for key in jobs.INPUT_FILES if key in options}
        options |= {key: tuple(map(Path, options[key])) for key in jobs.INPUT_LISTS if key in options}
        for angle in {"nadir", "hfov", "vfov", "fov"} & options.keys():
            options[angle] = math.radians(options[angle])
        places: dict[str, Any] = {kind: folder / place for kind, place in self.outputs.items()}
        return InterpolationJob(images=self.images, poses=self.poses, threads=threads, **places, **options)


@dataclass(frozen=True)
class Manifest:
    """What a manifest says."""

    path: Path  # the file
    jobs: tuple[BatchJob, ...]  # in the order of the file
    # one line each, with the number of the line in the file; no job may be started if there are any
    problems: tuple[str, ...]


def read_manifest(path: Path) -> Manifest:
    """Check a manifest's lines, files and places; pictures stay closed. InputError: it is unreadable or empty."""
    reader = _Reader(path)
    for number, value in read_lines(path):
        reader.take(number, value)
    if not reader.jobs and not reader.problems:
        raise InputError(f"{path}: expected at least one job, got none; write one a line")
    return Manifest(path, tuple(reader.jobs), tuple(reader.problems))


class _Reader:
    """Takes lines one after another; what is wrong goes to ``problems``, what is right to ``jobs``."""

    def __init__(self, path: Path) -> None:
        self.jobs: list[BatchJob] = []
        self.problems: list[str] = []
        self._folder = real_path(path.parent)
        self._ids: dict[str, int] = {}
        self._places: dict[PurePosixPath, int] = {}
        self._parents: dict[PurePosixPath, int] = {}
        self._exists = lru_cache(maxsize=None)(os.path.isfile)  # which raises nothing, whatever the name
        self._resolved = lru_cache(maxsize=4096)(real_path)
        self._poses = lru_cache(maxsize=256)(_poses_or_problem)

    def take(self, number: int, value: dict[str, Any] | str) -> None:
        """Check one line."""
        try:
            if isinstance(value, str):
                raise InputError(value)
            job = self._job(Line.model_validate(value))
            self._check_unique(job, number)
            _check_feasible(job.interpolation(Path()))
        except ValidationError as error:
            self.problems.extend(f"line {number}: {problem}" for problem in problem_sentences(error))
        except InputError as error:
            self.problems.append(f"line {number}: {error}")
        else:
            self.jobs.append(job)

    def _job(self, line: Any) -> BatchJob:
        if line.scene is None and (line.inputs is None or line.poses is None):
            raise InputError("expected inputs with poses, or a scene, got neither; name one of them")
        base = self._folder / (line.scene or "")
        poses = base / POSES_NAME if line.poses is None else self._folder / line.poses
        is_found = line.poses is not None and Path(line.poses) == jobs.POSES_FROM_PICTURES
        poses = jobs.POSES_FROM_PICTURES if is_found else self._place(poses)
        pose_file = None if is_found else self._poses(poses, line.allow_outside)
        if isinstance(pose_file, str):
            raise InputError(pose_file)
        names = line.inputs or _ends(pose_file)
        images = tuple(self._file(base / name, "a panorama") for name in names)
        if pose_file is not None:
            for image in images:
                pose_file.of(image)
        options = line.model_dump(exclude=set(LINE_FIELDS), exclude_defaults=True)
        faces = str(jobs.FACES)
        for key in options.keys() & {*jobs.INPUT_LISTS}:
            files = (name if name == faces else self._file(self._folder / name, "a mask") for name in options[key])
            options[key] = [*map(str, files)]
        for key in options.keys() & {*jobs.INPUT_FILES}:
            options[key] = str(self._file(self._folder / options[key], f"a file for {key}"))
        for key in NETWORK_OPTIONS:
            if (network := options.get(key)) is not None and self._exists(self._folder / network):
                options[key] = str(self._place(self._folder / network))
        outputs = {kind: place for kind in jobs.OUTPUTS if (place := getattr(line, kind)) is not None}
        outputs.setdefault("output", f"{line.id}.mp4")
        return BatchJob(line.id, images, poses, outputs, options, line.group, self._folder)

    def _file(self, path: Path, what: str) -> Path:
        """A place where there is a file."""
        place = self._place(path)
        if not self._exists(place):
            raise InputError(f"expected {what}, got no file {place}; check the name")
        return place

    def _place(self, path: Path) -> Path:
        """Absolute and without dots; the name itself may be that of a link."""
        try:
            return Path(self._resolved(path.parent), path.name)
        except (OSError, ValueError) as error:
            raise InputError(f"expected a file name, got '{path!s:.60}' ({error!s:.60}); correct it") from error

    def _check_unique(self, job: BatchJob, number: int) -> None:
        if (former := self._ids.setdefault(job.id, number)) != number:
            raise InputError(f"expected a new id, got {job.id!r} as in line {former}; ids are unique")
        for place in map(PurePosixPath, job.places):
            claims = [self._places.get(place), self._parents.get(place)]
            claims += [self._places.get(parent) for parent in place.parents]
            if (former_line := next((claim for claim in claims if claim is not None), None)) is not None:
                raise InputError(f"expected a place of its own, got {place} of line {former_line}; name another")
            self._places[place] = number
            for parent in place.parents:
                if parent.name:
                    self._parents.setdefault(parent, number)


def _poses_or_problem(path: Path, allow_outside: bool) -> PoseFile | str:
    try:
        return read_poses(path, allow_outside=allow_outside)
    except PoseError as error:
        return str(error)


def _ends(poses: PoseFile | None) -> list[str]:
    """The first and the last panorama of a scene."""
    if poses is None:
        raise InputError("expected inputs where poses are found in the pictures, got none; name them")
    names = list(poses.panoramas)
    if len(names) < 2:
        raise InputError(f"{poses.path}: expected a scene of two or more panoramas, got {len(names)}; add one")
    return [names[0], names[-1]]


def _check_feasible(job: InterpolationJob) -> None:
    """What can be refused without a look at the panoramas; a size that follows from them is always an even one."""
    checks.check_names(job)
    checks.check_choices(job)
    checks.check_method(job)
    checks.check_pose_options(job)
    frame_count(job)
    size = job.size or MIN_EVEN_SIZE
    checks.check_shape(job, size)
    for place, encoding in jobs.targets(job).items():
        check_encoding(place, size=size, **encoding)
    if job.save_confidence is not None:
        check_encoding(job.save_confidence, size=size, fps=job.fps)


def _inside(place: str) -> PurePosixPath:
    """A file or folder below the folder of the batch."""
    path = PurePosixPath(place.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or not path.name or ":" in place:
        raise InputError(f"expected a place inside the folder of the batch, got {place!r}; write a relative name")
    if NUMBER.search(path.name):
        if len(path.parts) < 2:
            raise InputError(f"expected a folder for numbered images, got {place!r}; write one such as a/{place}")
        path = path.parent
    if path.parts[0] == RECORDS or path.parts[0].startswith(TEMPORARY_PREFIX):
        raise InputError(f"expected another name than {path.parts[0]}, which the batch itself uses; choose one")
    return path
