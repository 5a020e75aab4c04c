"""Poses of other programs, read into our axes and written from them; see its modules.

Every reader takes a source and :class:`ImportOptions` and answers with :class:`ImportedPoses`: poses in our frame (x
right, y up, −z forward; metres) and one line for everything it had to assume. ``docs/poses.md`` tells users the same.
A PoseError says what is missing, malformed, or no panorama.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.documents import read_json
from omnisyn_cli.poses.formats import files, trajectories
from omnisyn_cli.poses.formats.colmap import read_colmap
from omnisyn_cli.poses.formats.colmap_model import IMAGES, MODEL_FILES, folder_of_model
from omnisyn_cli.poses.formats.files import CAMERAS_UP, IMAGE_SUFFIXES, ImportedPoses, ImportOptions
from omnisyn_cli.poses.formats.geographic import read_exif
from omnisyn_cli.poses.formats.json_files import ZIND_FILE_NAME, read_nerfstudio, read_opensfm, read_zind
from omnisyn_cli.poses.formats.metashape import read_metashape
from omnisyn_cli.poses.formats.tables import is_metric, read_table, read_xyz
from omnisyn_cli.poses.formats.trajectories import ROTATIONS, read_authors, read_habitat, read_kitti, read_tum


@dataclass(frozen=True)
class Format:
    """One kind of poses, and how it is recognised."""

    # makes our poses of a source, or of all of them where ``is_of_many``
    read: Callable[[Any, ImportOptions], ImportedPoses]
    mark: str | None = None  # the file by which a folder is known
    key: str | None = None  # at the top of its JSON
    columns: int | None = None  # of the first line of its text
    is_on_earth: bool = False  # it may know where on earth it is
    is_level: bool = False  # its axes are fixed by the format
    is_of_many: bool = False  # there may be several sources


FORMATS: Mapping[str, Format] = {
    "exif": Format(read_exif, is_on_earth=True, is_level=True, is_of_many=True),
    "table": Format(read_table, is_on_earth=True, is_level=True),
    "xyz": Format(read_xyz),
    "metashape": Format(read_metashape, is_on_earth=True),
    "colmap": Format(read_colmap, IMAGES),
    "zind": Format(read_zind, ZIND_FILE_NAME, "merger", is_level=True),
    "opensfm": Format(read_opensfm, "reconstruction.json", "shots", is_on_earth=True),
    "nerfstudio": Format(read_nerfstudio, "transforms.json", "frames"),
    "authors": Format(read_authors, ROTATIONS),
    "tum": Format(read_tum, columns=8),
    "kitti": Format(read_kitti, columns=12),
    "habitat": Format(read_habitat),
}

IMPORT_FORMATS = tuple(FORMATS)
FORMAT_BY_SUFFIX = {".csv": "table", ".tsv": "table", ".npy": "authors", ".xml": "metashape"}


def import_poses(sources: Sequence[Path], format_name: str, options: ImportOptions) -> tuple[str, ImportedPoses]:
    """Read poses of another program; the answer is the name of the format and what was read.

    Sources are one file or folder, or for ``exif`` any number of images; ``format_name`` is one of
    :data:`IMPORT_FORMATS` or ``auto``. PoseError: unknown or malformed, no folder of images, an unfit option;
    ImageError: an image (exif) that is none.
    """
    chosen = detected_format(sources) if format_name == "auto" else format_name
    if chosen not in FORMATS:
        raise ValueError(f"expected one of auto, {', '.join(IMPORT_FORMATS)}, got {format_name!r}")
    _check_options(chosen, sources, options)
    form = FORMATS[chosen]
    source = sources if form.is_of_many else sources[0]
    if options.up != "cameras":
        return chosen, form.read(source, options)
    imported = form.read(source, replace(options, up=None))
    turned = files.levelled([view.pose for view in imported.views])
    views = tuple(replace(view, pose=pose) for view, pose in zip(imported.views, turned, strict=True))
    kept = tuple(note for note in imported.notes if not note.startswith("world:"))
    return chosen, replace(imported, views=views, notes=(*kept, CAMERAS_UP))


def detected_format(sources: Sequence[Path]) -> str:
    """The format of the poses in a file or folder, by file names and content."""
    for source in sources:
        if not source.exists():
            raise PoseError(f"{source}: expected a file or folder with poses, got none; check the name")
    if len(sources) > 1:
        return "exif"
    return _of_folder(sources[0]) if sources[0].is_dir() else _of_file(sources[0])


def _check_options(chosen: str, sources: Sequence[Path], options: ImportOptions) -> None:
    form = FORMATS[chosen]
    if len(sources) > 1 and not form.is_of_many:
        raise PoseError(f"{sources[1]}: expected one source of format {chosen}, got {len(sources)}; give one")
    if options.images is not None:
        files.entries(options.images)
    unfit = {
        "--origin": options.origin is not None and not form.is_on_earth,
        "--up": options.up is not None and form.is_level,
        "--camera-axes": options.camera is not None and form.is_level,
        "--roll": options.roll is not None and chosen not in ("exif", "table", "xyz"),
        "--floor": options.floor is not None and chosen != "zind",
    }
    for option, is_unfit in unfit.items():
        if is_unfit:
            raise PoseError(f"{sources[0]}: expected no {option} with format {chosen}, got one; leave it out")


def _of_folder(folder: Path) -> str:
    marks = {name: form.mark for name, form in FORMATS.items() if form.mark is not None}
    found = [name for name, mark in marks.items() if (folder / mark).is_file()]
    if not found and folder_of_model(folder):
        found = ["colmap"]
    if not found and trajectories.habitat_folders(folder):
        found = ["habitat"]
    if len(found) > 1:
        raise PoseError(f"{folder}: expected poses of one program, got {', '.join(found)}; choose with --format")
    if found:
        return found[0]
    if files.images_in(folder):
        return "exif"
    raise _unknown(folder, f"none of {', '.join(marks.values())}, rot.txt in sub-folders, or images")


def _of_file(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in IMAGE_SUFFIXES:
        return "exif"
    if path.name in MODEL_FILES:
        return "colmap"
    if suffix == ".json":
        return _of_json(path)
    if suffix in FORMAT_BY_SUFFIX:
        by_suffix = FORMAT_BY_SUFFIX[suffix]
        return "xyz" if by_suffix == "table" and is_metric(path) else by_suffix
    _, line = next(files.data_lines(path), (0, ""))
    if not line:
        raise _unknown(path, "an empty file")
    columns = len(line.replace(",", " ").split())
    if found := next((name for name, form in FORMATS.items() if form.columns == columns), None):
        return found
    raise _unknown(path, f"a first line of {columns} fields")


def _of_json(path: Path) -> str:
    document = read_json(path)
    first = document[0] if isinstance(document, list) and document else document
    if not isinstance(first, dict):
        raise _unknown(path, f"JSON with {type(first).__name__}")
    if {"version", "panoramas"} <= set(first):
        raise PoseError(f"{path}: expected poses of another program, got a pose file of this one; use it as it is")
    if found := next((name for name, form in FORMATS.items() if form.key in first), None):
        return found
    return "xyz" if is_metric(path) else "table"


def _unknown(path: Path, found: str) -> PoseError:
    return PoseError(f"{path}: expected poses in a format that is known, got {found}; name the format with --format")
