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
from omnisyn_cli.types import View

FADE_SHARE = 0.05  # share of the way in which what is masked fades: four frames of ninety. Set by hand.


class MaskedFade:
    """What is masked in two photographs, where they show it: seen at the ends of the way and faded in a few frames."""

    def __init__(self, views: Sequence[View], size: tuple[int, int], threads: int | None = None) -> None:
        self._poses = [view.pose for view in views]
        self._textures = [
            make_texture(view.image if view.image_uint8 is None else view.image_uint8, ~view.mask)
            if view.shows_masked and view.mask is not None and not view.mask.all()
            else None
            for view in views
        ]
        self._photograph_shader, self._threads = Shader(size, threads), threads

    def __call__(self, image: Shaped[np.ndarray, "height width 3"], pose: Pose, t: float) -> None:
        """Show the masked pixels of the photograph at the nearer end, in place, if that is near enough."""
        nearer, quantization = int(t > 0.5), quantization_for(image)
        share, texture = 1.0 - min(t, 1.0 - t) / FADE_SHARE, self._textures[nearer]
        if texture is None or share <= 0.0:
            return
        turn = Pose(pose.rotation.T @ self._poses[nearer].rotation, np.zeros(3))

        def band(begin: int, end: int) -> None:
            for top in range(begin, end, TILE_ROWS):
                rows = slice(top, min(top + TILE_ROWS, end))
                photograph = self._photograph_shader.rows_at_infinity(texture, turn, rows.start, rows.stop)
                weight = np.float32(share) * np.clip(photograph[..., 3:], 0.0, 1.0)
                if weight.any():
                    mixed = (1.0 - weight) * (image[rows] / quantization.scale) + weight * photograph[..., :3]
                    mixed = np.clip(mixed, 0.0, quantization.max_colour)
                    image[rows] = mixed * quantization.scale + quantization.rounding

        run_ranges(band, len(image), self._threads)


class CrossFade:
    """Both photographs of a pair, turned but not moved, painted over where they are masked. Not shared by threads."""

    def __init__(
        self, images: Sequence[np.ndarray], poses: Sequence[Pose], size: tuple[int, int], threads: int | None = None
    ) -> None:
        self._poses = tuple(poses)
        self._textures = [make_texture(image) for image in images]
        self._photograph_shader, self._threads = Shader(size, threads), threads

    def __call__(
        self, image: Shaped[np.ndarray, "height width 3"], confidence: Float32[np.ndarray, "height width"], pose: Pose,
        t: float,
    ) -> None:  # fmt: skip
        """Replace the doubtful regions of a frame, numbers or samples, in place, by its confidence in [0, 1].

        Of the frame's pose only the orientation matters. ``t`` is the share of the second photograph.
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
                        photograph = self._photograph_shader.rows_at_infinity(texture, turn, rows.start, rows.stop)
                        mixed += np.float32(share) * here * np.maximum(photograph[..., :3], 0.0)
                    mixed = np.minimum(mixed, quantization.max_colour)
                    image[rows] = mixed * quantization.scale + quantization.rounding

        run_ranges(band, len(image), self._threads)
