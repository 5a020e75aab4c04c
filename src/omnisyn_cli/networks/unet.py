"""The refinement UNet: an hourglass at half the size for context, and a few convolutions at full size for detail.

Fusion and completion are each one of these, with input channels and outputs of their own.
"""

import itertools
from dataclasses import dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.interface import Network, NetworkConfig, Ports, check_multiple
from omnisyn_cli.networks.layers import LEAK, ResidualBlock, WrappedConv, at_least_single, initialise


@dataclass(frozen=True)
class RefinementUNetConfig(NetworkConfig):
    """The sizes: channels of the input, channels at strides 2, 4, 8, …, and channels at full resolution."""

    name: str
    channels: int
    widths: tuple[int, ...]
    fine: int

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return int(2 ** len(self.widths))


class Hourglass(nn.Module):
    """Residual blocks down and up, skips added; ``widths`` from fine to coarse, each map half the size of the last."""

    def __init__(self, inputs: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.stem = ResidualBlock(inputs, widths[0])
        self.down = nn.ModuleList(ResidualBlock(a, b, (2, 2)) for a, b in itertools.pairwise(widths))
        self.middle: nn.Module = ResidualBlock(widths[-1], widths[-1])
        self.project = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in itertools.pairwise(widths))
        self.up = nn.ModuleList(ResidualBlock(a, a) for a in widths[:-1])

    def encode(self, x: Float[Tensor, "batch inputs height width"]) -> Tensor:
        """Features with context around each pixel, ``(batch, widths[0], height, width)``."""
        x, skips = self.stem(x), []
        for block in self.down:
            skips.append(x)
            x = block(x)
        x = self.middle(x)
        for block, project, skip in reversed(list(zip(self.up, self.project, skips, strict=True))):
            x = block(
                functional.leaky_relu(functional.interpolate(project(x), scale_factor=2.0, mode="nearest") + skip, LEAK)
            )
        return x


class RefinementUNet(Hourglass, Network):
    """Rolled input rolls the output. Networks inherit it, so that checkpoints name layers without a prefix."""

    output_names = Ports.outputs

    def __init__(self, config: RefinementUNetConfig, outputs: int) -> None:
        channels, fine = config.channels, config.fine
        super().__init__(4 * channels, config.widths)
        self.config: Any = config
        self.expand = nn.Conv2d(config.widths[0], 4 * fine, 1)
        self.skip = WrappedConv(channels, fine)
        self.fine = ResidualBlock(fine, fine)
        self.head = WrappedConv(fine, outputs)
        initialise(self)

    @property
    def ports(self) -> Ports:
        """Input channels of any size."""
        return Ports({"planes": self.config.channels}, self.output_names)

    def predict(
        self, channels: Float[Tensor, "batch channels height width"]
    ) -> Float[Tensor, "batch outputs height width"]:
        """The outputs, in single precision; ValueError for a size that is no multiple of ``config.size_multiple``."""
        check_multiple(channels, self.config.size_multiple)
        x = self.encode(functional.pixel_unshuffle(channels, 2))
        x = functional.pixel_shuffle(self.expand(x), 2)
        x = self.fine(functional.leaky_relu(x + self.skip(channels), LEAK))
        return at_least_single(self.head(x))
