"""The depth network of the paper, layer for layer: a sphere sweep of learned features, a 3-D UNet, two heads.

Both panoramas come in the frame of :func:`omnisyn_cli.geometry.sweep.forward_frame`: the second camera lies straight
ahead and up is up, so that the sweep is a constant. Everything is in ``inverse depth × baseline``, dimensionless.

1. A UNet makes 32 features of each panorama at a quarter of its size.
2. For each of 64 spheres, even in inverse depth: the absolute difference of the first panorama's features and the
   second one's, as the first camera would see them painted on that sphere.
3. A 3-D UNet takes this volume to one number for each sphere and direction.
4. The low head, a 1×1 convolution, makes inverse depth of them; the high head does it at full size with the first
   panorama's features beside them (the monocular skip).

Source: OmniSyn, sections 3.1 to 3.4; ``docs/training.md`` says where the authors' programs differ.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.geometry.sphere import pixel_to_angles
from omnisyn_cli.networks.interface import DepthPrediction, Network, NetworkConfig, Ports, check_multiple
from omnisyn_cli.networks.layers import initialise, sizes, wrap_columns

LEAK = 0.01  # Slope of the LeakyReLU below zero


class UNet(nn.Module):
    """Blocks downwards with average pooling, and upwards with linear enlargement and skips; of images or volumes.

    As in the authors' network the first block on the way up has no skip, and blocks there have half the channels of the
    level below. ``widths`` are channels downwards, the bottleneck last; up to level ``finest``, at 0 with one channel.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...], *, finest: int, volumetric: bool = False) -> None:
        super().__init__()
        self.finest, self.deepest = finest, len(widths) - 2
        self.pool: nn.Module = nn.AvgPool3d(2) if volumetric else nn.AvgPool2d(2)
        entering = (inputs, *widths[:-1])
        self.down = nn.ModuleList(Block(a, b, volumetric=volumetric) for a, b in zip(entering, widths, strict=True))
        self.up = nn.ModuleList(
            Block(
                widths[-1] if level == self.deepest else 2 * widths[level],
                widths[level - 1] if level else 1,
                volumetric=volumetric,
            )
            for level in range(self.deepest, finest - 1, -1)
        )

    @property
    def blocks(self) -> list[Any]:
        """All of them, in the order in which they are used."""
        return [*self.down, *self.up]

    def forward(self, x: Tensor) -> Tensor:
        """``(batch, channels, *sizes)``, smaller by ``2 ** finest`` than the input."""
        skips = []
        for block in self.down[:-1]:
            skips.append(block(x))
            x = self.pool(skips[-1])
        x = self.down[-1](x)
        for level, block in zip(range(self.deepest, self.finest - 1, -1), self.up, strict=True):
            x = upsample_linear(x, 2)
            x = block(x if level == self.deepest else torch.cat([x, skips[level].to(x.dtype)], dim=1))
        return x


class Block(nn.Module):
    """Two 3×3 (or 3×3×3) convolutions with LeakyReLU; columns wrap, the other sides see zeros.

    ``has_row`` adds a channel, ``enlarge`` doubles the size first, a ``leak`` of 1 leaves both convolutions linear.
    """

    def __init__(
        self, inputs: int, outputs: int, *, has_row: bool = True, volumetric: bool = False, enlarge: bool = False,
        leak: float = LEAK,
    ) -> None:  # fmt: skip
        super().__init__()
        convolution = nn.Conv3d if volumetric else nn.Conv2d
        padding = (1, 1, 0) if volumetric else (1, 0)
        self.has_row, self.enlarge, self.leak = has_row, enlarge, leak
        self.first = convolution(inputs + has_row, outputs, 3, padding=padding)  # type: ignore[arg-type]
        self.second = convolution(outputs, outputs, 3, padding=padding)  # type: ignore[arg-type]

    @torch.no_grad()
    def init_identity(self, channels: int, begin: int) -> None:
        """Make the first outputs what the inputs from ``begin`` on are, as far as these are not negative."""
        for convolution, source in ((self.first, begin), (self.second, 0)):
            middle = (1,) * (convolution.weight.ndim - 2)
            for channel in range(channels):
                convolution.weight[channel] = 0.0
                convolution.weight[(channel, source + channel, *middle)] = 1.0

    def forward(self, x: Tensor) -> Tensor:
        """``(batch, outputs, *sizes)``."""
        if self.has_row:
            x = torch.cat([x, row_channel(x)], dim=1)
        if self.enlarge:
            x = upsample_linear(x, 2)
        for convolution in (self.first, self.second):
            x = functional.leaky_relu(convolution(wrap_columns(x, 1, 1)), self.leak)
        return x


def row_channel(like: Tensor) -> Tensor:
    """CoordConv: one channel with the polar angle as a share of a half turn, in (0, 1); rows and columns come last."""
    *_, height, width = sizes(like)
    row = torch.arange(height, dtype=torch.float32, device=like.device)
    polar_angle: Tensor = pixel_to_angles(row, row, (height, width))[1] / math.pi
    return polar_angle.to(like.dtype)[:, None].expand_as(like[:, :1])  # an exported file holds one column of it


def upsample_linear(x: Tensor, factor: int) -> Tensor:
    """Linear interpolation between the centres of cells, across the seam, in all dimensions but batch and channels."""
    mode = "trilinear" if x.ndim == 5 else "bilinear"
    wide: Tensor = functional.interpolate(wrap_columns(x, 1, 1), scale_factor=float(factor), mode=mode)
    return wide[..., factor:-factor]


FEATURE_STRIDE = 4  # Pixels of the image per cell of the sphere volume
MAX_INVERSE_DEPTH = 4.0  # Largest inverse depth × baseline that is predicted: a quarter of the baseline away
# Relative difference between the heads at which the confidence is a half: a tenth, as confidence is of 10 %.
HALF_CONFIDENCE_DIFFERENCE = 0.1
# Inverse depth × baseline below which differences are no longer relative: twenty baselines away.
MIN_RELATIVE_INVERSE_DEPTH = 0.05
# Inverse depth × baseline that a fresh network's low head predicts everywhere, more or less: four baselines away.
INITIAL_INVERSE_DEPTH = 0.25
INITIAL_COLOUR_WEIGHT = 2.0  # How much less a fresh network weighs a sphere where colours differ by one
RANDOM_INIT_SCALE = 0.1  # Factor on the random weights beside the colour sweep, so that they do not drown it
RGB_CHANNELS = 3  # Of a panorama or a rendering


@dataclass(frozen=True)
class PaperConfig(NetworkConfig):
    """The network's sizes; those of the paper unless changed."""

    name: str  # of the variant
    size: tuple[int, int]  # ``(height, width)`` it is trained and exported at; multiples of 32
    # channels of the features' encoder; the last is the bottleneck. Features have as many as the second.
    widths: tuple[int, ...] = (16, 32, 64, 128, 256, 512)
    volume_widths: tuple[int, ...] = (64, 128, 256, 512)  # the same for the 3-D UNet
    levels: int = 64  # spheres of the volume, a multiple of 8
    nearest_sphere: float = 2.0  # its inverse depth × baseline; the farthest is at infinity

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return max(int(2 ** (len(self.widths) - 1)), FEATURE_STRIDE * int(2 ** (len(self.volume_widths) - 1)))

    @property
    def max_sqrt_inv_depth(self) -> float:
        """√(inverse depth × baseline) of the nearest prediction."""
        return float(MAX_INVERSE_DEPTH**0.5)


# The network by name: with square pixels, with the authors' square images, and with a quarter of the channels.
PAPER_VARIANTS = {
    "paper": PaperConfig("paper", (256, 512)),
    "paper-square": PaperConfig("paper-square", (256, 256)),
    "paper-narrow": PaperConfig("paper-narrow", (256, 512), (4, 8, 16, 32, 64, 128), (16, 32, 64, 128)),
}


@dataclass(frozen=True)
class PaperPrediction(DepthPrediction):
    """The prediction for the first panorama."""

    low: Tensor  # ``(batch, 1, height, width)`` inverse depth × baseline of the low head, enlarged to the image's size
    high: Tensor  # ``(batch, 1, height, width)`` of the high head. Slightly negative values mean "infinitely far".

    def inverse_depth(self) -> Float[Tensor, "batch 1 height width"]:
        """Inverse depth · baseline of the high head, bounded, never negative."""
        return self.high.clamp(0.0, MAX_INVERSE_DEPTH)

    def confidence(self) -> Float[Tensor, "batch 1 height width"]:
        """How well both heads agree, in (0, 1]; the paper's network has no confidence of its own."""
        high, low = self.inverse_depth(), self.low.clamp(0.0, MAX_INVERSE_DEPTH)
        apart = high - low  # first, as the nodes of exported files are numbered
        scale = torch.maximum(high, low).clamp(min=MIN_RELATIVE_INVERSE_DEPTH)
        return 1.0 / (1.0 + (apart / (HALF_CONFIDENCE_DIFFERENCE * scale)).square())


def sphere_inverse_depths(config: PaperConfig) -> Float[np.ndarray, " levels"]:
    """Inverse depth · baseline of the spheres, in even steps from infinity to the nearest."""
    return np.asarray(np.linspace(0.0, config.nearest_sphere, config.levels))


def sweep_grid(
    inverse_depths: Float[Tensor, " levels"], size: tuple[int, int]
) -> Float[Tensor, "levels height width 2"]:
    """Where the second camera, one baseline ahead, sees points of spheres, for ``grid_sample`` with aligned corners.

    Coordinates are those of features of a size, with a column more at each side and a row more at each pole, so that no
    sample falls into a gap. An exported network keeps these steps where the inverse depths depend on what it is shown.
    """
    height, width = size
    zero = 0.0 * inverse_depths[0]
    polar = (torch.arange(height, device=zero.device) + 0.5 + zero)[:, None] * (math.pi / height)
    azimuth = (torch.arange(width, device=zero.device) + 0.5 + zero) * (2.0 * math.pi / width) - math.pi
    right, up = polar.sin() * azimuth.sin(), polar.cos()
    ahead = polar.sin() * azimuth.cos() - inverse_depths[:, None, None]
    row = torch.atan2((right.square() + ahead.square()).sqrt(), up) * (height / math.pi) - 0.5
    col = (torch.atan2(right.expand_as(ahead), ahead) / (2.0 * math.pi) + 0.5) * width - 0.5
    return torch.stack([2.0 * (col + 1.0) / (width + 1.0) - 1.0, 2.0 * (row + 1.0) / (height + 1.0) - 1.0], dim=-1)


def sweep_volume(
    first: Float[Tensor, "batch channels height width"], second: Float[Tensor, "batch channels height width"],
    grid: Float[Tensor, "levels height width 2"],
) -> Float[Tensor, "batch channels levels height width"]:  # fmt: skip
    """Absolute difference of the first panorama's features and the second's on each sphere, single precision."""
    batch, channels, height, width = sizes(first)
    levels = sizes(grid)[0]
    flat = grid.to(first.device).reshape(1, levels * height, width, 2).expand(batch, -1, -1, -1)
    swept = functional.grid_sample(_pad_sphere(second.float()), flat, padding_mode="border", align_corners=True)
    return (swept.view(batch, channels, levels, height, width) - first.float().unsqueeze(2)).abs()


def _pad_sphere(features: Tensor) -> Tensor:
    """A column more at each side, from over the seam, and a row more at each pole, from over the pole."""
    half = sizes(features)[-1] // 2
    opposite = torch.cat([features[..., half:], features[..., :half]], dim=-1)
    return wrap_columns(torch.cat([opposite[..., :1, :], features, opposite[..., -1:, :]], dim=-2), 1, 1)


class PaperNetwork(Network):
    """Two panoramas, colours in [0, 1], in, the first one's ``inverse depth × baseline`` out; see the module."""

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config
        features = config.widths[1]
        self.features = UNet(3, config.widths, finest=FEATURE_STRIDE.bit_length() - 1)
        self.volume = UNet(features, config.volume_widths, finest=0, volumetric=True)
        self.low_head = nn.Conv2d(config.levels, 1, 1)
        self.high_head = nn.Sequential(
            Block(config.levels + features, features, enlarge=True),
            Block(features, config.widths[0], enlarge=True),
            Block(config.widths[0], 1, leak=1.0),
        )
        self._init_as_colour_sweep()

    @property
    def ports(self) -> Ports:
        """Both panoramas at the configured size, as the sweep is a constant; folded, it would be written out twice."""
        return Ports({"first": 3, "second": 3}, size=self.config.size, notes={"frame": "forward"}, is_folded=False)

    @torch.no_grad()
    def _init_as_colour_sweep(self) -> None:
        """Random weights among which is a sweep of colours: spheres count the more the better they match.

        Random features say where a pixel is (the row) and little about what it shows, so that no sphere matches better
        than another; then rows are all that is learned for long. And the volume's last block has one channel: where
        its LeakyReLU happens to begin below zero nothing comes through.
        """
        initialise(self, gain=1.0)
        features, volume = self.features, self.volume
        for block in features.blocks:
            block.first.weight[:, -1] = 0.0  # of the row
        for block in features.blocks[: features.finest + 1]:
            block.init_identity(RGB_CHANNELS, 0)
        features.blocks[-1].init_identity(RGB_CHANNELS, self.config.widths[features.finest])
        first, last = volume.blocks[0], volume.blocks[-1]
        first.init_identity(1, 0)
        first.first.weight[0, :RGB_CHANNELS, 1] = 1.0 / (9 * RGB_CHANNELS)
        nn.init.dirac_(last.second.weight)
        nn.init.constant_(last.first.bias, INITIAL_INVERSE_DEPTH)
        last.first.weight.mul_(RANDOM_INIT_SCALE)
        last.first.weight[0, self.config.volume_widths[0], 1, 1, 1] = -INITIAL_COLOUR_WEIGHT
        spheres = torch.from_numpy(sphere_inverse_depths(self.config)).to(self.low_head.weight.dtype)
        self.low_head.weight.copy_((spheres / len(spheres)).view(1, -1, 1, 1))

    def forward(
        self, first: Float[Tensor, "batch 3 height width"], second: Float[Tensor, "batch 3 height width"]
    ) -> PaperPrediction:
        """Estimate; ValueError for a size that is no multiple of ``config.size_multiple``."""
        check_multiple(first, self.config.size_multiple)
        height, width = sizes(first)[-2:]
        of_first, of_second = self.features(torch.cat([first, second])).chunk(2)
        inverse_depths = torch.from_numpy(sphere_inverse_depths(self.config)).to(first) + 0.0 * first[0, 0, 0, 0]
        grid = sweep_grid(inverse_depths, (height // FEATURE_STRIDE, width // FEATURE_STRIDE))
        spheres = self.volume(sweep_volume(of_first, of_second, grid)).squeeze(1)  # (batch, levels, height/4, width/4)
        low = upsample_linear(self.low_head(spheres), FEATURE_STRIDE)
        high = self.high_head(torch.cat([spheres, of_first.to(spheres.dtype)], dim=1))
        return PaperPrediction(low.float(), high.float())
