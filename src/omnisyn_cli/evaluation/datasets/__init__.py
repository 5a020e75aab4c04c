"""Data sets: folders of scenes in the layouts that are around, read as posed panoramas in walking order."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.datasets.layouts import carla_scenes, habitat_scenes, own_scenes, zind_scenes
from omnisyn_cli.evaluation.datasets.sources import SceneSource

Finder = Callable[[Path], list[SceneSource]]

# What finds the scenes of a folder, by the name of the layout; tried in this order.
FORMATS: Mapping[str, Finder] = {
    "omnisyn": own_scenes, "carla": carla_scenes, "m3d": habitat_scenes, "zind": zind_scenes,
}  # fmt: skip


def find_scenes(folder: Path, layout: str = "auto", *, allow_outside: bool = False) -> list[SceneSource]:
    """The scenes of a folder, by the first ``layout`` that finds some; InputError: there is no folder, or no scene."""
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of scenes, got none; check the name")
    finders: dict[str, Finder] = {**FORMATS, "omnisyn": partial(own_scenes, allow_outside=allow_outside)}
    for name in finders if layout == "auto" else (layout,):
        if scenes := finders[name](folder):
            return scenes
    known_by = "poses.json, gnss_data.json, NN/tran.txt or zind_data.json"
    wanted = known_by if layout == "auto" else f"the layout '{layout}'"
    raise InputError(f"{folder}: expected scenes with {wanted}, got none; check the folder and --format")
