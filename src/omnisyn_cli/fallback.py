"""What is shown where a frame cannot be relied on: the two photographs, cross-faded, which is wrong but honest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.confidence import doubtful_regions
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture

__all__ = ["CrossFade"]


class CrossFade:
    """Both photographs of a pair, turned but not moved. Not shared between threads.

    Args:
        images: the photographs, painted over where they may not be shown.
        poses: of both, world-from-camera.
        size: height and width of the frames.
        threads: at most this many; None is one per core.
    """

    def __init__(
        self, images: Sequence[np.ndarray], poses: Sequence[Pose], size: tuple[int, int], threads: int | None = None
    ) -> None:
        self._poses = tuple(poses)
        self._textures = [make_texture(image) for image in images]
        self._shader = Shader(size, threads)

    def __call__(
        self,
        image: Float32[np.ndarray, "height width 3"],
        confidence: Float32[np.ndarray, "height width"],
        pose: Pose,
        t: float,
    ) -> None:
        """Replace the doubtful regions of a frame, in place.

        Args:
            image: the frame.
            confidence: of its pixels, in [0, 1].
            pose: world-from-camera of the frame; only its orientation matters.
            t: share of the way, the share of the second photograph.
        """
        doubt = doubtful_regions(confidence)[..., None]
        if not doubt.any():
            return
        image *= 1.0 - doubt
        for source, texture, share in zip(self._poses, self._textures, (1.0 - t, t), strict=True):
            turn = Pose(pose.rotation.T @ source.rotation, np.zeros(3))
            image += np.float32(share) * doubt * np.maximum(self._shader.infinitely_far(texture, turn)[..., :3], 0.0)
