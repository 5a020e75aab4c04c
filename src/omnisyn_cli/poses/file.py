"""``poses.json``: position and rotation of each panorama, validated with errors that say what to correct.

Version 1. Per panorama ``position`` with ``rotation`` ``[w, x, y, z]`` or ``matrix`` (3×3, or 4×4 that holds the
position too; camera-to-world), or ``latitude, longitude, altitude, heading`` with ``pitch, roll``; optionally ``depth``
and ``mask``, file names relative to the pose file.
"""

import difflib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.io.documents import listed, read_json, validated
from omnisyn_cli.io.outputs import check_output, write_parts
from omnisyn_cli.poses.entries import (
    GEOGRAPHIC_KEYS,
    RIGID_KEYS,
    GeographicEntry,
    PoseDocument,
    RigidEntry,
    entry_origin,
    path_problem,
    pose_from_entry,
    rigid_rotation,
)

__all__ = [
    "POSES_NAME",
    "PoseFile",
    "PosedPanorama",
    "check_companions_named",
    "check_names_tell_apart",
    "read_poses",
    "write_poses",
]

POSES_NAME = "poses.json"
"""What a pose file is called where a folder stands for its panoramas."""

VERSION = 1

MAX_LISTED_NAMES = 8
"""Names of panoramas in an error."""

MAX_FILE_BYTES = 64 << 20
"""Bytes; a hundred thousand panoramas need less."""


@dataclass(frozen=True)
class PosedPanorama:
    """One panorama's entry.

    Attributes:
        pose: camera-to-world, metres.
        depth: its depth file, or None.
        mask: its mask file, or None.
    """

    pose: Pose
    depth: Path | None = None
    mask: Path | None = None


@dataclass(frozen=True)
class PoseFile:
    """What a pose file says.

    Attributes:
        path: the file.
        panoramas: entries by image file name, in the order of the file.
    """

    path: Path
    panoramas: Mapping[str, PosedPanorama]

    def of(self, image_path: Path | str) -> PosedPanorama:
        """The entry of an image, found by its file name; PoseError: there is none; it names those there are."""
        name = Path(image_path).name
        if name in self.panoramas:
            return self.panoramas[name]
        same = [known for known in self.panoramas if known.lower() == name.lower()]
        near = same or difflib.get_close_matches(name, self.panoramas, n=1)
        hint = f"did you mean '{near[0]}'?" if near else "add an entry for it"
        raise PoseError(
            f"{self.path}: expected an entry for '{name}', got {listed(self.panoramas, MAX_LISTED_NAMES)}; {hint}"
        )


def check_names_tell_apart(images: Iterable[Path]) -> None:
    """Refuse (PoseError) different pictures of one name: a pose file knows panoramas by it. The same may come again."""
    known: dict[str, Path] = {}
    for image in images:
        former = known.setdefault(image.name, image)
        if former.resolve() != image.resolve():
            raise PoseError(f"{image}: expected a name of its own, got that of {former}; rename one of them")


def read_poses(path: Path | str, *, allow_outside: bool = False) -> PoseFile:
    """Read and check a pose file.

    Geographic entries become metres east, up and −north of the first one, which is the origin. Neither images nor
    depth and mask files are looked for.

    With ``allow_outside`` depth and masks may lie outside of the file's folder.
    PoseError: missing, no JSON, not version 1, or an entry that is not a rigid, finite, complete pose.
    """
    source = Path(path)
    return _pose_file(source, read_json(source, "a pose file", MAX_FILE_BYTES), allow_outside)


def write_poses(path: Path | str, panoramas: Mapping[str, PosedPanorama], *, allow_outside: bool = False) -> None:
    """Write a pose file, rotations as quaternions; an existing file is replaced.

    Depth and mask files lie in the folder of ``path``, or anywhere with ``allow_outside``; such a file can only be read
    where that is allowed as well.

    Raises:
        PoseError: a name, pose or file that could not be read back.
        OutputPathError: no folder to write into.
        WriteError: the disk is full, or the folder went away.
    """
    target = Path(path)
    check_output(target, overwrite=True)
    entries = {name: _entry_values(target, name, panorama, allow_outside) for name, panorama in panoramas.items()}
    _pose_file(target, {"version": VERSION, "panoramas": entries}, allow_outside)  # it can be read back
    lines = ",\n".join(f"  {_json(name)}: {_json(entry)}" for name, entry in entries.items())
    write_parts(target, [f'{{"version": {VERSION}, "panoramas": {{\n{lines}\n}}}}\n'.encode()])


def check_companions_named(path: Path, panoramas: Mapping[str, PosedPanorama], *, allow_outside: bool = False) -> None:
    """Refuse (PoseError) depth and mask files that :func:`write_poses` could not name, before any work."""
    for name, panorama in panoramas.items():
        _companion_names(path, name, panorama, allow_outside)


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _pose_file(path: Path, value: Any, allow_outside: bool) -> PoseFile:
    document = validated(path, PoseDocument, value)
    entries = {name: _entry(path, name, entry, allow_outside) for name, entry in document.panoramas.items()}
    _check_one_world(path, entries)
    origin = next((entry_origin(entry) for entry in entries.values() if isinstance(entry, GeographicEntry)), None)
    panoramas = {}
    for name, entry in entries.items():
        files = (None if file is None else path.parent / file for file in (entry.depth, entry.mask))
        panoramas[name] = PosedPanorama(pose_from_entry(entry, f"{path}: panoramas.'{name}'", origin), *files)
    return PoseFile(path, panoramas)


def _entry(path: Path, name: str, value: Any, allow_outside: bool) -> RigidEntry | GeographicEntry:
    """One entry, of the kind that its keys announce."""
    where = ("panoramas", name)
    if (problem := path_problem(name)) or Path(name).name != name:
        raise PoseError(
            f"{path}: panoramas: expected the file name of an image, got '{name}' ({problem or 'with a folder'}); "
            "write the name alone"
        )
    keys = set(value) if isinstance(value, dict) else set()
    rigid, geographic = sorted(keys & RIGID_KEYS), sorted(keys & GEOGRAPHIC_KEYS)
    if rigid and geographic:
        raise PoseError(
            f"{path}: panoramas.'{name}': expected either a position or a geographic place, got {', '.join(rigid)} "
            f"mixed with {', '.join(geographic)}; keep one kind"
        )
    if geographic:
        return validated(path, GeographicEntry, value, where, allow_outside=allow_outside)
    return validated(path, RigidEntry, value, where, allow_outside=allow_outside)


def _check_one_world(path: Path, entries: Mapping[str, RigidEntry | GeographicEntry]) -> None:
    kinds: dict[bool, str] = {}
    for name, entry in entries.items():
        kinds.setdefault(isinstance(entry, GeographicEntry), name)
    if len(kinds) > 1:
        raise PoseError(
            f"{path}: expected all panoramas in one world, got '{kinds[True]}' with latitude and longitude mixed with "
            f"'{kinds[False]}' with a position; write all in the same way"
        )


def _entry_values(path: Path, name: str, panorama: PosedPanorama, allow_outside: bool) -> dict[str, Any]:
    rotation = quaternion_from_rotation(rigid_rotation(f"{path}: panoramas.'{name}'", panorama.pose.rotation))
    pose = {"position": panorama.pose.position.tolist(), "rotation": rotation.tolist()}
    return {**pose, **_companion_names(path, name, panorama, allow_outside)}


def _companion_names(path: Path, name: str, panorama: PosedPanorama, allow_outside: bool) -> dict[str, str]:
    """The names by which a pose file calls depth and mask of an entry."""
    files = {"depth": panorama.depth, "mask": panorama.mask}
    return {k: _relative(path, name, k, file, allow_outside) for k, file in files.items() if file is not None}


def _relative(path: Path, name: str, key: str, file: Path, allow_outside: bool) -> str:
    folder = path.parent
    is_below = ".." not in file.parts and file.absolute().is_relative_to(folder.absolute())
    if allow_outside and not is_below:
        place = file.parent.resolve()
        try:
            return Path(os.path.relpath(place, folder.resolve()), file.name).as_posix()
        except ValueError:  # another drive
            return (place / file.name).as_posix()
    try:
        return file.absolute().relative_to(folder.absolute()).as_posix()
    except ValueError as error:
        raise PoseError(
            f"{path}: panoramas.'{name}'.{key}: expected a file in the folder of the pose file, got '{file}'; "
            "write the pose file beside it, or allow files elsewhere (--allow-outside)"
        ) from error
