"""Procedural places with exact depth, for training and tests.

``generate_scene`` makes a :class:`Scene`, ``sample_path`` cameras in it, ``render_panorama`` and ``render_views``
their pictures.
"""

from collections.abc import Callable, Mapping

from omnisyn_cli.scenes.home import home
from omnisyn_cli.scenes.jumble import jumble, yard
from omnisyn_cli.scenes.panorama import render_panorama, render_views
from omnisyn_cli.scenes.paths import sample_path
from omnisyn_cli.scenes.photos import Photos, pack_photos, with_photos
from omnisyn_cli.scenes.room import room
from omnisyn_cli.scenes.scene import Scene
from omnisyn_cli.scenes.street import street

__all__ = [
    "GENERATORS",
    "Photos",
    "Scene",
    "generate_scene",
    "pack_photos",
    "render_panorama",
    "render_views",
    "sample_path",
]

GENERATORS: Mapping[str, Callable[[int], Scene]] = {
    "street": street,
    "room": room,
    "home": home,
    "jumble": jumble,
    "yard": yard,
}
"""Generators by the name of what they make."""


def generate_scene(kind: str, seed: int, photos: Photos | None = None) -> Scene:
    """Generate a scene; equal arguments give equal scenes.

    Args:
        kind: a key of :data:`GENERATORS`.
        seed: any non-negative number.
        photos: some of the materials are made of; the shapes are the same with them and without.

    Raises:
        ValueError: there is no such kind, or the seed is negative.
    """
    if kind not in GENERATORS or seed < 0:
        raise ValueError(
            f"expected a kind of {', '.join(GENERATORS)} and a seed of at least 0, got {kind!r} and {seed}"
        )
    scene = GENERATORS[kind](seed)
    return scene if photos is None else with_photos(scene, photos, seed)
