"""SynSin's three networks for equirectangular images: depth of one panorama, its features, and a picture of points.

``depth`` is inverse depth (1/m) of a single upright panorama, learned from scenes in metres: nothing in one picture
gives a scale but what is known of the world. ``encoder`` makes features of every pixel, the first three its colours.
``decoder`` takes blended points (:mod:`omnisyn_cli.baselines.soft_points`) and their opacity to a picture; it adds a
correction to their colours and makes some up where no point is seen. A channel with the row (CoordConv) tells up from
down. Points are blended by other means in between, hence three networks and three files.

Source: Wiles et al., SynSin (CVPR 2020); on the sphere as the baseline of OmniSyn, section 4.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.interface import Hourglass, Network, NetworkConfig, Ports, check_multiple
from omnisyn_cli.networks.layers import LEAK, ResidualBlock, WrappedConv, at_least_single, init_small, initialise
from omnisyn_cli.networks.paper import RGB_CHANNELS, row_channel

# √(inverse depth in 1/m) that a fresh depth network predicts everywhere: six metres, as rooms are large.
INITIAL_SQRT_INV_DEPTH = 0.4
# Floor of the opacity that colours of points are divided by: pixels without points stay dark.
MIN_DIVISOR_OPACITY = 0.05


@dataclass(frozen=True)
class SynSinConfig(NetworkConfig):
    """The networks' sizes."""

    name: str  # of the variant
    size: tuple[int, int]  # ``(height, width)`` they are trained and exported at
    features: int = 8  # channels of every point, colours included (64 in the paper)
    depth_widths: tuple[int, ...] = (32, 64, 96, 128)  # channels of the depth network, from stride 4 on
    decoder_widths: tuple[int, ...] = (24, 40, 64)  # channels of the decoder, from stride 2 on
    fine: int = 16  # channels of the depth network at stride 2, and half as many of the decoder at full resolution
    max_sqrt_inv_depth: float = 2.0  # largest √(inverse depth in 1/m) that is predicted
    radius: float = 2.0  # of a point in rows; at 128 rows the angle of the paper's 4 at 256
    points: int = 16  # that a pixel is made of at most (128 in the paper)

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return int(2 ** max(len(self.depth_widths) + 1, len(self.decoder_widths)))


SYNSIN_VARIANTS = {"small": SynSinConfig("small", (128, 256))}  # The networks by name


def inverse_depth_of(sqrt_inv_depth: Tensor, config: SynSinConfig) -> Tensor:
    """1/metre of the depth network's output, bounded; below zero is infinitely far."""
    return sqrt_inv_depth.clamp(0.0, config.max_sqrt_inv_depth).square()


class SynSinPart(Network):
    """One of the three; its file has a size, and says how wide points are (rows) and how many make a pixel."""

    input_name, output_name = "image", "inverse_depth"  # Input and output of the file; inverse depth is in 1/m.

    def __init__(self, config: SynSinConfig) -> None:
        super().__init__()
        self.config: SynSinConfig = config

    @property
    def ports(self) -> Ports:
        """One map in, one out."""
        channels = self.config.features + 1 if self.input_name == "points" else RGB_CHANNELS
        notes = {"radius": repr(self.config.radius), "points": str(self.config.points)}
        return Ports({self.input_name: channels}, (self.output_name,), self.config.size, notes)


class MonocularNetwork(SynSinPart):
    """One upright panorama in, √(inverse depth in 1/m) out; below zero is infinitely far."""

    def __init__(self, config: SynSinConfig) -> None:
        super().__init__(config)
        self.body = Hourglass(16 * (RGB_CHANNELS + 1), config.depth_widths)
        self.expand = nn.Conv2d(config.depth_widths[0], 4 * config.fine, 1)
        self.skip = WrappedConv(4 * (RGB_CHANNELS + 1), config.fine)
        self.fine = ResidualBlock(config.fine, config.fine)
        self.head = WrappedConv(config.fine, 4)

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Estimate; ValueError for a size that is no multiple of ``config.size_multiple``."""
        check_multiple(image, self.config.size_multiple)
        seen = torch.cat([image - 0.5, row_channel(image)], dim=1)
        coarse = functional.pixel_shuffle(self.expand(self.body.encode(functional.pixel_unshuffle(seen, 4))), 2)
        fine = functional.leaky_relu(coarse + self.skip(functional.pixel_unshuffle(seen, 2)), LEAK)
        return functional.pixel_shuffle(at_least_single(self.head(self.fine(fine))), 2)

    def outputs(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Inverse depth."""
        return (inverse_depth_of(self(*inputs), self.config),)


class FeatureEncoder(SynSinPart):
    """One panorama in, the features of its pixels out: the colours, and what two convolutions see around them."""

    output_name = "features"

    def __init__(self, config: SynSinConfig) -> None:
        super().__init__(config)
        self.block = ResidualBlock(RGB_CHANNELS + 1, config.features)
        self.head = nn.Conv2d(config.features, config.features - RGB_CHANNELS, 1)

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch features height width"]:
        """Encode."""
        seen = torch.cat([image - 0.5, row_channel(image)], dim=1)
        return torch.cat([image, at_least_single(self.head(self.block(seen)))], dim=1)


class RefinementDecoder(SynSinPart):
    """Blended features and their opacity in, colours out: those of the points and a correction."""

    input_name, output_name = "points", "colour"

    def __init__(self, config: SynSinConfig) -> None:
        super().__init__(config)
        channels = config.features + 2
        self.body = Hourglass(4 * channels, config.decoder_widths)
        self.expand = nn.Conv2d(config.decoder_widths[0], 2 * config.fine, 1)
        self.skip = WrappedConv(channels, config.fine // 2)
        self.head = WrappedConv(config.fine // 2, RGB_CHANNELS)

    def forward(self, points: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch 3 height width"]:
        """Decode; ValueError for a size that is no multiple of ``config.size_multiple``."""
        check_multiple(points, self.config.size_multiple)
        seen = torch.cat([points, row_channel(points)], dim=1)
        coarse = functional.pixel_shuffle(self.expand(self.body.encode(functional.pixel_unshuffle(seen, 2))), 2)
        correction = self.head(functional.leaky_relu(coarse + self.skip(seen), LEAK))
        colours: Tensor = points[:, :RGB_CHANNELS] / points[:, -1:].clamp(min=MIN_DIVISOR_OPACITY) + correction
        return colours


class SynSinNetwork(nn.Module):
    """All three, for training together."""

    def __init__(self, config: SynSinConfig) -> None:
        super().__init__()
        self.config = config
        self.depth = MonocularNetwork(config)
        self.encoder = FeatureEncoder(config)
        self.decoder = RefinementDecoder(config)
        initialise(self)
        init_small(self.depth.head, self.decoder.head)
        nn.init.constant_(self.depth.head.bias, INITIAL_SQRT_INV_DEPTH)  # type: ignore[arg-type]
