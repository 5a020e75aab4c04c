"""The panoramas that a source speaks of: found in folders, in natural order, kept inside the source's folder."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.pose_formats.model import ImportOptions

__all__ = ["IMAGE_SUFFIXES", "entries", "find_image", "images_in", "listed", "natural_key", "usual_folder"]

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr", ".webp"})


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key that puts ``frame9`` before ``frame10``."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"([0-9]+)", name) if part]


def entries(folder: Path) -> list[Path]:
    """What lies in a folder, in no particular order.

    Raises:
        PoseError: no such folder, or it must not be read.
    """
    try:
        return list(folder.iterdir())
    except OSError as error:
        raise PoseError(f"{folder}: expected a readable folder, got '{error.strerror}'; check the name") from error


def images_in(folder: Path) -> list[Path]:
    """Image files of a folder (not below it) in natural order of their names.

    Raises:
        PoseError: no such folder.
    """
    found = [path for path in entries(folder) if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()]
    return sorted((path for path in found if not path.name.startswith(".")), key=lambda path: natural_key(path.name))


def usual_folder(folder: Path, options: ImportOptions) -> Path:
    """Where the panoramas of a trajectory lie: ``--images``, or the first of ``.``, ``images`` and ``rgb`` with any."""
    if options.images is not None:
        return options.images
    candidates = [folder, folder / "images", folder / "rgb"]
    return next((path for path in candidates if path.is_dir() and images_in(path)), folder)


def find_image(where: str, name: str, folders: list[Path], options: ImportOptions) -> Path | None:
    """The file that a source calls ``name``, in the first of ``folders`` that has it, or None.

    A name without ending may mean any image (instant-ngp writes such). With ``options.images`` its folder comes first.

    Raises:
        PoseError: the name leads out of the folder and ``allow_outside`` is off, or no file can have it; ``where``
            begins the message.
    """
    if not options.allow_outside and (PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts):
        raise PoseError(
            f"{where}: expected a file inside the source's folder, got '{name}'; allow it with --allow-outside"
        )
    searched = folders if options.images is None else [options.images, *folders]
    candidates = (folder / part for folder in searched for part in (name, PurePosixPath(name).name))
    try:
        return next((found for candidate in candidates if (found := _existing(candidate))), None)
    except (OSError, ValueError) as error:
        raise PoseError(f"{where}: expected a file name, got '{name:.60}' ({error!s:.60}); correct it") from error


def listed(names: list[str], most: int = 5) -> str:
    """Some names for a message."""
    return ", ".join(f"'{name:.60}'" for name in names[:most]) + (
        f" and {len(names) - most} more" if len(names) > most else ""
    )


def _existing(candidate: Path) -> Path | None:
    if candidate.is_file():
        return candidate
    if candidate.suffix.lower() in IMAGE_SUFFIXES or not candidate.parent.is_dir():
        return None
    named = (candidate.with_name(candidate.name + suffix) for suffix in sorted(IMAGE_SUFFIXES))
    return next((path for path in named if path.is_file()), None)
