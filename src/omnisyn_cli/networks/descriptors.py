"""Descriptors of pixels for matching: alike where both panoramas show the same spot, from however far apart.

Maps of an encoder that learned from photographs become one vector for every 2×2 pixels. The squared distance of two is
the cost of a match, as a log-likelihood. Source: Luo et al., Efficient deep learning for stereo matching, 2016.
"""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.efficientnet import CHANNELS, TAPS, EfficientNetLite0
from omnisyn_cli.networks.interface import Network, NetworkConfig, Ports, check_multiple
from omnisyn_cli.networks.layers import wrap_columns

LEVELS = 3  # maps of the encoder that are used, at strides 2, 4 and 8


@dataclass(frozen=True)
class DescriptorConfig(NetworkConfig):
    """The sizes."""

    name: str = "lite0"
    length: int = 24  # of a descriptor
    hidden: int = 48  # channels that context is mixed in

    size_multiple = 8


DESCRIPTOR_VARIANTS = {"lite0": DescriptorConfig()}


class DescriptorNetwork(Network):
    """A linear function of the encoder's maps, and what a layer of 3×3 adds to it. Rolled input rolls the output."""

    def __init__(self, config: DescriptorConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = EfficientNetLite0(TAPS[LEVELS - 1] + 1)
        inner = config.length + config.hidden
        self.proj = nn.ModuleList(nn.Conv2d(count, inner, 1, bias=count == CHANNELS[0]) for count in CHANNELS[:LEVELS])
        self.mix = nn.Conv2d(config.hidden, config.hidden, 3, groups=config.hidden)
        self.out = nn.Conv2d(config.hidden, config.length, 1)

    @property
    def ports(self) -> Ports:
        """A picture of any size in, descriptors at half the size out."""
        return Ports({"image": 3}, ("descriptors",), is_folded=False)

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch length rows cols"]:
        """Of colours in [0, 1]; ValueError for a size that is no multiple of ``config.size_multiple``."""
        check_multiple(image, self.config.size_multiple)
        maps = self.encoder.maps(image)
        parts = [project(maps[tap]) for project, tap in zip(self.proj, TAPS[:LEVELS], strict=True)]
        total = parts[0]
        for level, part in enumerate(parts[1:], 1):
            scale = 2**level
            finer = functional.interpolate(wrap_columns(part, 1, 1), scale_factor=float(scale), mode="bilinear")
            total = total + finer[..., scale:-scale]
        linear, hidden = total.split([self.config.length, self.config.hidden], dim=1)
        wide = functional.pad(wrap_columns(functional.relu(hidden), 1, 1), (0, 0, 1, 1))
        answer: Tensor = linear + self.out(functional.relu(self.mix(wide)))
        return answer
