"""Depth of a panorama from a pair: a pretrained encoder, a cost volume, and what matching measured, if anything.

Both panoramas are upright, turned so that the other camera is ahead (−z, up to the slope of the baseline);
``docs/learned-depth.md`` says what becomes of them.

Source: Sayed et al., SimpleRecon, 2022 (cost volume in 2-D); Guo et al., 2019 (group-wise correlation); Teed and Deng,
RAFT, 2020 (convex upsampling); Kendall and Gal, 2017 (Laplace scale).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.geometry.sphere import pixel_to_direction
from omnisyn_cli.networks.efficientnet import CHANNELS, EfficientNetLite0
from omnisyn_cli.networks.interface import DepthPrediction, Network, NetworkConfig, Ports, check_multiple
from omnisyn_cli.networks.layers import LEAK, WrappedConv, at_least_single, sizes, wrap_columns
from omnisyn_cli.networks.paper import upsample_linear

SPHERES_AT_ONCE = 3  # Those that features are gathered for: their maps fit the cache of a processor
# Columns and rows by which centres of quarter-size features are off: see ``STRIDE_CENTRE_OFFSETS``.
FEATURE_SHIFT = -0.125
LOG_SCALES = (-6.0, 2.0)  # Bounds of the log of the Laplace scale
CONFIDENCE_TOLERANCE = 1.1**0.5 - 1.0  # Relative error of √(inverse depth) where depth is 10 % off
# Channels: direction (3), cosine to the other camera, slope of the baseline, best cost, expected √(inverse depth).
GEOMETRY_CHANNEL_COUNT = 7
SHARPNESS = 8.0  # Factor on correlations before the softmax that the expected √(inverse depth) is weighted by


@dataclass(frozen=True)
class GuidedDepthConfig(NetworkConfig):
    """What makes one network differ from another."""

    name: str  # of the variant
    size: tuple[int, int] = (256, 512)  # ``(height, width)`` of the exported file
    spheres: int = 48  # of the cost volume
    max_sqrt_inv_depth: float = 2.0  # of the nearest sphere
    features: int = 24  # channels that are correlated, a multiple of ``groups``
    groups: int = 4  # of features, each correlated for itself
    widths: tuple[int, ...] = (24, 64, 88, 120, 144)  # channels of the U-net at strides 2, 4, 8, 16 and 32

    size_multiple = 32  # of heights and widths


GUIDED_DEPTH_VARIANTS = {"lite0": GuidedDepthConfig("lite0")}  # The networks by name


@dataclass(frozen=True)
class GuidedDepthPrediction(DepthPrediction):
    """The estimate, how sure it is, and the estimates on the way."""

    estimate: Tensor  # ``(batch, 1, height, width)`` √(inverse depth × baseline); below zero where nothing is there
    log_scale: Tensor  # ``(batch, 1, height, width)`` of the Laplace distribution of its error
    coarse: tuple[Tensor, ...]  # ``(batch, 1, height / s, width / s)`` the estimates at strides s = 4 and 2

    def sqrt_inv_depth(self) -> Float[Tensor, "batch 1 height width"]:
        """The estimate."""
        return self.estimate

    def confidence(self) -> Float[Tensor, "batch 1 height width"]:
        """Probability that depth is within 10 %, by the Laplace distribution."""
        return 1.0 - torch.exp(-CONFIDENCE_TOLERANCE * self.estimate.clamp(min=0.0) * torch.exp(-self.log_scale))


class NormalisedConv(nn.Module):
    """A convolution over the seam, group normalisation, LeakyReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3) -> None:
        super().__init__()
        self.conv = WrappedConv(inputs, outputs) if kernel > 1 else nn.Conv2d(inputs, outputs, 1)
        self.norm = nn.GroupNorm(8, outputs)

    def forward(self, x: Float[Tensor, "batch inputs height width"]) -> Tensor:
        """``(batch, outputs, height, width)``."""
        return functional.leaky_relu(self.norm(self.conv(x)), LEAK)


class NormalisedBlock(nn.Module):
    """Two convolutions that are added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first, self.second = NormalisedConv(channels, channels), NormalisedConv(channels, channels)

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Tensor:
        """The same size."""
        y: Tensor = x + self.second(self.first(x))
        return y


def feature_directions(size: tuple[int, int], shift: float, like: Tensor) -> Float[Tensor, "height width 3"]:
    """Unit vectors through the centres of a map, moved by ``shift`` rows and columns."""
    height, width = size
    row, col = (torch.arange(n, dtype=torch.float32, device=like.device) + shift for n in (height, width))
    directions: Tensor = pixel_to_direction(row[:, None], col[None, :], (height, width))
    return directions


def sweep_grid(
    directions: Float[Tensor, "height width 3"], towards: Float[Tensor, "batch 3"],
    sqrt_inv_depths: Float[Tensor, " spheres"],
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Where the other camera sees points of spheres: azimuth / π and polar angle / π · 2 − 1, in [−1, 1]."""
    moved = directions - sqrt_inv_depths.square()[:, None, None, None] * towards[:, None, None, None, :]
    x, y, z = moved.unbind(-1)
    azimuth = torch.atan2(x, -z)
    polar_angle = torch.atan2(torch.sqrt(x * x + z * z + 1e-12), y)
    return azimuth / torch.pi, polar_angle * (2.0 / torch.pi) - 1.0


def correlate(
    first: Float[Tensor, "batch groups features height width"],
    second: Float[Tensor, "batch groups features height width"],
    azimuth: Float[Tensor, "batch spheres height width"], polar: Float[Tensor, "batch spheres height width"],
) -> Float[Tensor, "batch groups spheres height width"]:  # fmt: skip
    """Products of the features of one camera with those of the other one, where :func:`sweep_grid` says."""
    batch, groups, features, height, width = sizes(first)
    spheres = sizes(azimuth)[1]
    # one column more on both sides carries the seam; rows end at the poles
    x = (azimuth - FEATURE_SHIFT * 2.0 / width) * (width / (width + 2.0))
    y = polar - FEATURE_SHIFT * 2.0 / height
    grid = torch.stack([x, y], dim=-1).view(batch, spheres * height, width, 2)
    wide = wrap_columns(second.reshape(batch, groups * features, height, width), 1, 1)
    warped = functional.grid_sample(wide, grid.to(wide.dtype), padding_mode="border", align_corners=False)
    return (first.unsqueeze(3) * warped.view(batch, groups, features, spheres, height, width)).sum(dim=2)


def correlate_gathered(
    first: Float[Tensor, "1 groups features height width"], second: Float[Tensor, "1 groups features height width"],
    azimuth: Float[Tensor, "1 spheres height width"], polar: Float[Tensor, "1 spheres height width"],
) -> Float[Tensor, "1 groups spheres height width"]:  # fmt: skip
    """The same for the exported file: ONNX Runtime, which samples grids value by value, takes a quarter of the time.

    All features of a place are gathered at once, for a few spheres. Their products are interpolated, not the features.
    """
    _, groups, features, height, width = sizes(first)
    x = ((azimuth + 1.0) * (width / 2.0) - 0.5 - FEATURE_SHIFT).flatten()
    y = ((polar + 1.0) * (height / 2.0) - 0.5 - FEATURE_SHIFT).clamp(0.0, height - 1.0).flatten()
    left, above = x.floor(), y.floor()
    right, below = x - left, y - above
    shares = torch.stack([(1.0 - below) * (1.0 - right), (1.0 - below) * right, below * (1.0 - right), below * right])
    wide = wrap_columns(torch.cat([second, second[..., -1:, :]], dim=-2), 1, 1)
    own, other = (each[0].flatten(2).flatten(0, 1).t() for each in (first, wide))
    neighbours = (above * (width + 2.0) + left + 1.0).long() + torch.tensor([[0], [1], [width + 2], [width + 3]])
    of_group = torch.eye(groups).repeat_interleave(features, dim=0)
    count, costs = SPHERES_AT_ONCE * height * width, []
    for at, share in zip(torch.split(neighbours, count, 1), torch.split(shares, count, 1), strict=True):
        products = (other[at].view(-1, height * width, groups * features) * own).view(*sizes(at), -1) @ of_group
        costs.append((products.transpose(1, 2) * share.unsqueeze(1)).sum(dim=0))
    return torch.cat(costs, dim=1).view(1, groups, -1, height, width)


class GuidedDepthNetwork(Network):
    """Two panoramas and the direction in, the first's depth out; any multiple of ``config.size_multiple``."""

    def __init__(self, config: GuidedDepthConfig) -> None:
        super().__init__()
        self.config: GuidedDepthConfig = config
        width2, width4, width8, width16, width32 = config.widths
        tap2, tap4, tap8, tap16, tap32 = CHANNELS
        features = config.features
        self.encoder = EfficientNetLite0()
        self.lateral4, self.lateral8, self.lateral16 = (nn.Conv2d(n, features, 1) for n in (tap4, tap8, tap16))
        self.matched = nn.Sequential(NormalisedConv(features, features), nn.Conv2d(features, features, 1))
        self.reduce = nn.Conv2d(config.groups * config.spheres, width4, 1)
        self.in4 = NormalisedConv(width4 + tap4 + features + GEOMETRY_CHANNEL_COUNT, width4)
        self.down4 = NormalisedBlock(width4)
        self.to8, self.in8 = NormalisedConv(width4, width8), NormalisedConv(width8 + tap8, width8, 1)
        self.down8 = NormalisedBlock(width8)
        self.to16, self.in16 = NormalisedConv(width8, width16), NormalisedConv(width16 + tap16, width16, 1)
        self.down16 = NormalisedBlock(width16)
        self.to32, self.in32 = NormalisedConv(width16, width32), NormalisedConv(width32 + tap32, width32, 1)
        self.middle = nn.Sequential(NormalisedBlock(width32), NormalisedBlock(width32))
        self.up16 = NormalisedConv(width32 + width16, width16)
        self.up8, self.refine8 = NormalisedConv(width16 + width8, width8), NormalisedBlock(width8)
        self.up4, self.refine4 = NormalisedConv(width8 + width4, width4), NormalisedBlock(width4)
        self.answer4 = nn.Conv2d(width4, 2, 1)
        self.up2, self.refine2 = NormalisedConv(width4 + tap2, width2), NormalisedConv(width2, width2)
        self.answer2 = nn.Conv2d(width2, 2, 1)
        self.upsampling = nn.Conv2d(width2, 36, 1)
        for layer in (self.answer2, self.upsampling):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
        nn.init.normal_(self.answer4.weight, std=0.01)
        with torch.no_grad():
            self.answer4.bias.copy_(torch.tensor([0.5, -2.0]))  # type: ignore[union-attr]

    @property
    def ports(self) -> Ports:
        """Both panoramas at the configured size, and the direction to the other camera."""
        return Ports(
            {"first": 3, "second": 3, "towards": 3}, size=self.config.size, own_sizes={"towards": (1, 1)},
            notes={"frame": "upright"}, is_folded=False,
        )  # fmt: skip

    def forward(
        self, first: Float[Tensor, "batch 3 height width"], second: Float[Tensor, "batch 3 height width"],
        towards: Float[Tensor, "batch 3 1 1"],
    ) -> GuidedDepthPrediction:  # fmt: skip
        """The depth of ``first``, given the colours of both in [0, 1], held alike.

        ``towards`` leads to the second camera; a longer one reaches nearer surfaces. ValueError: the size is not a
        multiple of ``config.size_multiple``.
        """
        check_multiple(first, self.config.size_multiple)
        batch = sizes(first)[0]
        features = self.encoder(torch.cat([first, second]))
        _, at4, at8, at16, _ = features
        lateral = self.lateral4(at4) + upsample_linear(self.lateral8(at8), 2) + upsample_linear(self.lateral16(at16), 4)
        maps = self.matched(lateral)  # at a quarter of the size, from three strides
        own = [each[:batch] for each in features]
        costs, geometry = self._costs(maps[:batch], maps[batch:], towards.flatten(1))
        return self._decoded(torch.cat([self.reduce(costs), own[1], maps[:batch], geometry], dim=1), own)

    def _costs(
        self, first: Float[Tensor, "batch features rows cols"], second: Float[Tensor, "batch features rows cols"],
        towards: Float[Tensor, "batch 3"],
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        """Correlations ``(batch, groups · spheres, rows, cols)`` and :data:`GEOMETRY_CHANNEL_COUNT` channels."""
        config = self.config
        batch, channels, height, width = sizes(first)
        groups, spheres = config.groups, config.spheres
        ahead = functional.normalize(towards, dim=1)
        sqrt_inv_depths = torch.linspace(0.0, config.max_sqrt_inv_depth, spheres, device=first.device)
        directions = feature_directions((height, width), FEATURE_SHIFT, first)
        azimuth, polar = sweep_grid(directions, at_least_single(towards), sqrt_inv_depths)
        unit_first, unit_second = (
            functional.normalize(m.view(batch, groups, channels // groups, height, width), dim=2, eps=1e-4)
            for m in (first, second)
        )
        in_onnx = torch.onnx.is_in_onnx_export()
        costs = (correlate_gathered if in_onnx else correlate)(unit_first, unit_second, azimuth, polar)
        mean = at_least_single(costs.mean(dim=1))
        expected = (sqrt_inv_depths[:, None, None] * (SHARPNESS * mean).softmax(dim=1)).sum(dim=1, keepdim=True)
        cosine = (directions * ahead[:, None, None, :]).sum(dim=-1).unsqueeze(1)
        plain = directions.permute(2, 0, 1).expand(batch, 3, height, width)
        slope = ahead[:, 1].view(batch, 1, 1, 1).expand(batch, 1, height, width)
        geometry = torch.cat([plain, cosine, slope, mean.amax(dim=1, keepdim=True), expected], dim=1)
        return costs.reshape(batch, groups * spheres, height, width), geometry.to(costs.dtype)

    def _decoded(self, x: Tensor, own: list[Tensor]) -> GuidedDepthPrediction:
        """The U-net."""
        at2, _, at8, at16, at32 = own
        x4 = self.down4(self.in4(x))
        x8 = self.down8(self.in8(torch.cat([self.to8(_halved(x4)), at8], dim=1)))
        x16 = self.down16(self.in16(torch.cat([self.to16(_halved(x8)), at16], dim=1)))
        x32 = self.middle(self.in32(torch.cat([self.to32(_halved(x16)), at32], dim=1)))
        y = self.up16(torch.cat([upsample_linear(x32, 2), x16], dim=1))
        y = self.refine8(self.up8(torch.cat([upsample_linear(y, 2), x8], dim=1)))
        y = self.refine4(self.up4(torch.cat([upsample_linear(y, 2), x4], dim=1)))
        quarter = at_least_single(self.answer4(y))
        z = self.refine2(self.up2(torch.cat([upsample_linear(y, 2), at2], dim=1)))
        half = at_least_single(self.answer2(z)) + upsample_linear(quarter, 2)
        full = convex_upsample(half, at_least_single(self.upsampling(z)))
        most = self.config.max_sqrt_inv_depth
        return GuidedDepthPrediction(
            full[:, :1].clamp(max=most), full[:, 1:].clamp(*LOG_SCALES), (quarter[:, :1], half[:, :1])
        )


def convex_upsample(
    x: Float[Tensor, "batch channels height width"], logits: Float[Tensor, "batch 36 height width"]
) -> Float[Tensor, "batch channels 2*height 2*width"]:
    """Fine pixels are means of 3×3 coarse ones by 9 logits each, neighbour first (RAFT, section 3.3): sharp edges."""
    batch, channels, height, width = sizes(x)
    padded = wrap_columns(torch.cat([x[..., :1, :], x, x[..., -1:, :]], dim=-2), 1, 1)
    shifts = [padded[..., i : i + height, j : j + width] for i in range(3) for j in range(3)]
    weights = logits.view(batch, 1, 9, 4, height, width).softmax(dim=2)
    fine = (weights * torch.stack(shifts, dim=2).unsqueeze(3)).sum(dim=2)  # (batch, channels, 4, height, width)
    return functional.pixel_shuffle(fine.reshape(batch, channels * 4, height, width), 2)


def _halved(x: Tensor) -> Tensor:
    return functional.avg_pool2d(x, 2)
