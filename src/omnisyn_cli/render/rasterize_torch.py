"""Differentiable rendering: gradients flow from the target to inverse depths and colours of the source.

Which face each pixel sees is found without gradients by :mod:`omnisyn_cli.render.rasterize`. Inverse depth and colour
follow again, with gradients, from the formulas there. With r the ray of a pixel, the corners ``v_i = R·d_i + ρ_i·t``
are split into a share along the ray and the rest, ``s_i = r·v_i`` and ``u_i = v_i − s_i·r``. Then
``e_0 = r·(u_1×u_2)`` and so on, ``det = Σ e_i·s_i`` and ``ρ = Σ e_i·ρ_i / det``: the same numbers, but nothing cancels,
so float32 will do.

Silhouettes themselves carry no gradient: which face is seen is a constant. At the poles of the source, where the
azimuth turns infinitely fast, colour depends on the polar angle alone, with the gradient of the paper's linearised
arccos: bounded, and of the right sign.

Source: OmniSyn, sections 3.4 and 3.5.2.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear_at
from omnisyn_cli.geometry.sphere import angles_to_pixel, direction_to_angles, linearised_arccos, pixel_directions
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.rasterize import Fragments

# Rows from a source pole within which the azimuth has no gradient, and the polar angle that of a straight line.
POLE_CAP_ROWS = 0.5
# Faces whose determinant is less than this share of ``Σ e_i`` are seen edge-on: their inverse depth is a constant.
MIN_RELATIVE_DETERMINANT = 1e-4


@dataclass(frozen=True)
class TorchLayer:
    """What a target sees, as torch tensors on the device of the source and in its precision."""

    colour: Float[Tensor, "height width channels"]  # 0 where nothing is seen
    inverse_depth: Float[Tensor, "height width"]  # 1/metre from the target's centre; negative where nothing is seen
    visibility: Bool[Tensor, "height width"]  # whether a surface is seen; no gradient


def render_fragments(
    fragments: Fragments, mesh: Mesh, inverse_depth: Float[Tensor, "rows cols"],
    colour: Float[Tensor, "image_rows image_cols channels"], target_from_source: Pose,
) -> TorchLayer:  # fmt: skip
    """Inverse depth and colour of fragments as functions of ``inverse_depth`` and ``colour``.

    The fragments are what the target sees of ``mesh`` by this transform, and the mesh is made of these inverse depths.
    """
    height, width = fragments.face.shape
    visible = fragments.visibility
    rays = pixel_directions(height, width)[visible]
    seen = _inverse_depth_seen(fragments, mesh, inverse_depth, rays, target_from_source)
    directions = _source_directions(seen, rays, target_from_source)
    texels = sample_bilinear_at(colour, *_source_pixels(directions, (colour.shape[0], colour.shape[1])))
    where = torch.from_numpy(visible).to(inverse_depth.device)
    return TorchLayer(
        colour.new_zeros((height, width, colour.shape[-1])).masked_scatter(where[..., None], texels),
        inverse_depth.new_full((height, width), -1.0).masked_scatter(where, seen),
        where,
    )


def _inverse_depth_seen(
    fragments: Fragments, mesh: Mesh, inverse_depth: Tensor, rays: np.ndarray, pose: Pose
) -> Float[Tensor, " pixels"]:
    """Inverse depth at each visible pixel, ``Σ e_i·ρ_i / Σ e_i·s_i``."""
    surface = mesh.surface
    corner = surface.corners_of(fragments.face[fragments.visibility])
    along, across = _split(surface.direction[corner] @ pose.rotation.T, rays[:, None])
    along_t, across_t = _split(pose.position, rays)

    def tensor(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array).to(inverse_depth)

    points = torch.cat([inverse_depth.reshape(-1), mesh.piece_inverse_depths(inverse_depth).reshape(-1)])
    rho = points[torch.from_numpy(corner).to(inverse_depth.device)]
    u = tensor(across) + rho[..., None] * tensor(across_t)[:, None]
    s = tensor(along) + rho * tensor(along_t)[:, None]
    edges = (torch.linalg.cross(u.roll(-1, dims=1), u.roll(-2, dims=1)) * tensor(rays)[:, None]).sum(-1)
    determinant = (edges * s).sum(-1)
    is_edge_on = determinant <= MIN_RELATIVE_DETERMINANT * edges.abs().sum(-1)
    found = tensor(fragments.inverse_depth[fragments.visibility])
    ratio = (edges * rho).sum(-1) / torch.where(is_edge_on, torch.ones_like(determinant), determinant)
    return torch.where(is_edge_on, found, ratio)


def _split(vectors: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length along each ray, and the rest orthogonal to it."""
    along = (vectors * rays).sum(-1)
    return along, vectors - along[..., None] * rays


def _source_directions(seen: Tensor, rays: np.ndarray, pose: Pose) -> Float[Tensor, "pixels 3"]:
    """Where the source sees what each ray meets: ``Rᵀ(r − ρ·t)``, not normalised."""
    turned_rays, turned_t = rays @ pose.rotation, pose.position @ pose.rotation
    return torch.as_tensor(turned_rays).to(seen) - seen[:, None] * torch.as_tensor(turned_t).to(seen)


def _source_pixels(directions: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Rows and columns that directions point at, with a gradient that stays bounded at the poles."""
    cap = POLE_CAP_ROWS * math.pi / size[0]
    squared = directions.square().sum(-1, keepdim=True)
    ring = (directions[..., 0].square() + directions[..., 2].square()).detach()
    near = ring < math.sin(cap) ** 2 * squared[..., 0].detach()
    azimuth, polar_angle = direction_to_angles(torch.where(near[..., None], directions.detach(), directions))
    cosine = torch.where(near, directions[..., 1], torch.zeros_like(ring)) / squared[..., 0].sqrt()
    straight = linearised_arccos(cosine, cap)
    polar_angle = polar_angle + torch.where(near, straight - straight.detach(), torch.zeros_like(straight))
    return angles_to_pixel(azimuth, polar_angle, size)
