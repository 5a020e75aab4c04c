"""Our poses written for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io.decode import read_header
from omnisyn_cli.io.paths import check_output, replaced_when_complete, write_errors
from omnisyn_cli.io.placement import placement_of
from omnisyn_cli.io.pose_formats.colmap import colmap_files
from omnisyn_cli.io.pose_formats.nerfstudio import nerfstudio_text
from omnisyn_cli.io.pose_formats.trajectories import tum_text
from omnisyn_cli.io.poses import PoseFile
from omnisyn_cli.io.staging import check_staged_folder, staged_folder

__all__ = ["EXPORT_FORMATS", "export_poses"]

EXPORT_FORMATS = ("colmap", "nerfstudio", "tum")

COLMAP_NAMES = ("cameras.txt", "images.txt", "points3D.txt")

Size = tuple[int, int]


def export_poses(
    poses: PoseFile,
    output: Path,
    format_name: str,
    *,
    images: Path | None = None,
    size: Size | None = None,
    overwrite: bool = False,
) -> tuple[str, ...]:
    """Write poses as a COLMAP text model (a folder), a ``transforms.json`` or a TUM trajectory.

    Args:
        poses: what to write.
        output: the folder for colmap, else the file.
        format_name: one of :data:`EXPORT_FORMATS`.
        images: folder with the panoramas; None is that of the pose file.
        size: ``(height, width)`` of all panoramas; None reads it from their files.
        overwrite: replace files that exist.

    Returns:
        Notes for the user.

    Raises:
        PoseError: a panorama whose size is needed was not found, or a name that the format cannot hold.
        ImageError: a panorama that is no image.
        OutputPathError: a file exists, or there is no folder to write into.
        WriteError: the disk is full, or the folder went away.
    """
    if format_name not in EXPORT_FORMATS:
        raise ValueError(f"expected one of {', '.join(EXPORT_FORMATS)}, got {format_name!r}")
    _check_place(output, format_name, overwrite)
    chosen = {name: panorama.pose for name, panorama in poses.panoramas.items()}
    if format_name == "tum":
        _write(output, tum_text(chosen))
        return ("time stamps: the numbers of the panoramas; their names are in comments",)
    folder = images or poses.path.parent
    files = {name: folder / name if (folder / name).is_file() else None for name in chosen}
    sizes = {name: size or _size(poses.path, name, folder, file) for name, file in files.items()}
    if format_name == "nerfstudio":
        _write(output, nerfstudio_text(chosen, sizes, files, output.parent))
        return ("world: z up; depth and masks are not written",)
    _write_colmap(output, chosen, sizes, overwrite)
    return ("world: y down; cameras are EQUIRECTANGULAR, which older versions of COLMAP do not know; no points",)


def _check_place(output: Path, format_name: str, overwrite: bool) -> None:
    if format_name != "colmap":
        check_output(output, overwrite)
        return
    check_staged_folder(output)
    if output.is_dir():
        for name in COLMAP_NAMES:
            check_output(output / name, overwrite)


def _write(output: Path, text: str) -> None:
    with replaced_when_complete(output) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _write_colmap(output: Path, poses: Mapping[str, Pose], sizes: Mapping[str, Size], overwrite: bool) -> None:
    files = colmap_files(poses, sizes)
    with staged_folder(output, overwrite=overwrite) as staged, write_errors(output):
        for name, text in files.items():
            (staged / name).write_text(text, encoding="utf-8")


def _size(path: Path, name: str, folder: Path, file: Path | None) -> Size:
    """``(height, width)`` of the whole sphere of a panorama."""
    if file is None:
        raise PoseError(
            f"{path}: expected the panorama '{name}' in '{folder}', for its size, got none; "
            "name the folder (--images) or the size (--size)"
        )
    placement = placement_of(read_header(file))
    return placement.full_height, placement.full_width
