"""Which program's poses a file or folder holds, told by names and by what is inside."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.pose_formats.files import IMAGE_SUFFIXES, images_in
from omnisyn_cli.io.pose_formats.habitat import habitat_folders
from omnisyn_cli.io.pose_formats.text import data_lines, read_json

__all__ = ["detected_format", "model_folder"]

MARKS = {
    "colmap": "images.txt",
    "zind": "zind_data.json",
    "opensfm": "reconstruction.json",
    "nerfstudio": "transforms.json",
    "authors": "rotations.npy",
}
"""The file by which a folder is known."""

KEYS = {"shots": "opensfm", "frames": "nerfstudio", "merger": "zind"}

COLUMNS = {8: "tum", 12: "kitti"}
"""Fields of the first line of a trajectory."""


def model_folder(source: Path) -> Path:
    """The folder of a COLMAP model inside ``source``: itself, or the usual ``sparse/0`` and ``sparse``."""
    candidates = [source, source / "sparse" / "0", source / "sparse"]
    return next((path for path in candidates if (path / MARKS["colmap"]).is_file()), source)


def detected_format(sources: Sequence[Path]) -> str:
    """The name of the format.

    Raises:
        PoseError: nothing there, nothing known, or several formats at once.
    """
    for source in sources:
        if not source.exists():
            raise PoseError(f"{source}: expected a file or folder with poses, got none; check the name")
    if len(sources) > 1:
        return "exif"
    return _of_folder(sources[0]) if sources[0].is_dir() else _of_file(sources[0])


def _of_folder(folder: Path) -> str:
    found = [name for name, mark in MARKS.items() if (folder / mark).is_file()]
    if not found and (model_folder(folder) / MARKS["colmap"]).is_file():
        found = ["colmap"]
    if not found and habitat_folders(folder):
        found = ["habitat"]
    if len(found) > 1:
        raise PoseError(f"{folder}: expected poses of one program, got {', '.join(found)}; choose with --format")
    if found:
        return found[0]
    if any((path / "images.bin").is_file() for path in (folder, folder / "sparse" / "0", folder / "sparse")):
        raise PoseError(
            f"{folder}: expected a COLMAP text model, got a binary one; "
            "convert it with 'colmap model_converter --output_type TXT'"
        )
    if images_in(folder):
        return "exif"
    raise _unknown(folder, f"none of {', '.join(MARKS.values())}, rot.txt in sub-folders, or images")


def _of_file(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in IMAGE_SUFFIXES:
        return "exif"
    if path.name == MARKS["colmap"] or path.name == "cameras.txt":
        return "colmap"
    if suffix in (".csv", ".tsv"):
        return "table"
    if suffix == ".npy":
        return "authors"
    if suffix == ".json":
        return _of_json(path)
    for _, line in data_lines(path):
        columns = len(line.replace(",", " ").split())
        if columns in COLUMNS:
            return COLUMNS[columns]
        raise _unknown(path, f"a first line of {columns} fields")
    raise _unknown(path, "an empty file")


def _of_json(path: Path) -> str:
    document = read_json(path)
    first = document[0] if isinstance(document, list) and document else document
    if not isinstance(first, dict):
        raise _unknown(path, f"JSON with {type(first).__name__}")
    if {"version", "panoramas"} <= set(first):
        raise PoseError(f"{path}: expected poses of another program, got a pose file of this one; use it as it is")
    return next((name for key, name in KEYS.items() if key in first), "table")


def _unknown(path: Path, found: str) -> PoseError:
    return PoseError(f"{path}: expected poses in a format that is known, got {found}; name the format with --format")
