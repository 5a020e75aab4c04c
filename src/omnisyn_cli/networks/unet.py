"""The UNet that corrects maps at full resolution: a wide look around at half the size, a narrow one at full size.

Fusion and refinement are both one of these with planes of their own and answers of their own.
"""

from __future__ import annotations

import itertools

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.layers import LEAK, ResidualBlock, WrappedConv, initialise, sizes, upsample_nearest

__all__ = ["CorrectingUNet", "Hourglass", "check_multiple"]


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
        self.middle = ResidualBlock(widths[-1], widths[-1])
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


class CorrectingUNet(Hourglass):
    """Planes in, answers of the same size out; nothing knows where the seam is.

    Networks inherit its layers, so that checkpoints name them without a prefix, and give the last one, ``answer``, the
    weights that they want to begin with.

    Args:
        planes: input channels.
        widths: channels at strides 2, 4, 8, …
        fine: channels at full resolution.
        answers: output channels.
    """

    def __init__(self, planes: int, widths: tuple[int, ...], fine: int, answers: int) -> None:
        super().__init__(4 * planes, widths)
        self.spread = nn.Conv2d(widths[0], 4 * fine, 1)
        self.look = WrappedConv(planes, fine)
        self.fine = ResidualBlock(fine, fine)
        self.answer = WrappedConv(fine, answers)
        initialise(self)

    def answers(
        self, planes: Float[Tensor, "batch planes height width"]
    ) -> Float[Tensor, "batch answers height width"]:
        """What the network says; height and width are multiples of ``2 ** len(widths)``."""
        x = self.around(functional.pixel_unshuffle(planes, 2))
        x = functional.pixel_shuffle(self.spread(x), 2)
        x = self.fine(functional.leaky_relu(x + self.look(planes), LEAK))
        answers: Tensor = self.answer(x)
        return answers


def check_multiple(planes: Tensor, multiple: int) -> None:
    """ValueError unless height and width are multiples."""
    if any(size % multiple for size in sizes(planes)[-2:]):
        raise ValueError(f"expected a size of multiples of {multiple}, got {sizes(planes)[-2:]}")
