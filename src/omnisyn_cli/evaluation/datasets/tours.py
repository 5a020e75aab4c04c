"""Tours of photographs as data sets: their neighbours are the inputs, and each photograph between is the truth."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets.layouts import own_scenes
from omnisyn_cli.evaluation.datasets.sources import PairChooser, Scene, SceneFrame, SceneSource, scene_folders
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import read_panorama
from omnisyn_cli.io.placement import Reading
from omnisyn_cli.poses.estimation import PictureOptions, estimate_poses
from omnisyn_cli.poses.file import POSES_NAME
from omnisyn_cli.poses.formats.files import natural_key
from omnisyn_cli.synthesis.still_outlines import PICTURE_SIZE, find_still_region, spread_out
from omnisyn_cli.types import View

PHOTOGRAPHS = "*.[jJ][pP]*[gG]"
"""JPEG files, in the order of their names, are a tour where no pose file names its panoramas."""


def tours_of_photographs(
    folder: Path, choose: PairChooser, threads: int | None = None, *, allow_outside: bool = False
) -> list[SceneSource]:
    """A scene for each pair that is chosen, with its photographs between; all of a folder, or of the folders in it.

    Poses and masks are those of ``poses.json`` beside the photographs. Without one, poses are estimated for each scene
    when it is read. Its unit of length is unknown then.

    Args:
        folder: of photographs, or of folders of them.
        choose: pairs by the names or the order of the photographs.
        threads: at most this many; None is one per core.
        allow_outside: whether a ``poses.json`` may name masks outside of its folder.

    InputError: there are none; a ``poses.json`` is damaged; or a pair that was chosen is not there.
    """
    scenes = []
    places = {place: name for each in (POSES_NAME, PHOTOGRAPHS) for name, place in scene_folders(folder, each)}
    for place, name in places.items():
        is_posed = (place / POSES_NAME).is_file()
        found = own_scenes(place, allow_outside=allow_outside)[0].frames() if is_posed else _in_order(place)
        for pair in choose(Scene(name, tuple(found))):
            frames = (pair.first, *pair.between, pair.second)
            read = partial(tuple, frames) if is_posed else partial(_located, frames, threads)
            scenes.append(SceneSource(f"{name}: {frames[0].image.stem} to {frames[-1].image.stem}", read))
    if not scenes:
        raise InputError(f"{folder}: expected three photographs (JPEG) of a tour or more, got fewer; check the folder")
    return scenes


def still_region_of(folder: Path) -> np.ndarray | None:
    """What moves with the camera in all photographs of a folder, see :mod:`omnisyn_cli.synthesis.still_outlines`."""
    paths, reading = sorted(folder.glob(PHOTOGRAPHS)), Reading(size=PICTURE_SIZE)
    read = (read_panorama(paths[index], reading=reading) for index in spread_out(len(paths)))
    return find_still_region(View(picture.image, Pose.identity(), picture.mask) for picture in read)


def _in_order(folder: Path) -> Iterator[SceneFrame]:
    """Photographs whose poses are not known yet."""
    for path in sorted(folder.glob(PHOTOGRAPHS), key=lambda path: natural_key(path.name)):
        yield SceneFrame(path.name, path, Pose.identity())


def _located(frames: Sequence[SceneFrame], threads: int | None) -> Iterator[SceneFrame]:
    """The frames with the poses that all of them together give."""
    found = estimate_poses([frame.image for frame in frames], options=PictureOptions(threads=threads))
    for frame in frames:
        yield replace(frame, pose=found.panoramas[frame.name].pose)
