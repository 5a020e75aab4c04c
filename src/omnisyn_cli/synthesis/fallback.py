"""What is shown where a frame cannot be relied on: the two photographs, cross-faded, which is wrong but honest."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_kernels import quantization_for
from omnisyn_cli.fusion.confidence import low_confidence_regions
from omnisyn_cli.fusion.layer_pair import TILE_ROWS
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture


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
        self._shader, self._threads = Shader(size, threads), threads

    def __call__(
        self,
        image: Shaped[np.ndarray, "height width 3"],
        confidence: Float32[np.ndarray, "height width"],
        pose: Pose,
        t: float,
    ) -> None:
        """Replace the doubtful regions of a frame, in place.

        Args:
            image: the frame, numbers or samples.
            confidence: of its pixels, in [0, 1].
            pose: world-from-camera of the frame; only its orientation matters.
            t: share of the way, the share of the second photograph.
        """
        weight, quantization = low_confidence_regions(confidence), quantization_for(image)
        turns = [Pose(pose.rotation.T @ source.rotation, np.zeros(3)) for source in self._poses]

        def band(begin: int, end: int) -> None:
            for top in range(begin, end, TILE_ROWS):
                rows = slice(top, min(top + TILE_ROWS, end))
                here, mixed = weight[rows, :, None], image[rows] / quantization.scale
                if here.any():
                    mixed *= 1.0 - here
                    for turn, texture, share in zip(turns, self._textures, (1.0 - t, t), strict=True):
                        photograph = self._shader.rows_at_infinity(texture, turn, rows.start, rows.stop)[..., :3]
                        mixed += np.float32(share) * here * np.maximum(photograph, 0.0)
                    image[rows] = (
                        np.minimum(mixed, quantization.max_colour) * quantization.scale + quantization.rounding
                    )

        run_ranges(band, len(image), self._threads)
