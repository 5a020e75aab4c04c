"""A mesh as points and quads on a device: everything about it that does not change from frame to frame.

Points stay in the frame of the panorama, as directions with inverse depths, so that a target's frame is one product
away: ``v = R·d + ρ·t``.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Integer
from torch import Tensor

from omnisyn_cli.render.mesh import Mesh


@dataclass(frozen=True)
class Quads:
    """What is drawn of a mesh, see :class:`omnisyn_cli.render.mesh.Surface`.

    Attributes:
        direction: of the points in the frame of the panorama; not all of length one.
        inverse_depth: of the points, 1/metre.
        corner: indices of each quad's points; it is split from the first to the fourth.
        triangles: how many of these have an area.
    """

    direction: Float[Tensor, "points 3"]
    inverse_depth: Float[Tensor, " points"]
    corner: Integer[Tensor, "quads 4"]
    triangles: int


def quads_of(mesh: Mesh, device: torch.device) -> Quads:
    """The quads of a mesh: 32 bytes for every point and for every quad."""
    surface = mesh.surface
    direction, inverse_depth, corner = (
        torch.from_numpy(part).to(device) for part in (surface.direction, surface.inverse_depth, surface.corner)
    )
    return Quads(direction, inverse_depth, corner, mesh.face_count())
