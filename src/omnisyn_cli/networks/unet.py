"""The UNet that corrects maps at full resolution: a wide look around at half the size, a narrow one at full size.

Fusion and completion are each one of these with planes of their own and answers of their own.
"""

import itertools
from dataclasses import dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.interface import Network, NetworkConfig, Ports, check_multiple
from omnisyn_cli.networks.layers import LEAK, ResidualBlock, WrappedConv, at_least_single, initialise, upsample_nearest


@dataclass(frozen=True)
class CorrectingConfig(NetworkConfig):
    """What makes one network of this kind differ from another.

    Attributes:
        name: of the variant.
        planes: input channels.
        widths: channels at strides 2, 4, 8, …
        fine: channels at full resolution.
    """

    name: str
    planes: int
    widths: tuple[int, ...]
    fine: int

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return int(2 ** len(self.widths))


class Hourglass(nn.Module):
    """Residual blocks down and up again, with skips that are added.

    Args:
        inputs: channels.
        widths: channels, from fine to coarse; each is half as high and wide as the one before.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.stem = ResidualBlock(inputs, widths[0])
        self.down = nn.ModuleList(ResidualBlock(a, b, (2, 2)) for a, b in itertools.pairwise(widths))
        self.middle: nn.Module = ResidualBlock(widths[-1], widths[-1])
        self.project = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in itertools.pairwise(widths))
        self.up = nn.ModuleList(ResidualBlock(a, a) for a in widths[:-1])

    def around(self, x: Float[Tensor, "batch inputs height width"]) -> Tensor:
        """What is seen around each pixel, ``(batch, widths[0], height, width)``."""
        x, skips = self.stem(x), []
        for block in self.down:
            skips.append(x)
            x = block(x)
        x = self.middle(x)
        for block, project, skip in reversed(list(zip(self.up, self.project, skips, strict=True))):
            x = block(functional.leaky_relu(upsample_nearest(project(x)) + skip, LEAK))
        return x


class CorrectingUNet(Hourglass, Network):
    """Planes in, answers of the same size out; nothing knows where the seam is.

    Networks inherit its layers, so that checkpoints name them without a prefix, and give the last one, ``answer``, the
    weights that they want to begin with.

    Args:
        config: of the network.
        answers: output channels.
    """

    def __init__(self, config: CorrectingConfig, answers: int) -> None:
        planes, fine = config.planes, config.fine
        super().__init__(4 * planes, config.widths)
        self.config: Any = config
        self.spread = nn.Conv2d(config.widths[0], 4 * fine, 1)
        self.look = WrappedConv(planes, fine)
        self.fine = ResidualBlock(fine, fine)
        self.answer = WrappedConv(fine, answers)
        initialise(self)

    @property
    def ports(self) -> Ports:
        """Planes of any size."""
        return Ports({"planes": self.config.planes})

    def answers(
        self, planes: Float[Tensor, "batch planes height width"]
    ) -> Float[Tensor, "batch answers height width"]:
        """What the network says, in single precision.

        Raises:
            ValueError: the size is not a multiple of ``config.size_multiple``.
        """
        check_multiple(planes, self.config.size_multiple)
        x = self.around(functional.pixel_unshuffle(planes, 2))
        x = functional.pixel_shuffle(self.spread(x), 2)
        x = self.fine(functional.leaky_relu(x + self.look(planes), LEAK))
        return at_least_single(self.answer(x))
