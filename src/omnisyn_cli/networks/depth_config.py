"""What makes one stereo network differ from another, and those that there are."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from omnisyn_cli.networks.interface import NetworkConfig

__all__ = ["VARIANTS", "DepthConfig"]


@dataclass(frozen=True)
class DepthConfig(NetworkConfig):
    """What makes one depth network differ from another; those of ``fast`` unless changed.

    Attributes:
        name: of the variant.
        size: ``(height, width)`` it is trained and exported at; multiples of eight times ``coarse_stride``.
        widths: encoder channels at strides 2, 4, 8, …; those beyond ``coarse_stride`` are for context.
        coarse_stride: pixels of the image per cell of the sphere volume: 4 or 8.
        levels: spheres of the volume.
        greatest_root: root of the nearest sphere.
        match_channels: features compared, in ``match_groups`` groups.
        match_groups: similarity channels that are learned.
        hidden: channels of the aggregation.
        volume_filters: channels of 3-D filters over the volume before spheres become channels; 0 leaves them out.
        refined_widths: channels of each refinement, coarse to fine.
        reach: candidates on either side of the estimate in a refinement.
    """

    name: str
    size: tuple[int, int] = (256, 512)
    widths: tuple[int, ...] = (24, 48, 64, 96, 96)
    coarse_stride: int = 8
    levels: int = 48
    greatest_root: float = 2.0
    match_channels: int = 32
    match_groups: int = 4
    hidden: int = 96
    volume_filters: int = 0
    refined_widths: tuple[int, ...] = (48, 24)
    reach: int = 4

    @property
    def size_multiple(self) -> int:
        """Image heights have to be a multiple of this."""
        return 8 * self.coarse_stride


VARIANTS = {
    "fast": DepthConfig("fast"),
    "accurate": DepthConfig(
        "accurate",
        size=(512, 1024),
        widths=(24, 48, 80, 128, 128),
        levels=80,
        match_channels=64,
        match_groups=8,
        hidden=128,
        volume_filters=16,
        refined_widths=(64, 32),
        reach=6,
    ),
}
"""The networks by name."""


def level_roots(config: DepthConfig) -> Float[np.ndarray, " levels"]:
    """Roots of the spheres of the volume: even steps, the first one below zero so that a mean can reach zero."""
    step = config.greatest_root / (config.levels - 2)
    return np.asarray(np.linspace(-step, config.greatest_root, config.levels))
