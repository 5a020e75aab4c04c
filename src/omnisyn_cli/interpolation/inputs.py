"""What a user names: panoramas one by one or as a folder, the file with their poses, and what is made of them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES
from omnisyn_cli.io.documents import listed
from omnisyn_cli.io.encoders import CODECS
from omnisyn_cli.io.outputs import real_path
from omnisyn_cli.poses.file import POSES_NAME, read_poses, stored_file
from omnisyn_cli.poses.tour_file import TOUR_NAME, read_tour


@dataclass(frozen=True)
class NamedTour:
    """Panoramas as they were named."""

    images: tuple[Path, ...]  # in walking order
    poses: Path  # pose file, or ``POSES_FROM_PICTURES``
    name: str  # of the folder that was named, else ``first-last``
    tour: Path | None = None  # the ``tour.json`` in that folder, or beside the first panorama
    is_chain: bool = True  # each leads to the next one: they were named one by one

    def output(self, ending: str) -> Path:
        """The name, in the current folder, of what is made of the tour if nobody chooses one.

        The ending is ``.mp4`` and the like for a file. For a folder it tells it from that of the panoramas, such as
        ``-frames``; such a name has no dot and no percent sign, which would make a file or a pattern of it.
        """
        name = self.name if ending.startswith(".") else re.sub(r"[.%]", "_", self.name)
        return Path(name + ending)


def named_tour(given: Sequence[Path], poses: Path | None = None, *, allow_outside: bool = False) -> NamedTour:
    """The tour that is meant by panoramas in walking order, or by one folder.

    Of a folder those are taken that its pose file names, in its order; for poses from the pictures all of them, in the
    natural order of their names. The pose file is ``poses.json`` beside them by default; with ``allow_outside`` it may
    name depth and masks outside of its folder. InputError: a folder without a pose file or among other names, or a
    panorama that is named there is missing.
    """
    folder = next((path for path in given if path.is_dir()), None)
    place = folder or given[0].parent
    tour = place / TOUR_NAME if (place / TOUR_NAME).exists() else None
    if folder is None:
        return NamedTour(tuple(given), poses or place / POSES_NAME, f"{given[0].stem}-{given[-1].stem}", tour)
    if len(given) > 1:
        raise InputError(
            f"{folder}: expected panoramas, or one folder alone, got a folder among {len(given)} names; name the "
            "panoramas in it one by one"
        )
    images, poses = _in_folder(folder, poses, allow_outside)
    return NamedTour(images, poses, real_path(folder).name or "tour", tour, is_chain=False)


def along_path(tour: NamedTour, path: str, *, allow_outside: bool = False) -> NamedTour:
    """The part of a tour that a path through its links names: the shortest way through some panoramas.

    ``path`` has names of two or more panoramas in walking order, with or without endings, separated by commas.
    InputError: there is no pose file, no such panorama, or no links lead from one to the next.
    """
    if tour.poses == POSES_FROM_PICTURES:
        raise InputError(f"expected a pose file for a path through the tour, got --poses {tour.poses}; write one first")
    poses = read_poses(tour.poses, allow_outside=allow_outside)
    graph = read_tour(tour.tour, tour.images, poses, tour.name, allow_outside=allow_outside)
    known = {word: one for one in reversed(graph.panoramas) for word in (one.image.stem, one.image.name, one.name)}
    words = [word.strip() for word in path.split(",")]
    for word in words:
        if word not in known:
            raise InputError(
                f"expected names of panoramas in a path, got '{word}'; "
                f"choose from {listed(one.image.name for one in graph.panoramas)}"
            )
    if len(words) < 2:
        raise InputError(f"expected two or more panoramas in a path, got '{path}'; name at least both ends")
    names = graph.path_through([known[word].name for word in words])
    images = tuple(graph.by_name[name].image for name in names)
    return replace(tour, images=images, name=f"{images[0].stem}-{images[-1].stem}", is_chain=True)


def _in_folder(folder: Path, poses: Path | None, allow_outside: bool) -> tuple[tuple[Path, ...], Path]:
    """The panoramas that a pose file names, and that file."""
    if poses == POSES_FROM_PICTURES:
        return _panoramas_in(folder), poses
    if poses is None and not (folder / POSES_NAME).exists():
        raise InputError(
            f"{folder}: expected a {POSES_NAME} in the folder, got none; have poses found in the pictures "
            f"(--poses {POSES_FROM_PICTURES}), or name the pose file (--poses FILE)"
        )
    poses = poses or folder / POSES_NAME
    images = tuple(stored_file(folder / name) for name in read_poses(poses, allow_outside=allow_outside).panoramas)
    missing = [image.name for image in images if not image.exists()]
    if missing:
        raise InputError(
            f"{folder}: expected the {len(images)} panoramas that {poses} names, got none called '{missing[0]}' "
            f"({len(missing)} missing); add it, or name panoramas one by one"
        )
    if len(images) < 2:
        raise InputError(f"{poses}: expected two or more panoramas, got {len(images)}; add another")
    return images, poses


def _panoramas_in(folder: Path) -> tuple[Path, ...]:
    """All pictures of a folder but masks and depth of others, in the natural order of their names."""
    # The readers of pose files take a while to import, and only this asks for one of their tools.
    from omnisyn_cli.poses.formats.files import images_in

    pictures = images_in(folder)
    companions = {f"{path.stem}{what}" for path in pictures for what in ("_mask", "_depth")}
    images = tuple(path for path in pictures if path.stem not in companions)
    if len(images) < 2:
        raise InputError(f"{folder}: expected two or more panoramas in the folder, got {len(images)}; add another")
    return images


def video_ending(codec: str | None) -> str:
    """The ending of a video of a codec for :meth:`NamedTour.output`; a folder's for frames as images."""
    return CODECS[codec or "h264"].suffixes[0] if codec in (None, *CODECS) else "-frames"
