"""What networks share: a configuration, a prediction, the inputs and outputs of their files, and the refinement UNet.

That is an hourglass at half the size for context, and a few convolutions at full size for detail. Fusion and completion
are each one of these, with input channels and outputs of their own.
"""

import itertools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.layers import LEAK, ResidualBlock, WrappedConv, at_least_single, initialise, sizes


@dataclass(frozen=True)
class NetworkConfig:
    """The sizes of a network: plain values and tuples of them."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """The inverse of :meth:`as_dict`; unknown and missing keys are errors."""
        return cls(**{key: tuple(v) if isinstance(v, list) else v for key, v in values.items()})


@dataclass(frozen=True)
class Ports:
    """What goes in and out of a network's file, all of it ``(1, channels, height, width)``."""

    inputs: Mapping[str, int]  # channels by name
    outputs: tuple[str, ...] = ("inverse_depth", "confidence")  # names
    # ``(height, width)`` that it takes; None for all multiples of its configuration's ``size_multiple``
    size: tuple[int, int] | None = None
    notes: Mapping[str, str] = field(default_factory=dict)  # for the metadata
    is_folded: bool = True  # whether constants are computed when the file is written
    own_sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)  # of inputs that are not of that size

    def input_shapes(self, size: tuple[int, int]) -> dict[str, tuple[int, int, int]]:
        """Channels, height and width of each input, of a network that is called at ``size``."""
        return {name: (channels, *self.own_sizes.get(name, size)) for name, channels in self.inputs.items()}


class Network(nn.Module):
    """A network that becomes a file of its own; ``config`` says what it is made of."""

    config: Any

    @property
    def ports(self) -> Ports:
        """What goes in and out."""
        raise NotImplementedError

    def outputs(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """The outputs of the file, in the order of ``ports.outputs``."""
        answer = self(*inputs)
        return (answer,) if isinstance(answer, Tensor) else answer.outputs()


class DepthPrediction:
    """A depth network's answer: √(inverse depth × baseline), below zero at infinity, and ``confidence_logit``."""

    confidence_logit: Tensor

    def sqrt_inv_depth(self) -> Float[Tensor, "batch 1 height width"]:
        """The estimate."""
        raise NotImplementedError

    def inverse_depth(self) -> Float[Tensor, "batch 1 height width"]:
        """Inverse depth × baseline: bounded, never negative, exactly 0 where nothing is there."""
        return self.sqrt_inv_depth().clamp(min=0.0).square()

    def confidence(self) -> Float[Tensor, "batch 1 height width"]:
        """Probability that the depth is within 10 % of the truth."""
        return self.confidence_logit.sigmoid()

    def outputs(self) -> tuple[Tensor, ...]:
        """The outputs of the file."""
        return self.inverse_depth(), self.confidence()


def check_multiple(x: Tensor, multiple: int) -> None:
    """ValueError unless height and width are multiples."""
    height, width = sizes(x)[-2:]
    if height % multiple or width % multiple:
        raise ValueError(f"expected a size of multiples of {multiple}, got {width}×{height}")


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
