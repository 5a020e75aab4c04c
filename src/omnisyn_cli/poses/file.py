"""``poses.json``: position and rotation of each panorama, validated with errors that say what to correct.

Version 1. Per panorama ``position`` with ``rotation`` ``[w, x, y, z]`` or ``matrix`` (3×3, or 4×4 that holds the
position too; camera-to-world), or ``latitude, longitude, altitude, heading`` with ``pitch, roll``; optionally ``depth``
and ``mask``, file names relative to the pose file, and ``title`` and ``caption``. ``links`` of the file are pairs of
names that a tour leads between, see :mod:`omnisyn_cli.poses.tour_file`. ``"metric": false`` says that the unit of
positions is unknown.
"""

import difflib
import json
import math
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.io.documents import listed, read_json, validated
from omnisyn_cli.io.outputs import check_output, real_path, relative_name, write_parts
from omnisyn_cli.poses import entries as schema

POSES_NAME = "poses.json"  # What a pose file is called where a folder stands for its panoramas
VERSION = 1
MAX_LISTED_NAMES = 8  # Names of panoramas in an error
MAX_FILE_BYTES = 64 << 20  # Bytes; a hundred thousand panoramas need less


@dataclass(frozen=True)
class PoseUncertainty:
    """How well a pose is known relative to that of the entry before: one standard deviation."""

    rotation: float  # radians
    position: float | None  # share of the distance between both, or None where they stand in one place


@dataclass(frozen=True)
class PosedPanorama:
    """One panorama's entry, with its files if there are any."""

    pose: Pose  # camera-to-world, metres
    depth: Path | None = None
    mask: Path | None = None
    title: str = ""  # what a tour calls it; empty where the file says nothing, as the caption
    caption: str = ""  # what a tour says of it
    uncertainty: PoseUncertainty | None = None  # where the pose comes from pictures and the entry is not the first

    @property
    def companions(self) -> tuple[Path, ...]:
        """Its depth and mask file, as far as there are any."""
        return tuple(file for file in (self.depth, self.mask) if file is not None)


@dataclass(frozen=True)
class PoseFile:
    """What a pose file says."""

    path: Path
    # entries by image file name, or by path where that tells images apart, in the order of the file
    panoramas: Mapping[str, PosedPanorama]
    links: tuple[tuple[str, str], ...] | None = None  # that a tour leads along; None where the file does not say
    is_geographic: bool = False  # whether it has places on earth, so that −z is north
    is_metric: bool = True  # whether the unit of positions is known to be the metre

    def of(self, image_path: Path | str) -> PosedPanorama:
        """The entry of an image; PoseError: there is none; it names those there are."""
        return self.panoramas[self.name_of(image_path)]

    def name_of(self, image_path: Path | str) -> str:
        """What the file calls an image: its file name, or its path from some folder on, the longest that there is.

        Accents are the same in one character or in two, as file systems differ in that (NFC, NFD). PoseError: no entry.
        """
        wanted = _same_letters(Path(image_path).absolute())
        parts = {known: _same_letters(Path(known)) for known in self.panoramas}
        found = [known for known, own in parts.items() if wanted[-len(own) :] == own]
        if found:
            return max(found, key=lambda known: len(parts[known]))
        name = Path(image_path).name
        same = [known for known in self.panoramas if known.lower() == name.lower()]
        near = same or difflib.get_close_matches(name, self.panoramas, n=1)
        hint = f"did you mean '{near[0]}'?" if near else "add one, or have poses found (--poses auto)"
        raise PoseError(
            f"{self.path}: expected an entry for '{name}', got {listed(self.panoramas, MAX_LISTED_NAMES)}; {hint}"
        )


def _same_letters(path: Path) -> tuple[str, ...]:
    return tuple(unicodedata.normalize("NFC", part) for part in path.parts)


def stored_file(path: Path) -> Path:
    """A file as it is called on disk, where its name may have the same letters in another Unicode form."""
    if path.exists() or path.name.isascii() or not path.parent.is_dir():
        return path
    wanted = _same_letters(Path(path.name))
    return next((file for file in path.parent.iterdir() if _same_letters(Path(file.name)) == wanted), path)


def distinct_names(images: Sequence[Path]) -> list[str]:
    """File names, or, where different files have one, paths from as many folders above as tell all apart."""
    places = [real_path(image).parts for image in images]
    names = [image.name for image in images]
    for depth in range(1, max(map(len, places)) + 1):
        names = ["/".join(place[-depth:]) for place in places]
        if len(set(names)) == len(set(places)):
            break
    return [image.name if depth == 1 else name for image, name in zip(images, names, strict=True)]


def check_names_tell_apart(images: Iterable[Path], pose_file: PoseFile) -> None:
    """Refuse (PoseError) different pictures of one entry, or without any. The same picture may come again."""
    known: dict[str, Path] = {}
    for image in images:
        former = known.setdefault(pose_file.name_of(image), image)
        if real_path(former) != real_path(image):
            raise PoseError(
                f"{image}: expected an entry of its own in {pose_file.path}, got that of {former}; call both by their "
                f"folders there ('{former.parent.name}/{former.name}')"
            )


def notes_of_place(images: Iterable[Path], poses: Path) -> tuple[str, ...]:
    """A note for pictures that lie elsewhere than the pose file: names alone say which pose is whose."""
    distant = [image for image in images if real_path(image.parent) != real_path(poses.parent)]
    if not distant:
        return ()
    more = f" (and {len(distant) - 1} more)" if len(distant) > 1 else ""
    return (f"{distant[0]}{more}: the pose is taken from {poses}, which lies in another folder",)


def read_poses(path: Path | str, *, allow_outside: bool = False) -> PoseFile:
    """Read and check a pose file.

    Geographic entries become metres east, up and −north of the first one, which is the origin. No other file is looked
    for; with ``allow_outside`` depth and masks, or what they are links to, may lie outside of its folder. PoseError:
    missing, no JSON, not version 1, or an entry that is not a rigid, finite, complete pose.
    """
    source = Path(path)
    return _pose_file(source, read_json(source, "a pose file", MAX_FILE_BYTES), allow_outside)


def write_poses(
    path: Path | str, panoramas: Mapping[str, PosedPanorama], *, allow_outside: bool = False,
    links: Sequence[tuple[str, str]] | None = None, is_metric: bool = True,
) -> None:  # fmt: skip
    """Write a pose file, rotations as quaternions; an existing file is replaced.

    Depth and mask files lie in the folder of ``path``, or anywhere with ``allow_outside``; such a file can only be read
    where that is allowed as well. PoseError: a name, pose or file that could not be read back. OutputPathError: no
    folder to write into. WriteError: the disk is full, or the folder went away.
    """
    target = Path(path)
    check_output(target, overwrite=True)
    entries = {name: _entry_values(target, name, panorama, allow_outside) for name, panorama in panoramas.items()}
    said: dict[str, Any] = {} if links is None else {"links": [list(link) for link in links]}
    document = {"version": VERSION, "panoramas": entries, **said, **({} if is_metric else {"metric": False})}
    _pose_file(target, document, allow_outside)  # it can be read back
    write_parts(target, [_text(document)])


def add_entries(
    known: PoseFile, target: Path, panoramas: Mapping[str, PosedPanorama], links: Sequence[tuple[str, str]] | None
) -> None:
    """Write a pose file with more entries and links: every value that was there stays as it is.

    PoseError: the new file lies in another folder, where names of files would mean others, or places are geographic.
    """
    if real_path(known.path.parent) != real_path(target.parent) or known.is_geographic:
        found = "latitudes (omnisyn poses refine writes metres)" if known.is_geographic else "another folder"
        raise PoseError(f"{target}: expected a place beside {known.path}, and positions in metres, got {found}")
    document = read_json(known.path, "a pose file", MAX_FILE_BYTES)
    entries = {name: _entry_values(target, name, panorama, False) for name, panorama in panoramas.items()}
    document["panoramas"] = {**document["panoramas"], **entries}
    if links is not None:
        document["links"] = [*document["links"], *map(list, links)]
    _pose_file(target, document, allow_outside=True)  # it can be read back
    write_parts(target, [_text(document)])


def _text(document: Mapping[str, Any]) -> bytes:
    """A document with a line for every panorama."""
    lines = ",\n".join(f"  {_json(name)}: {_json(entry)}" for name, entry in document["panoramas"].items())
    others = [f"{_json(key)}: {_json(value)}" for key, value in document.items() if key not in ("version", "panoramas")]
    end = "".join(f",\n{other}" for other in others)
    return f'{{"version": {document["version"]}, "panoramas": {{\n{lines}\n}}{end}}}\n'.encode()


def check_companions_named(path: Path, panoramas: Mapping[str, PosedPanorama], *, allow_outside: bool = False) -> None:
    """Refuse (PoseError) depth and mask files that :func:`write_poses` could not name, before any work."""
    for name, panorama in panoramas.items():
        _companion_names(path, name, panorama, allow_outside)


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _pose_file(path: Path, value: Any, allow_outside: bool) -> PoseFile:
    document = validated(path, schema.PoseDocument, value)
    entries = {name: _entry(path, name, entry, allow_outside) for name, entry in document.panoramas.items()}
    # of each kind the first
    kinds = {isinstance(entry, schema.GeographicEntry): name for name, entry in reversed(entries.items())}
    if len(kinds) > 1:
        raise PoseError(
            f"{path}: expected all panoramas in one world, got '{kinds[True]}' with latitude and longitude mixed with "
            f"'{kinds[False]}' with a position; write all in the same way"
        )
    origin = next((entry.origin for entry in entries.values() if isinstance(entry, schema.GeographicEntry)), None)
    panoramas = {}
    for name, entry in entries.items():
        pose = schema.pose_from_entry(entry, f"{path}: panoramas.'{name}'", origin)
        depth, mask = (
            None if file is None else file_beside(path, file, f"panoramas.'{name}'.{key}", "pose file", allow_outside)
            for key, file in (("depth", entry.depth), ("mask", entry.mask))
        )
        panoramas[name] = PosedPanorama(pose, depth, mask, entry.title, entry.caption, _uncertainty(entry))
    return PoseFile(path, panoramas, _links(path, document, panoramas), origin is not None, document.metric)


def _links(path: Path, document: schema.PoseDocument, known: Iterable[str]) -> tuple[tuple[str, str], ...] | None:
    if document.links is None:
        return None
    if missing := [name for link in document.links for name in link if name not in known]:
        raise PoseError(f"{path}: links: expected names of panoramas, got {listed(missing)}; they have no entry")
    return tuple((first, second) for first, second in document.links)


def _uncertainty(entry: schema.Entry) -> PoseUncertainty | None:
    if not isinstance(entry, schema.RigidEntry) or entry.uncertainty is None:
        return None
    percent = entry.uncertainty.position_percent
    return PoseUncertainty(math.radians(entry.uncertainty.rotation_deg), None if percent is None else percent / 100.0)


def file_beside(path: Path, file: str, where: str, kind: str, allow_outside: bool) -> Path:
    """The file that a pose file or a tour file (``kind``) names; PoseError: a link that leads out of its folder.

    Such a link is as much outside as a name that leads there; ``where`` is the key that names the file.
    """
    named = path.parent / file
    if not allow_outside and not real_path(named).is_relative_to(real_path(path.parent)):
        raise PoseError(
            f"{path}: {where}: expected a file inside the folder of the {kind}, got '{file}', a link that leads out of "
            "it; commands with --allow-outside accept it"
        )
    return named


def _entry(path: Path, name: str, value: Mapping[str, Any], allow_outside: bool) -> schema.Entry:
    """One entry, of the kind that its keys announce."""
    where = ("panoramas", name)
    if problem := schema.path_problem(name):
        raise PoseError(f"{path}: panoramas: expected the file name of an image, got '{name}' ({problem}); correct it")
    rigid, geographic = sorted(value.keys() & schema.RIGID_KEYS), sorted(value.keys() & schema.GEOGRAPHIC_KEYS)
    if rigid and geographic:
        raise PoseError(
            f"{path}: panoramas.'{name}': expected either a position or a geographic place, got {', '.join(rigid)} "
            f"mixed with {', '.join(geographic)}; keep one kind"
        )
    if geographic:
        return validated(path, schema.GeographicEntry, value, where, allow_outside=allow_outside)
    return validated(path, schema.RigidEntry, value, where, allow_outside=allow_outside)


def _entry_values(path: Path, name: str, panorama: PosedPanorama, allow_outside: bool) -> dict[str, Any]:
    rotation = quaternion_from_rotation(schema.checked_rotation(f"{path}: panoramas.'{name}'", panorama.pose.rotation))
    pose = {"position": panorama.pose.position.tolist(), "rotation": rotation.tolist()}
    words = {key: text for key, text in (("title", panorama.title), ("caption", panorama.caption)) if text}
    known = _uncertainty_values(panorama.uncertainty)
    return {**pose, **known, **_companion_names(path, name, panorama, allow_outside), **words}


def _uncertainty_values(uncertainty: PoseUncertainty | None) -> dict[str, dict[str, float]]:
    """With two digits: an uncertainty is not known better."""
    if uncertainty is None:
        return {}
    values = {"rotation_deg": math.degrees(uncertainty.rotation)}
    if uncertainty.position is not None:
        values["position_percent"] = 100.0 * uncertainty.position
    return {"uncertainty": {key: float(f"{value:.2g}") for key, value in values.items()}}


def _companion_names(path: Path, name: str, panorama: PosedPanorama, allow_outside: bool) -> dict[str, str]:
    """The names by which a pose file calls depth and mask of an entry."""
    folder, names = path.parent.absolute(), {}
    for key, file in (("depth", panorama.depth), ("mask", panorama.mask)):
        if file is None:
            continue
        if file.absolute().is_relative_to(folder) and not (allow_outside and ".." in file.parts):
            names[key] = file.absolute().relative_to(folder).as_posix()
        elif allow_outside:
            names[key] = relative_name(real_path(file.parent) / file.name, real_path(folder))
        else:
            raise PoseError(
                f"{path}: panoramas.'{name}'.{key}: expected a file in the folder of the pose file, got '{file}'; "
                "write the pose file beside it, or allow files elsewhere (--allow-outside)"
            )
    return names
