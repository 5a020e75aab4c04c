"""The sphere sweep of the epipole frame: products of the rows of two meridians, resampled to spheres or looked up.

Source: OmniSyn, section 3.2, for the sweep; RAFT for the lookup.
"""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from omnisyn_cli.geometry.sphere import angles_to_pixel, pixel_to_angles
from omnisyn_cli.geometry.sweep import parallax_from_inverse_depth
from omnisyn_cli.networks.layers import at_least_single, sizes


def resampling_matrix(
    roots: Float[np.ndarray, " levels"], rows_first: int, rows_second: int
) -> Float[np.ndarray, "levels rows_first rows_second"]:
    """Weights of the second image's rows for each sphere and each row of the first, float32; every row sums to 1.

    Linear interpolation at the row where a point of the sphere is seen by the second camera, in the epipole frame.
    """
    row = np.arange(rows_first, dtype=np.float64)[None, :]
    seen = np.asarray(_row_in_second(row, np.maximum(roots, 0.0)[:, None], rows_first, rows_second))
    seen = np.clip(seen, 0.0, rows_second - 1.0)[..., None]
    distance = np.abs(seen - np.arange(rows_second))
    return np.asarray(np.maximum(1.0 - distance, 0.0), np.float32)


def _row_in_second(row: Any, root: Any, rows_first: int, rows_second: int) -> Any:
    """Row index (fractional) in the second image of points at ``root`` in a row of the first."""
    _, polar_angle = pixel_to_angles(row, row, (rows_first, 2 * rows_first))
    seen_angle = polar_angle + parallax_from_inverse_depth(polar_angle, root * root)
    return angles_to_pixel(seen_angle, seen_angle, (rows_second, 2 * rows_second))[0]


def meridian_products(
    first: Float[Tensor, "batch groups channels rows_first width"],
    second: Float[Tensor, "batch groups channels rows_second width"],
) -> Float[Tensor, "batch groups width rows_first rows_second"]:
    """Scalar products of all features of each meridian of the first image with all of the same of the second."""
    return torch.matmul(first.permute(0, 1, 4, 3, 2), second.permute(0, 1, 4, 2, 3))


def sphere_volume(
    products: Float[Tensor, "batch groups width rows_first rows_second"],
    matrix: Float[Tensor, "levels rows_first rows_second"],
) -> Float[Tensor, "batch groups levels rows_first width"]:
    """Pairs of rows resampled to spheres."""
    batch, groups, width, rows_first, rows_second = sizes(products)
    by_row = products.permute(3, 4, 0, 1, 2).reshape(rows_first, rows_second, batch * groups * width)
    volume = torch.matmul(matrix.transpose(0, 1), by_row)  # (rows_first, levels, batch·groups·width)
    return volume.view(rows_first, -1, batch, groups, width).permute(2, 3, 1, 0, 4)


def lookup(
    products: Float[Tensor, "batch groups width rows_first rows_second"],
    roots: Float[Tensor, "batch candidates rows_first width"],
) -> Float[Tensor, "batch groups candidates rows_first width"]:
    """The products at the rows where points at the candidate roots are seen, linearly interpolated.

    No gradient reaches the roots. Rows beyond a pole read the last row. Rows of half-precision products are found in
    single precision, as eight bits cannot tell where between two rows a point lies.
    """
    rows_first, rows_second = sizes(products)[-2:]
    products = at_least_single(products)
    with torch.no_grad():
        row = torch.arange(rows_first, dtype=roots.dtype, device=roots.device).view(1, 1, -1, 1)
        seen = _row_in_second(row, roots.clamp(min=0.0), rows_first, rows_second)
        seen = seen.clamp(0.0, rows_second - 1.0).permute(0, 3, 2, 1).unsqueeze(1)  # batch, 1, width, rows, candidates
        seen = seen.expand(-1, sizes(products)[1], -1, -1, -1)
        lower = seen.floor()
        share = seen - lower
        index = lower.long()
    above = products.gather(-1, index)
    below = products.gather(-1, (index + 1).clamp(max=rows_second - 1))
    return torch.lerp(above, below, share).permute(0, 1, 4, 3, 2)
