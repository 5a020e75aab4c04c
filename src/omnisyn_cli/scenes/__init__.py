"""Procedural places with exact depth, for training and tests.

``generate_scene`` makes a :class:`Scene`, ``sample_path`` cameras in it, ``render_panorama`` their pictures.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

from omnisyn_cli.scenes.materials import Photos, pack_photos, with_photos
from omnisyn_cli.scenes.panorama import render_panorama
from omnisyn_cli.scenes.paths import sample_path
from omnisyn_cli.scenes.room import home, room
from omnisyn_cli.scenes.scene import Scene
from omnisyn_cli.scenes.street import street

__all__ = ["GENERATORS", "Photos", "Scene", "generate_scene", "pack_photos", "render_panorama", "sample_path"]

# Generators by the name of what they make.
GENERATORS: Mapping[str, Callable[[int], Scene]] = {"street": street, "room": room, "home": home}


def generate_scene(kind: str, seed: int, photos: Photos | None = None) -> Scene:
    """A scene of :data:`GENERATORS`; ``photos`` replace materials."""
    scene = GENERATORS[kind](seed)
    if photos is None:
        return scene
    ground = int(scene.shapes["material"][0, 0])
    return replace(scene, materials=with_photos(scene.materials, ground, photos, seed), photos=photos)
