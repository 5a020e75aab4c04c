"""Imported poses written as ``poses.json``: names that differ, depth files within reach, panoramas copied if asked."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.paths import check_output, write_errors
from omnisyn_cli.io.pose_formats.files import listed
from omnisyn_cli.io.pose_formats.model import ImportedPoses, ImportedView
from omnisyn_cli.io.poses import PosedPanorama, write_poses
from omnisyn_cli.io.staging import staged_folder

__all__ = ["write_imported"]


def write_imported(
    output: Path, imported: ImportedPoses, *, copy_images: bool = False, overwrite: bool = False
) -> tuple[str, ...]:
    """Write a pose file for what was imported, and copies of the panoramas beside it if asked for.

    Everything appears at once or not at all. Entries are named after the image files; depth files are referred to where
    they lie in the folder of the pose file, or are copied too.

    Args:
        output: the pose file.
        imported: what a reader answered.
        copy_images: copy panoramas and depth files into the folder of ``output``, under names that differ.
        overwrite: replace files that exist.

    Returns:
        Notes for the user: what was left out, or is not where it will be looked for.

    Raises:
        PoseError: image files of one name without ``copy_images``, or panoramas that were not found with it.
        OutputPathError: a file exists, or there is no folder to write into.
        WriteError: the disk is full, or the folder went away.
    """
    check_output(output, overwrite)
    if copy_images:
        return _write_copies(output, imported.views, overwrite)
    names = [_file_name(view) for view in imported.views]
    _check_different(output, imported.views, names)
    folder = output.parent.absolute()
    entries = {
        name: PosedPanorama(view.pose, _within(folder, view.depth))
        for name, view in zip(names, imported.views, strict=True)
    }
    write_poses(output, entries)
    return tuple(_notes(imported.views, folder))


def _file_name(view: ImportedView) -> str:
    return PurePosixPath(view.name).name if view.image is None else view.image.name


def _check_different(output: Path, views: Sequence[ImportedView], names: Sequence[str]) -> None:
    for index, name in enumerate(names):
        first = names.index(name)
        if first != index:
            raise PoseError(
                f"{output}: expected image files of different names, got '{views[first].name}' and "
                f"'{views[index].name}'; let them be copied under names that differ (--copy-images)"
            )


def _within(folder: Path, file: Path | None) -> Path | None:
    """The file, if the pose file may refer to it."""
    is_within = file is not None and file.absolute().is_relative_to(folder)
    return file.absolute() if file is not None and is_within else None


def _write_copies(output: Path, views: Sequence[ImportedView], overwrite: bool) -> tuple[str, ...]:
    missing = [view.name for view in views if view.image is None]
    if missing:
        raise PoseError(f"{output}: expected all panoramas, to copy them, got no {listed(missing)}; name their folder")
    names = _names_of_copies(views)
    _check_different(output, views, names)
    depths = {
        name: f"{PurePosixPath(name).stem}_depth{view.depth.suffix}" if view.depth else None
        for name, view in zip(names, views, strict=True)
    }
    if both := set(names) & set(depths.values()):
        raise PoseError(f"{output}: expected no panorama named as the depth of another, got '{both.pop()}'; rename it")
    copies: dict[str, Path] = {}
    for name, view in zip(names, views, strict=True):
        for copy, file in ((name, view.image), (depths[name], view.depth)):
            if copy is not None and file is not None and not _same(output.parent / copy, file):
                check_output(output.parent / copy, overwrite)
                copies[copy] = file
    with staged_folder(output.parent, overwrite=overwrite) as staged:
        for copy, file in copies.items():
            with write_errors(output.parent / copy):
                shutil.copyfile(file, staged / copy)
        entries = {
            name: PosedPanorama(view.pose, None if (depth := depths[name]) is None else staged / depth)
            for name, view in zip(names, views, strict=True)
        }
        write_poses(staged / output.name, entries)
    return (f"copied: {len(copies)} files into '{output.parent}'",)


def _names_of_copies(views: Sequence[ImportedView]) -> list[str]:
    """The files' own names, or, where these are equal, their paths with ``_`` for ``/``."""
    names = [_file_name(view) for view in views]
    if len(set(names)) == len(names):
        return names
    parents = (PurePosixPath(view.name).parent.parts for view in views)
    return ["_".join([*(p for p in parts if p not in ("..", "/")), n]) for parts, n in zip(parents, names, strict=True)]


def _same(first: Path, second: Path) -> bool:
    return first.exists() and first.samefile(second)


def _notes(views: Sequence[ImportedView], folder: Path) -> list[str]:
    notes = []
    missing = [view.name for view in views if view.image is None]
    if missing:
        notes.append(f"images: {listed(missing)} not found, the names are taken as they are")
    elsewhere = [view for view in views if view.image is not None and view.image.absolute().parent != folder]
    if elsewhere:
        notes.append(f"images: {len(elsewhere)} are not in the folder of the pose file; give interpolate their paths")
    unreachable = [view.name for view in views if view.depth is not None and _within(folder, view.depth) is None]
    if unreachable:
        notes.append(f"depth: left out for {listed(unreachable)}, outside the folder of the pose file (--copy-images)")
    return notes
