"""Panoramas with exact depth from textured meshes: the ray caster, its light, places for cameras.

Needs Embree (``pip install "omnisyn-cli[scenes]"``).
"""

from omnisyn_cli.scenes.mesh.lighting import Lighting, draw_lighting
from omnisyn_cli.scenes.mesh.places import Place, find_line, find_places, find_walk
from omnisyn_cli.scenes.mesh.raycast import MeshCaster
from omnisyn_cli.scenes.mesh.render import MeshScene, render_mesh
from omnisyn_cli.scenes.mesh.texturing import papered_mesh, untextured_share, varied_mesh

__all__ = [
    "Lighting",
    "MeshCaster",
    "MeshScene",
    "Place",
    "draw_lighting",
    "find_line",
    "find_places",
    "find_walk",
    "papered_mesh",
    "render_mesh",
    "untextured_share",
    "varied_mesh",
]
