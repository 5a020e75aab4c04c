"""Stereo depth from two panoramas in the epipole frame: coarse by sphere sweep, then refined twice by looking again.

Both panoramas come in the frame of :func:`omnisyn_cli.geometry.sweep.epipole_frame`: row 0 points at the other camera,
so matches lie in the same column and the network needs no pose. What it predicts is the *root*, the square root of
``inverse_depth · baseline``: dimensionless, even steps of it are nearly even steps of parallax.

1. Features of both images; every row of a meridian of the first against every row of the same meridian of the second:
   one small matrix product. A constant matrix turns pairs of rows into spheres
   (:mod:`omnisyn_cli.networks.sphere_volume`).
2. Aggregation over the sphere together with features of the first image alone (the monocular skip): a distribution
   over spheres, whose mean is the coarse root.
3. At twice and four times the resolution: look the same product up around the estimate, choose among nearby roots.
4. Convex upsampling to the image's own size, guided by the image: edges stay sharp.

Classical similarity (normalised patches) goes the same way as learned features; it makes learning several times faster.

Source: OmniSyn, sections 3.1 to 3.4, for the sphere sweep, CoordConv and the monocular skip; RAFT for lookup and
upsampling.
"""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks import layers
from omnisyn_cli.networks.depth_config import DepthConfig, level_roots
from omnisyn_cli.networks.interface import DepthAnswer, PairNetwork
from omnisyn_cli.networks.sphere_volume import lookup, meridian_products, resampling_matrix, sphere_volume

__all__ = ["DepthNetwork", "DepthPrediction"]

CLASSICAL_SCALES = 2
"""Normalised patches are compared at this many image scales in the coarse volume."""

CLASSICAL_PATCH = 8
"""Side of those patches, in pixels of the scaled image."""

REFINED_PATCH = 6
"""Side of the patches compared in a refinement; they are two pixels of the scaled image apart."""


@dataclass(frozen=True)
class DepthPrediction(DepthAnswer):
    """What the network says about the first panorama.

    Attributes:
        roots: estimates from coarse to fine, each ``(batch, 1, height, width)``, twice as fine as the one before; the
            last has the size of the image.
        confidence_logit: ``(batch, 1, height, width)``; its sigmoid is the probability that the depth is within 10 %.
    """

    roots: tuple[Tensor, ...]
    confidence_logit: Tensor

    def root(self) -> Float[Tensor, "batch 1 height width"]:
        """The last estimate."""
        return self.roots[-1]


@lru_cache(maxsize=8)
def _resampling_tensor(config: DepthConfig, rows_first: int, rows_second: int) -> Tensor:
    return torch.from_numpy(resampling_matrix(level_roots(config), rows_first, rows_second))


class DepthNetwork(PairNetwork):
    """Two panoramas in, the root of the first one's ``inverse depth × baseline`` out; see the module's docstring."""

    frame = "epipole"

    def __init__(self, config: DepthConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config)
        self.coarse = CoarseMatcher(config)
        strides = [config.coarse_stride >> (i + 1) for i in range(len(config.refined_widths))]
        self.refinements = nn.ModuleList(Refinement(config, index, stride) for index, stride in enumerate(strides))
        layers.initialise(self)
        layers.begin_small(self.coarse.logits, self.coarse.upsample, std=0.02)  # even shares, even upsampling
        for stage in self.refinements:
            layers.begin_small(stage.choice, stage.upsample, stage.confidence)  # the estimate stays as it is

    def forward(
        self, first: Float[Tensor, "batch 3 height width"], second: Float[Tensor, "batch 3 height width"]
    ) -> DepthPrediction:
        """Estimate; ValueError for a size that is not 1:2 or no multiple of ``config.size_multiple``."""
        height, width = layers.sizes(first)[-2:]
        multiple = self.config.size_multiple
        if height % multiple or width != 2 * height:
            raise ValueError(f"expected images 1:2 with multiples of {multiple} rows, got {height}×{width}")
        both = self.encoder(torch.cat([first, second]))
        of_first, of_second = zip(*(features.chunk(2) for features in both), strict=True)
        root, hidden = self.coarse(first, second, of_first, of_second)
        roots = [root]
        confidence: Tensor = root
        for stage in self.refinements:
            root, hidden, confidence = stage(first, second, of_first, of_second, root, hidden)
            roots.append(root)
        return DepthPrediction(tuple(roots), confidence)


class Encoder(nn.Module):
    """Features of one panorama at strides 2, 4, …, half the coarse stride; the last with columns halved once more."""

    def __init__(self, config: DepthConfig) -> None:
        super().__init__()
        count = config.coarse_stride.bit_length() - 2  # strides 2 … coarse_stride / 2
        widths = config.widths
        self.stem = layers.ResidualBlock(3 * 4 + 2, widths[0])
        self.down = nn.ModuleList(layers.ResidualBlock(widths[i], widths[i + 1], (2, 2)) for i in range(count - 1))
        self.narrow = layers.ResidualBlock(widths[count - 1], widths[count], (1, 2))

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> list[Tensor]:
        """``[stride 2, stride 4, …, narrow]``; ``narrow`` has twice as many rows as the sphere volume."""
        x = functional.pixel_unshuffle(image - 0.5, 2)
        features = [self.stem(torch.cat([x, layers.coordinate_channels(x)], dim=1))]
        for block in self.down:
            features.append(block(features[-1]))
        return [*features, self.narrow(features[-1])]


class CoarseMatcher(nn.Module):
    """The sphere volume and its aggregation with features of the first panorama: a distribution over spheres."""

    def __init__(self, config: DepthConfig) -> None:
        super().__init__()
        self.config = config
        count = config.coarse_stride.bit_length() - 2
        width, hidden = config.widths[count], config.hidden
        self.rows = layers.ResidualBlock(width, width, (2, 1))
        self.match_first = nn.Conv2d(width, config.match_channels, 1)
        self.match_second = nn.Conv2d(width, config.match_channels, 1)
        similarities = config.match_groups + CLASSICAL_SCALES
        self.filters = VolumeFilters(similarities, config.volume_filters) if config.volume_filters else nn.Identity()
        self.spheres = nn.Conv2d(config.levels * (config.volume_filters or similarities), hidden, 1)
        deeper = config.widths[count + 1 :]
        self.context_down = nn.ModuleList(
            layers.ResidualBlock(a, b, (2, 2)) for a, b in zip((width, *deeper[:-1]), deeper, strict=True)
        )
        self.context_up = nn.ModuleList(nn.Conv2d(channels, hidden, 1) for channels in (width, *deeper))
        self.enter = layers.ResidualBlock(hidden + 2, hidden)
        self.down = nn.ModuleList(layers.ResidualBlock(hidden, hidden, (2, 2)) for _ in range(3))
        self.up = nn.ModuleList(layers.ResidualBlock(hidden, hidden) for _ in range(3))
        self.logits = nn.Conv2d(hidden, config.levels, 1)
        self.upsample = nn.Conv2d(hidden, 36, 1)

    def forward(
        self, first: Tensor, second: Tensor, of_first: tuple[Tensor, ...], of_second: tuple[Tensor, ...]
    ) -> tuple[Tensor, Tensor]:
        """The root at half the coarse stride, and the hidden state at the coarse stride."""
        narrow = self.rows(of_first[-1])
        volume = self.volume(first, second, narrow, of_second[-1])
        x = functional.leaky_relu(self.spheres(volume) + self.context(narrow), layers.LEAK)
        x = self.aggregate(self.enter(torch.cat([x, layers.coordinate_channels(x)], dim=1)))
        logits = layers.at_least_single(self.logits(x))
        roots = torch.from_numpy(level_roots(self.config)).to(logits).view(1, -1, 1, 1)
        root = (logits.softmax(dim=1) * roots).sum(dim=1, keepdim=True)
        return layers.convex_upsample(root, layers.at_least_single(self.upsample(x))), x

    def volume(self, first: Tensor, second: Tensor, narrow: Tensor, of_second: Tensor) -> Tensor:
        """Similarity of the first image to each sphere, ``(batch, levels·kinds, height, width)``."""
        groups = self.config.match_groups
        learned = meridian_products(
            layers.unit_groups(self.match_first(narrow), groups),
            layers.unit_groups(self.match_second(of_second), groups),
        )
        with torch.autocast(first.device.type, enabled=False):
            classical = classical_products(first, second, self.config.coarse_stride)
        products = torch.cat([learned, classical], dim=1)
        matrix = _resampling_tensor(self.config, *layers.sizes(products)[-2:]).to(products)
        return torch.flatten(self.filters(sphere_volume(products, matrix)), 1, 2)

    def context(self, narrow: Tensor) -> Tensor:
        """What the first panorama alone says, with all of the sphere in view (the monocular skip)."""
        features = [narrow]
        for block in self.context_down:
            features.append(block(features[-1]))
        x: Tensor = self.context_up[-1](features[-1])
        for project, skip in zip(reversed(self.context_up[:-1]), reversed(features[:-1]), strict=True):
            x = functional.leaky_relu(layers.upsample_nearest(x) + project(skip), layers.LEAK)
        return x

    def aggregate(self, x: Tensor) -> Tensor:
        """A small UNet at the resolution of the volume."""
        skips = []
        for block in self.down:
            skips.append(x)
            x = block(x)
        for block, skip in zip(self.up, reversed(skips), strict=True):
            x = block(layers.upsample_nearest(x) + skip)
        return x


class VolumeFilters(nn.Module):
    """Residual 3-D filters over spheres, rows and columns; the columns wrap."""

    def __init__(self, inputs: int, channels: int) -> None:
        super().__init__()
        self.enter = nn.Conv3d(inputs, channels, 1)
        self.layers = nn.ModuleList(nn.Conv3d(channels, channels, 3, padding=(1, 1, 0)) for _ in range(4))

    def forward(self, volume: Float[Tensor, "batch kinds levels height width"]) -> Tensor:
        """``(batch, channels, levels, height, width)``."""
        x: Tensor = self.enter(volume)
        for i in range(0, len(self.layers), 2):
            inner = functional.leaky_relu(self.layers[i](layers.wrap_columns(x, 1, 1)), layers.LEAK)
            x = functional.leaky_relu(self.layers[i + 1](layers.wrap_columns(inner, 1, 1)) + x, layers.LEAK)
        return x


def shrunk(image: Tensor, factor: int) -> Tensor:
    """Means over blocks of ``factor × factor`` pixels."""
    return functional.avg_pool2d(image, factor) if factor > 1 else image


@torch.no_grad()
def classical_products(first: Tensor, second: Tensor, coarse_stride: int) -> Tensor:
    """Products of normalised patches at two scales, rows and columns as in the sphere volume."""
    products = []
    for scale in range(CLASSICAL_SCALES):
        shrink = coarse_stride // 4 << scale
        stride = coarse_stride // shrink
        small_first, small_second = (shrunk(image, shrink) for image in (first, second))
        patches = layers.normalised_patches(small_first, CLASSICAL_PATCH, (stride, stride)).unsqueeze(1)
        others = layers.normalised_patches(small_second, CLASSICAL_PATCH, (stride // 2, stride)).unsqueeze(1)
        products.append(meridian_products(patches, others))
    return torch.cat(products, dim=1)


class Refinement(nn.Module):
    """Looks at similarities around an estimate, at the estimate's own resolution, and chooses among nearby roots."""

    def __init__(self, config: DepthConfig, index: int, stride: int) -> None:
        super().__init__()
        self.index, self.stride, self.reach = index, stride, config.reach
        self.step = config.greatest_root / (config.levels - 2) * 0.7 / 2**index
        self.features = stride.bit_length() - 2  # stride 2 is the encoder's first entry
        channels, width = config.widths[self.features], config.refined_widths[index]
        before = config.refined_widths[index - 1] if index else config.hidden
        self.match_first = nn.Conv2d(channels, width, 1)
        self.match_second = nn.Conv2d(channels, width, 1)
        candidates = 2 * self.reach + 1
        self.from_hidden = nn.Conv2d(before, width, 1)
        self.from_features = nn.Conv2d(channels, width, 1)
        self.from_similarity = nn.Conv2d(2 * candidates + 1, width, 1)
        self.enter = layers.ResidualBlock(width + 2, width)
        self.mix = layers.ResidualBlock(width, width)
        self.choice = layers.WrappedConv(width, candidates)
        self.upsample = layers.WrappedConv(width, 36)
        self.confidence = layers.WrappedConv(width, 1)

    def forward(
        self,
        first: Tensor,
        second: Tensor,
        of_first: tuple[Tensor, ...],
        of_second: tuple[Tensor, ...],
        root: Float[Tensor, "batch 1 height width"],
        hidden: Float[Tensor, "batch before height//2 width//2"],
    ) -> tuple[Tensor, Tensor, Tensor]:
        """``(root at twice the resolution, hidden state, confidence logit at twice the resolution)``."""
        own, other = of_first[self.features], of_second[self.features]
        offsets = self.step * torch.arange(-self.reach, self.reach + 1, dtype=root.dtype, device=root.device)
        offsets = offsets.view(1, -1, 1, 1)
        candidates = root.detach() + offsets
        learned = lookup(self.products(own, other), candidates).squeeze(1)
        with torch.autocast(first.device.type, enabled=False):
            classical = lookup(self.classical(first, second), candidates).squeeze(1)
        x = self.from_similarity(torch.cat([learned, classical, root.detach()], dim=1)) + self.from_features(own)
        x = functional.leaky_relu(x + layers.upsample_nearest(self.from_hidden(hidden)), layers.LEAK)
        x = self.mix(self.enter(torch.cat([x, layers.coordinate_channels(x)], dim=1)))
        choice = layers.at_least_single(self.choice(x)).softmax(dim=1)
        refined = root + (choice * offsets).sum(dim=1, keepdim=True)
        both = torch.cat([refined, self.confidence(x).to(refined.dtype)], dim=1)
        upsample = layers.at_least_single(self.upsample(x))
        fine_root, fine_confidence = layers.convex_upsample(both, upsample).chunk(2, dim=1)
        return fine_root, x, fine_confidence

    def products(self, own: Tensor, other: Tensor) -> Tensor:
        """Learned similarities of all rows of each meridian."""
        return meridian_products(
            layers.unit_groups(self.match_first(own), 1), layers.unit_groups(self.match_second(other), 1)
        )

    @torch.no_grad()
    def classical(self, first: Tensor, second: Tensor) -> Tensor:
        """Classical similarity of all rows of each meridian."""
        images = (shrunk(image, self.stride // 2) for image in (first, second))
        own, other = (layers.normalised_patches(image, REFINED_PATCH, (2, 2)).unsqueeze(1) for image in images)
        return meridian_products(own, other)
