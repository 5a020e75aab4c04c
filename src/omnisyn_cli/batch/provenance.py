"""What a result was made of: the files and the networks with their hashes, the poses, the options.

Files are named relative to the manifest: records are passed on with videos, and tell nothing about the machine.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from omnisyn_cli.batch.manifest import NETWORK_OPTIONS, BatchJob
from omnisyn_cli.errors import OmnisynError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.configs import video_config
from omnisyn_cli.interpolation.job import INPUT_FILES, INPUT_LISTS
from omnisyn_cli.io.outputs import relative_name
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, read_poses
from omnisyn_cli.runtime import models

FileStamp = tuple[str, int, int]


def file_stamp(path: Path) -> FileStamp:
    """Name, bytes and time of the last change (nanoseconds): where these are equal the content is taken to be."""
    status = path.stat()
    return str(path), status.st_size, status.st_mtime_ns


def hash_file(path: Path) -> dict[str, Any]:
    """Hash of a file with the stamp that it belongs to; hashes of None if the file cannot be read."""
    try:
        _, size, changed = stamp = file_stamp(path)
        return {"sha256": _hash(stamp), "bytes": size, "changed": changed}
    except OSError:
        return {"sha256": None, "bytes": None, "changed": None}


def files_of(job: BatchJob) -> Iterator[Path]:
    """Every file that is read for a job."""
    yield from _settings_and_files(job)[1]
    yield job.poses


def job_sources(job: BatchJob) -> dict[str, Any]:
    """What the result of a job depends on, as plain values for JSON."""
    settings, files = _settings_and_files(job)
    return {**settings, "files": {relative_name(path, job.folder): hash_file(path) for path in files}}


def has_same_sources(job: BatchJob, recorded: Any) -> bool:
    """Whether a job would be made of the same as a recorded one; files are only read if they have been touched."""
    if not isinstance(recorded, dict):
        return False
    known, (settings, files) = recorded.get("files"), _settings_and_files(job)
    if not isinstance(known, dict) or any(recorded.get(key) != value for key, value in settings.items()):
        return False
    named = {relative_name(path, job.folder): path for path in files}
    return named.keys() == known.keys() and all(_is_same(path, known[name]) for name, path in named.items())


def digest_of_network(name: str, sources: Mapping[str, Any], job: BatchJob) -> str | None:
    """The digest of a network, by its name or path, in what :func:`job_sources` says of a job that uses it."""
    if _is_path(name):
        known = sources["files"].get(relative_name(Path(name), job.folder), {}).get("sha256")
    else:
        known = sources["models"].get(Path(name).name)
    return None if known is None else str(known)


def _settings_and_files(job: BatchJob) -> tuple[dict[str, Any], list[Path]]:
    """Settings as plain values, and the files, but for the pose file, of which only the entries of panoramas count."""
    entries = _entries(job)
    networks = _networks(job, entries)
    named = [Path(name).name for name in networks if not _is_path(name)]
    installed = _installed() if named else {}
    options = dict(job.options)
    for key in options.keys() & {*INPUT_LISTS}:
        options[key] = [relative_name(job.folder / file, job.folder) for file in options[key]]
    for key in (*NETWORK_OPTIONS, *INPUT_FILES):
        if Path(network := options.get(key, "")).is_absolute():
            options[key] = relative_name(Path(network), job.folder)
    settings = {
        "inputs": [relative_name(image, job.folder) for image in job.images],
        "outputs": job.outputs,
        "options": json.loads(json.dumps(options, default=str)),
        "poses": [[entry.pose.position.tolist(), entry.pose.rotation.tolist()] for entry in entries],
        "models": {name: installed[name].sha256 if name in installed else None for name in named},
    }
    # networks of manifests are not among the files: they lie elsewhere on every machine
    companions = (file for entry in entries for file in entry.companions)
    own_networks = (Path(name) for name in networks if _is_path(name))
    return settings, list(dict.fromkeys((*job.images, *job.input_files, *companions, *own_networks)))


def _networks(job: BatchJob, entries: Sequence[PosedPanorama]) -> tuple[str, ...]:
    """Names and paths of the networks that a job uses; none where it cannot be done, as the job itself will say."""
    bare = [PosedPanorama(Pose.identity())] * len(job.images)  # what there is where poses are found in the pictures
    try:
        return video_config(job.interpolation(Path()), entries or bare).networks
    except OmnisynError:
        return ()


def _is_path(network: str) -> bool:
    return network.endswith(".onnx") and Path(network).parent != models.added_models_folder()


def _installed() -> Mapping[str, models.ModelEntry]:
    """The networks of the program and added ones, by name or file; these are compared with it when they are loaded."""
    found: dict[str, models.ModelEntry] = {}
    for folder in (models.models_folder(), models.added_models_folder()):
        with suppress(OmnisynError, OSError):
            entries = _manifest(file_stamp(folder / models.MANIFEST))
            found |= {**entries, **{entry.file: entry for entry in entries.values()}}
    return found


@lru_cache(maxsize=2)
def _manifest(stamp: FileStamp) -> Mapping[str, models.ModelEntry]:
    return models.read_manifest(Path(stamp[0]).parent)


def _entries(job: BatchJob) -> list[PosedPanorama]:
    try:
        poses = _poses(file_stamp(job.poses), bool(job.options.get("allow_outside")))
        return [poses.of(image) for image in job.images]
    except (OmnisynError, OSError):  # gone since the manifest was read: the job itself says why it cannot be done
        return []


@lru_cache(maxsize=64)
def _poses(stamp: FileStamp, allow_outside: bool) -> PoseFile:
    return read_poses(Path(stamp[0]), allow_outside=allow_outside)


@lru_cache(maxsize=4096)
def _hash(stamp: FileStamp) -> str:
    return models.sha256_of(Path(stamp[0]))


def _is_same(path: Path, recorded: Any) -> bool:
    if not isinstance(recorded, dict) or not {"sha256", "bytes", "changed"} <= recorded.keys():
        return False
    try:
        _, size, changed = file_stamp(path)
    except OSError:
        return recorded["sha256"] is None
    is_touched = changed != recorded["changed"]
    return size == recorded["bytes"] and not (is_touched and hash_file(path)["sha256"] != recorded["sha256"])
