"""Imported poses written as ``poses.json``, and our poses written for other programs."""

import math
import shutil
from collections.abc import Mapping, Sequence, Set
from pathlib import Path, PurePosixPath

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, heading_from_rotation
from omnisyn_cli.io import outputs
from omnisyn_cli.io.decode import read_header
from omnisyn_cli.io.documents import listed
from omnisyn_cli.io.jpeg_metadata import with_gpano
from omnisyn_cli.io.placement import Placement, area_tags, placement_of
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, write_poses
from omnisyn_cli.poses.formats.colmap import colmap_files
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportedView, noted
from omnisyn_cli.poses.formats.json_files import nerfstudio_text
from omnisyn_cli.poses.formats.trajectories import tum_text

Size = tuple[int, int]
EXPORT_FORMATS = ("colmap", "nerfstudio", "tum", "gpano")


def export_poses(
    poses: PoseFile, output: Path, format_name: str,
    *, images: Path | None = None, size: Size | None = None, overwrite: bool = False,
) -> tuple[str, ...]:  # fmt: skip
    """Write poses as a COLMAP text model (a folder), a ``transforms.json``, a TUM trajectory, or tags of JPEG copies.

    The panoramas lie in the folder ``images`` (None: that of the pose file). All have ``size`` (height, width; None:
    that of their files). Notes for the user come back. PoseError: a panorama that is needed was not found or is no
    JPEG, or a name that the format cannot hold; ImageError: no image; OutputPathError, WriteError: as
    :func:`write_imported`.
    """
    if format_name not in EXPORT_FORMATS:
        raise ValueError(f"expected one of {', '.join(EXPORT_FORMATS)}, got {format_name!r}")
    folder = images or poses.path.parent
    if format_name == "gpano":
        return _write_tagged(poses, output, folder, overwrite)
    if format_name == "colmap":
        return _write_colmap(poses, output, folder, size, overwrite)
    outputs.check_output(output, overwrite)
    chosen = {name: panorama.pose for name, panorama in poses.panoramas.items()}
    if format_name == "tum":
        text, note = tum_text(chosen), "time stamps: the numbers of the panoramas; their names are in comments"
    else:
        files = {name: folder / name if (folder / name).is_file() else None for name in chosen}
        text = nerfstudio_text(chosen, _sizes(poses, folder, size), files, output.parent)
        note = "world: z up; depth and masks are not written"
    outputs.write_parts(output, [text.encode()])
    return (note,)


def _write_colmap(poses: PoseFile, output: Path, folder: Path, size: Size | None, overwrite: bool) -> tuple[str, ...]:
    """A COLMAP text model without points."""
    outputs.check_staged_folder(output)
    for name in colmap_files({}, {}) if output.is_dir() else ():
        outputs.check_output(output / name, overwrite)
    chosen = {name: panorama.pose for name, panorama in poses.panoramas.items()}
    sizes = _sizes(poses, folder, size)
    with outputs.staged_folder(output, overwrite=overwrite) as staged, outputs.write_errors(output):
        for name, text in colmap_files(chosen, sizes).items():
            (staged / name).write_text(text, encoding="utf-8")
    return ("world: y down; cameras are EQUIRECTANGULAR, which older versions of COLMAP do not know; no points",)


def _write_tagged(poses: PoseFile, output: Path, folder: Path, overwrite: bool) -> tuple[str, ...]:
    """Copies of the panoramas, with the tags in which other programs look for headings."""
    outputs.check_staged_folder(output)
    files = {name: folder / name for name in poses.panoramas}
    for name, file in files.items():
        if file.suffix.lower() not in (".jpg", ".jpeg") or not file.is_file():
            found = "none" if file.suffix.lower() in (".jpg", ".jpeg") else "another format"
            raise PoseError(
                f"{poses.path}: expected the panorama '{name}' as a JPEG in '{folder}', got {found}; name the folder "
                "(--images), or convert it"
            )
        outputs.check_kept([output / name], [file])
        if output.is_dir():
            outputs.check_output(output / name, overwrite)
    with outputs.staged_folder(output, overwrite=overwrite) as staged:
        for name, file in files.items():
            header = read_header(file)
            known = {tag.removeprefix("GPano:") for tag in header.attributes if tag.startswith("GPano:")}
            tags = _gpano_tags(poses.panoramas[name].pose, placement_of(header), known)
            target = staged / name
            outputs.make_folder(target.parent, "the panoramas")
            outputs.write_parts(target, [with_gpano(file, file.read_bytes(), tags)])
    return ("headings: clockwise from −z of the poses, which is north in a georeferenced world",)


def _gpano_tags(pose: Pose, placement: Placement, known: Set[str]) -> dict[str, str]:
    """Heading, pitch and roll of a panorama, and where it lies on the sphere unless its tags say that already."""
    heading, pitch, roll = (math.degrees(angle) for angle in heading_from_rotation(pose.rotation))
    turn = {"PoseHeadingDegrees": heading, "PosePitchDegrees": pitch, "PoseRollDegrees": roll}
    area = area_tags(placement)
    return {
        "UsePanoramaViewer": "True", "ProjectionType": "equirectangular",
        **{name: f"{degrees:.6f}" for name, degrees in turn.items()},
        **(area if known.isdisjoint(area) else {}),
    }  # fmt: skip


def _sizes(poses: PoseFile, folder: Path, size: Size | None) -> dict[str, Size]:
    """``(height, width)`` of the whole sphere of every panorama: those of its file unless the user gave one."""
    if size is not None:
        return dict.fromkeys(poses.panoramas, size)
    if missing := next((name for name in poses.panoramas if not (folder / name).is_file()), None):
        raise PoseError(
            f"{poses.path}: expected the panorama '{missing}' in '{folder}', for its size, got none; name the folder "
            "(--images) or the size (--size)"
        )
    return {name: placement_of(read_header(folder / name)).full_size for name in poses.panoramas}


def write_imported(
    output: Path, imported: ImportedPoses, *, copy_images: bool = False, overwrite: bool = False
) -> tuple[str, ...]:
    """Write a pose file for what was imported, and copies of the panoramas beside it if asked for: all or nothing.

    Entries are named after the image files, or by their paths where names are equal. Depth files are referred to where
    they lie in the folder of the pose file, or with ``copy_images`` copied there like the panoramas, under names that
    differ. Notes tell what was left out, or is not where it will be looked for. PoseError: an image twice, or panoramas
    to copy that were not found; OutputPathError: a file exists, or there is no folder to write into; WriteError: the
    disk is full.
    """
    outputs.check_output(output, overwrite)
    missing = [view.name for view in imported.views if view.image is None]
    if copy_images:
        if missing:
            raise PoseError(f"{output}: expected panoramas to copy, got no {listed(missing)}; name their folder")
        return _write_copies(output, _named(output, imported.views, "_"), overwrite, imported.is_metric)
    views, folder = _named(output, imported.views, "/"), output.parent.absolute()
    within = {
        name: view.depth.absolute()
        for name, view in views.items()
        if view.depth is not None and view.depth.absolute().is_relative_to(folder)
    }
    posed = {name: PosedPanorama(view.pose, within.get(name)) for name, view in views.items()}
    write_poses(output, posed, is_metric=imported.is_metric)
    elsewhere = sum(view.image is not None and view.image.absolute().parent != folder for view in views.values())
    unreachable = [view.name for name, view in views.items() if view.depth is not None and name not in within]
    notes = {
        f"images: {listed(missing)} not found, the names are taken as they are": missing,
        f"images: {elsewhere} are not in the folder of the pose file; give interpolate their paths": elsewhere,
        f"depth: left out for {listed(unreachable)}, outside the folder of the pose file (--copy-images)": unreachable,
    }
    return noted(notes)


def _named(output: Path, views: Sequence[ImportedView], separator: str) -> dict[str, ImportedView]:
    """Views by the names of their files, or, where these are equal, by their paths with a separator."""
    names = [PurePosixPath(view.name).name if view.image is None else view.image.name for view in views]
    if len(set(names)) < len(names):
        parents = (PurePosixPath(view.name).parent.parts for view in views)
        above = ([part for part in parts if part not in ("..", "/")] for parts in parents)
        names = [separator.join([*parts, name]) for parts, name in zip(above, names, strict=True)]
    named: dict[str, ImportedView] = {}
    for name, view in zip(names, views, strict=True):
        first = named.setdefault(name, view)
        if first is not view:
            raise PoseError(
                f"{output}: expected image files of different names, got '{first.name}' and '{view.name}'; rename one"
            )
    return named


def _write_copies(output: Path, views: Mapping[str, ImportedView], overwrite: bool, is_metric: bool) -> tuple[str, ...]:
    depths = {
        name: f"{PurePosixPath(name).stem}_depth{view.depth.suffix}" for name, view in views.items() if view.depth
    }
    if both := set(views) & set(depths.values()):
        raise PoseError(f"{output}: expected no panorama named as the depth of another, got '{both.pop()}'; rename it")
    copies: dict[str, Path] = {}
    for name, view in views.items():
        for copy, file in ((name, view.image), (depths.get(name), view.depth)):
            target = output.parent / (copy or "")
            if copy is not None and file is not None and not (target.exists() and target.samefile(file)):
                outputs.check_output(target, overwrite)
                copies[copy] = file
    with outputs.staged_folder(output.parent, overwrite=overwrite) as staged:
        for copy, file in copies.items():
            with outputs.write_errors(output.parent / copy):
                shutil.copyfile(file, staged / copy)
        entries = {
            name: PosedPanorama(view.pose, staged / depths[name] if name in depths else None)
            for name, view in views.items()
        }
        write_poses(staged / output.name, entries, is_metric=is_metric)
    return (f"copied: {len(copies)} files into '{output.parent}'",)
