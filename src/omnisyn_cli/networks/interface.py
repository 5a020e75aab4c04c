"""What all networks share: a configuration, a prediction, and the inputs and outputs of their files."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from jaxtyping import Float
from torch import Tensor, nn

from omnisyn_cli.networks.layers import sizes


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
