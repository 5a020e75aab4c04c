"""Habitat renders of Matterport3D and Replica as PanoGRF makes and PanSplat reads them.

``SCENE/NN/{rgb.png, depth.png, rot.txt, tran.txt}``, the views NN in the order of their names. What is assumed is said
in :mod:`omnisyn_cli.io.pose_formats.habitat`. ``depth.png`` may be missing; it is 0 where the scan has a hole.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from omnisyn_cli.evaluation.datasets.scene import Scene, SceneFrame, SceneSource
from omnisyn_cli.io.pose_formats.habitat import habitat_pose

__all__ = ["find_scenes"]

POSITION = "tran.txt"


def find_scenes(folder: Path) -> list[SceneSource]:
    """The scenes of a folder, or the folder itself as one scene; none where nothing has this layout."""
    if any(folder.glob(f"*/{POSITION}")):
        name = folder.resolve().name
        return [SceneSource(name, partial(_read, name, folder))]
    scenes = sorted({path.parents[1] for path in folder.glob(f"*/*/{POSITION}")})
    return [SceneSource(scene.name, partial(_read, scene.name, scene)) for scene in scenes]


def _read(name: str, folder: Path) -> Scene:
    views = sorted(path.parent for path in folder.glob(f"*/{POSITION}"))
    return Scene(name, tuple(_frame(view) for view in views))


def _frame(view: Path) -> SceneFrame:
    depth = view / "depth.png"
    return SceneFrame(
        view.name, view / "rgb.png", habitat_pose(view), depth if depth.is_file() else None, has_holes=True
    )
