"""Whether a panorama stands upright, told by an encoder that learned from photographs that people took upright."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omnisyn_cli.networks.efficientnet import STAGES, EfficientNetLite0
from omnisyn_cli.networks.interface import Network, NetworkConfig, Ports
from omnisyn_cli.networks.layers import sizes

BANDS = 4  # of latitude, of which the mean features are weighted


@dataclass(frozen=True)
class AttitudeConfig(NetworkConfig):
    """What makes one network differ from another."""

    name: str = "lite0"
    size: tuple[int, int] = (128, 256)  # ``(height, width)`` of the exported file
    blocks: int = 12  # of the encoder: those up to the first at stride 32
    channels: int = STAGES[5][-1]  # of the last of them

    size_multiple = 32


class AttitudeNetwork(Network):
    """A weighted sum of the encoder's features: log odds of a way to hold a picture against the other ways."""

    def __init__(self, config: AttitudeConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = EfficientNetLite0(config.blocks)
        self.weights = nn.Parameter(torch.zeros(BANDS * config.channels, 1))

    @property
    def ports(self) -> Ports:
        """A picture in, a number out."""
        return Ports({"image": 3}, ("log_odds",), self.config.size, is_folded=False)

    def features(self, image: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch features"]:
        """Means over the bands of colours in [0, 1]."""
        found = self.encoder.maps(image)[-1].mean(dim=-1)
        batch, channels, rows = sizes(found)
        area = torch.sin((torch.arange(rows) + 0.5) * (torch.pi / rows)).view(BANDS, -1)
        return ((found.view(batch, channels, BANDS, -1) * area).sum(dim=-1) / area.sum(dim=-1)).flatten(1)

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 1 1"]:
        """One number; only its differences between the ways to hold a picture mean something."""
        return (self.features(image) @ self.weights)[:, None, None]
