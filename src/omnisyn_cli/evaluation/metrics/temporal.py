"""How steady a video of a static scene is, followed along the geometry it was made with.

A point that is seen in one frame is found in another by its inverse depth (1/m; 0 is infinitely far, negative or NaN
unknown) and both poses, world-from-camera; nothing is estimated from the pictures, RGB in [0, 1]. Means are weighted by
solid angle. ValueError: neighbours have nothing in common.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.evaluation.metrics.image import ws_psnr
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bicubic, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions, row_weights
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.geometry.tolerances import SAME_POINT_TOLERANCE

# Inverse depth, 1/m, below which values always agree: beyond a kilometre parallax is invisible.
FAR_INVERSE_DEPTH = 1e-3

Frames = Sequence[Float[np.ndarray, "height width 3"]]
InverseDepths = Sequence[Float[np.ndarray, "height width"]]


def change_psnr(frames: Frames, truths: Frames) -> list[float]:
    """WS-PSNR of ``(made_k − made_{k−1}) − (true_k − true_{k−1})``, dB: what is wrong alike in both is no error."""
    return [
        ws_psnr(after - before, true_after - true_before)
        for (before, after), (true_before, true_after) in zip(pairwise(frames), pairwise(truths), strict=True)
    ]


def warping_error(frames: Frames, inverse_depths: InverseDepths, poses: Sequence[Pose]) -> float:
    """Mean absolute difference between a frame and the next one warped into it, where both see the same point.

    The mean over pairs of neighbours (two frames at least), each over what both see. Reflections and blur by
    interpolation count as errors. Source: Lai et al., Learning blind video temporal consistency, 2018, with geometry
    for optical flow and absolute differences.
    """
    errors = []
    for here in range(len(frames) - 1):
        warped, visible = _warp(here, here + 1, frames, inverse_depths, poses)
        errors.append(_mean(np.abs(warped - frames[here]), visible))
    return float(np.mean(errors))


def flicker(frames: Frames, inverse_depths: InverseDepths, poses: Sequence[Pose]) -> float:
    """Mean absolute second difference in time, ``|before − 2·now + after|``, of every point that three frames see.

    A steady change is no flicker; a point that lights up for one frame by e counts 2·e. At least three frames.
    """
    errors = []
    for now in range(1, len(frames) - 1):
        before, visible_before = _warp(now, now - 1, frames, inverse_depths, poses)
        after, visible_after = _warp(now, now + 1, frames, inverse_depths, poses)
        errors.append(_mean(np.abs(before - 2.0 * frames[now] + after), visible_before & visible_after))
    return float(np.mean(errors))


def _warp(
    here: int, there: int, frames: Frames, inverse_depths: InverseDepths, poses: Sequence[Pose]
) -> tuple[Float[np.ndarray, "height width 3"], Bool[np.ndarray, "height width"]]:
    """Colours in frame ``there`` of the points that the pixels of frame ``here`` show, and which of them it sees."""
    rho = inverse_depths[here].astype(np.float64)
    known = rho >= 0
    there_from_here = poses[there].inverse() @ poses[here]
    rays = sweep_directions(pixel_directions(*rho.shape), np.where(known, rho, 0.0), there_from_here)
    length = np.linalg.norm(rays, axis=-1)
    reached = known & (length > 0)
    expected = rho / np.where(reached, length, 1.0)
    seen = sample_nearest(inverse_depths[there], rays)
    agreeing = np.abs(expected - seen) <= np.maximum(SAME_POINT_TOLERANCE * expected, FAR_INVERSE_DEPTH)
    return sample_bicubic(frames[there].astype(np.float64), rays), reached & (seen >= 0) & agreeing


def _mean(error: Float[np.ndarray, "height width 3"], visible: Bool[np.ndarray, "height width"]) -> float:
    weights = row_weights(len(error))[:, None] * visible
    if not weights.any():
        raise ValueError("expected neighbouring frames with something in common, got none; take smaller steps")
    return float(np.average(error.mean(axis=-1), weights=weights))
