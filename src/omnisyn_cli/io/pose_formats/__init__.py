"""Poses of other programs, read into our axes and written from them; one module per format.

Every reader takes a source and :class:`ImportOptions` and answers with :class:`ImportedPoses`: poses in our frame (x
right, y up, −z forward; metres) and one line for everything it had to assume. ``docs/poses.md`` tells users the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.pose_formats.authors import read_authors
from omnisyn_cli.io.pose_formats.axes import CAMERA_AXES, WORLD_UP, leveled
from omnisyn_cli.io.pose_formats.colmap import read_colmap
from omnisyn_cli.io.pose_formats.detect import detected_format, model_folder
from omnisyn_cli.io.pose_formats.exif import read_exif
from omnisyn_cli.io.pose_formats.export import EXPORT_FORMATS, export_poses
from omnisyn_cli.io.pose_formats.files import entries
from omnisyn_cli.io.pose_formats.habitat import read_habitat
from omnisyn_cli.io.pose_formats.model import ImportedPoses, ImportedView, ImportOptions, Origin
from omnisyn_cli.io.pose_formats.nerfstudio import read_nerfstudio
from omnisyn_cli.io.pose_formats.opensfm import read_opensfm
from omnisyn_cli.io.pose_formats.result import write_imported
from omnisyn_cli.io.pose_formats.table import read_table
from omnisyn_cli.io.pose_formats.trajectories import read_kitti, read_tum
from omnisyn_cli.io.pose_formats.zind import read_zind

__all__ = [
    "CAMERA_AXES",
    "EXPORT_FORMATS",
    "IMPORT_FORMATS",
    "WORLD_UP",
    "ImportOptions",
    "ImportedPoses",
    "ImportedView",
    "Origin",
    "export_poses",
    "import_poses",
    "write_imported",
]

Reader = Callable[[Path, ImportOptions], ImportedPoses]

READERS: Mapping[str, Reader] = {
    "table": read_table,
    "colmap": read_colmap,
    "opensfm": read_opensfm,
    "nerfstudio": read_nerfstudio,
    "tum": read_tum,
    "kitti": read_kitti,
    "habitat": read_habitat,
    "zind": read_zind,
    "authors": read_authors,
}

IMPORT_FORMATS = ("exif", *READERS)

GEOGRAPHIC = ("exif", "table", "opensfm")
"""Formats that know where on earth they are."""

LEVEL = ("exif", "table", "zind")
"""Formats whose axes are beyond doubt."""


def import_poses(sources: Sequence[Path], format_name: str, options: ImportOptions) -> tuple[str, ImportedPoses]:
    """Read poses of another program.

    Args:
        sources: one file or folder; for ``exif`` any number of images.
        format_name: one of :data:`IMPORT_FORMATS`, or ``auto``.
        options: what the user says about it.

    Returns:
        The format's name and what was read.

    Raises:
        PoseError: nothing known there, malformed, no folder of images, or an option that does not go with the format.
        ImageError: an image (exif) that is none.
    """
    chosen = detected_format(sources) if format_name == "auto" else format_name
    if chosen not in IMPORT_FORMATS:
        raise ValueError(f"expected one of auto, {', '.join(IMPORT_FORMATS)}, got {format_name!r}")
    _check_options(chosen, sources, options)
    if chosen == "exif":
        return chosen, read_exif(sources, options)
    source = model_folder(sources[0]) if chosen == "colmap" and sources[0].is_dir() else sources[0]
    if options.up != "cameras":
        return chosen, READERS[chosen](source, options)
    imported = READERS[chosen](source, replace(options, up=None))
    turned = leveled([view.pose for view in imported.views])
    views = tuple(replace(view, pose=pose) for view, pose in zip(imported.views, turned, strict=True))
    kept = tuple(note for note in imported.notes if not note.startswith("world:"))
    return chosen, ImportedPoses(views, (*kept, "world: up is the mean of the cameras' own"))


def _check_options(chosen: str, sources: Sequence[Path], options: ImportOptions) -> None:
    if len(sources) > 1 and chosen != "exif":
        raise PoseError(f"{sources[1]}: expected one source of format {chosen}, got {len(sources)}; give one")
    if options.images is not None:
        entries(options.images)
    unfit = {
        "--origin": options.origin is not None and chosen not in GEOGRAPHIC,
        "--up": options.up is not None and chosen in LEVEL,
        "--camera-axes": options.camera is not None and chosen in LEVEL,
        "--floor": options.floor is not None and chosen != "zind",
    }
    for option, is_unfit in unfit.items():
        if is_unfit:
            raise PoseError(f"{sources[0]}: expected no {option} with format {chosen}, got one; leave it out")
