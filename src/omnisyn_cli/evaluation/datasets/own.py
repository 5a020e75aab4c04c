"""The layout of this program: a folder of scene folders, each with ``poses.json``.

``poses.json`` (see :mod:`omnisyn_cli.io.poses`) lists the panoramas of a scene in walking order, with their depth and
masks. Folders without that file are no scenes. A single scene folder is a data set of one.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from omnisyn_cli.evaluation.datasets.scene import Scene, SceneFrame, SceneSource
from omnisyn_cli.io import read_poses

__all__ = ["find_scenes"]

POSES = "poses.json"


def find_scenes(folder: Path, *, allow_outside: bool = False) -> list[SceneSource]:
    """The scenes of a folder, by name; none where nothing has this layout.

    Args:
        folder: of scenes, or a single scene.
        allow_outside: whether depth and masks of a scene may lie outside of its folder.
    """
    if (folder / POSES).exists():
        return [SceneSource(folder.resolve().name, partial(_read, folder.resolve().name, folder, allow_outside))]
    scenes = sorted(path.parent for path in folder.glob(f"*/{POSES}"))
    return [SceneSource(scene.name, partial(_read, scene.name, scene, allow_outside)) for scene in scenes]


def _read(name: str, folder: Path, allow_outside: bool) -> Scene:
    panoramas = read_poses(folder / POSES, allow_outside=allow_outside).panoramas
    frames = [
        SceneFrame(image, folder / image, panorama.pose, panorama.depth, panorama.mask)
        for image, panorama in panoramas.items()
    ]
    return Scene(name, tuple(frames))
