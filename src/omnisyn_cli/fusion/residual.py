"""Residual fusion: the geometric fusion, corrected by a network where the layers contradict each other or see nothing.

The network sees both layers at a small size of its own. For each pixel it returns blend weights of colours that both
photographs show at other depths (:mod:`omnisyn_cli.fusion.warp_candidates`), which are sampled at the size of the
frame. Suppressed ghosts stay as the rules made them, and the correction fades towards both ends of the way.

Source: OmniSyn, section 3.5, with blend weights of photographs in place of colours.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.geometric import Confidence, GeometricFuser, Picture
from omnisyn_cli.fusion.ghosts import GhostSuppression, have_same_position
from omnisyn_cli.fusion.input_channels import fusion_input_channels, needs_no_network
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.fusion.warp_candidates import CANDIDATE_SCALE, WarpCandidates, make_warp_candidates
from omnisyn_cli.fusion.window_filters import dilate
from omnisyn_cli.geometry.sampling import max_pool
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, Layer, SourceSampler

SIZE_MULTIPLE = 32  # of the network's input: it halves its input five times
MIN_CORRECTION_STRENGTH = 1e-6  # below it the correction could change no colour, so the network is not run
TILE_COARSE_ROWS = 4  # rows of the smaller size that are averaged together. Set by hand.
# Rows and columns of a large block that are read: 16 pixels are enough for its mean. Set by hand.
SAMPLES_PER_BLOCK_SIDE = 4


# Channels, candidates, and how much of the network's weights is taken, in [0, 1].
Correction = tuple[Float32[np.ndarray, "channels height width"], WarpCandidates, Float32[np.ndarray, "height width"]]
# Takes the channels of :class:`InputBuilder` to blend weights ``(4, height, width)`` of the warp candidates.
ResidualFusionNetwork = Callable[[np.ndarray], np.ndarray]


def network_size(
    size: tuple[int, int], rows: int, multiple: int = SIZE_MULTIPLE, scale: int = CANDIDATE_SCALE
) -> tuple[int, int] | None:
    """For frames of ``size``: at most ``rows`` or their ``scale``-th part, of a ``multiple``; None if too small."""
    height = min(rows, size[0] // scale, size[1] // (2 * scale)) // multiple * multiple
    return (height, 2 * height) if height else None


class ResidualFuser(GeometricFuser):
    """A :class:`omnisyn_cli.types.Fuser`: geometric, then corrected by a network at ``rows`` (trained on 128)."""

    def __init__(
        self, size: tuple[int, int], network: ResidualFusionNetwork, rows: int, threads: int | None = None, *,
        edges: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(size, threads, edges=edges)
        self.network, self._rows = network, rows
        small = network_size(size, rows)
        tiles = LayerPairShader(self.ghosts.downsampled_size, threads)
        self._inputs = None if small is None else InputBuilder(small, tiles)

    def twin(self, threads: int) -> "ResidualFuser":
        """See :meth:`GeometricFuser.twin`; both ask the same network."""
        return ResidualFuser(self.size, self.network, self._rows, threads, edges=self.supersamples)

    def __call__(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None, confidence: Confidence | None = None
    ) -> Picture:
        """See :class:`omnisyn_cli.types.Fuser`; InputError: the network does not take channels or answers otherwise."""
        rule = BlendRule.at(t)
        if not self.is_corrected(rule) or have_same_position(first, second):
            return super().__call__(first, second, t, out, confidence)
        if self.ghosts.is_full_resolution:
            first, second = self.tiles.with_cached_colours(first, second)
        small_first, small_second = self.ghosts.downsample(first), self.ghosts.downsample(second)
        suppression, out = self.ghosts.detect(small_first, small_second, rule), self._output_buffer(out)
        self.blend(self._with_confidence(first, second, confidence).with_step(suppression), rule, out)
        inputs = self.inputs((small_first, small_second), suppression, rule, source_samplers(first, second))
        if inputs is not None:
            self.correct(*inputs, out)
        return out

    def is_corrected(self, rule: BlendRule) -> bool:
        """Whether the network changes pictures there."""
        return self._inputs is not None and rule.occlusion_strength >= MIN_CORRECTION_STRENGTH

    def inputs(
        self, small: tuple[Layer, Layer], suppression: GhostSuppression | None, rule: BlendRule,
        source_samplers: tuple[SourceSampler, SourceSampler],
    ) -> Correction | None:  # fmt: skip
        """Channels, candidates and strength of the correction, given both layers downsampled; None if none is needed.

        ValueError: it changes nothing there, see :meth:`is_corrected`.
        """
        if self._inputs is None:
            raise ValueError(
                "expected frames that are large enough for the network, got others; ask is_corrected first"
            )
        step = None if suppression is None else replace(suppression, cell_size=self.ghosts.samples_per_side)
        channels, candidates = self._inputs(LayerPair(*small).with_step(step), rule, source_samplers)
        if needs_no_network(channels):
            return None
        strength = np.full(channels.shape[1:], rule.occlusion_strength, np.float32)
        if suppression is not None:
            ghosts = max_pool(np.abs(suppression.signed_strength), strength.shape)
            strength *= 1.0 - dilate(ghosts, 1)  # and around there: nothing to choose
        return channels, candidates, strength

    def correct(
        self, channels: Float32[np.ndarray, "channels height width"], candidates: WarpCandidates,
        strength: Float32[np.ndarray, "height width"], picture: Picture,
    ) -> None:  # fmt: skip
        """Mix candidates into the picture of geometric fusion by the network's weights times ``strength`` in [0, 1]."""
        candidates.mix_in(strength * self.network(channels), picture, self.threads)


def source_samplers(first: Layer, second: Layer) -> tuple[SourceSampler, SourceSampler]:
    """Those of both layers."""
    if first.source_sampler is None or second.source_sampler is None:
        raise ValueError("expected layers with a source sampler, got others; use the geometric fusion")
    return first.source_sampler, second.source_sampler


class InputBuilder:
    """Makes channels of a size from layers :data:`CANDIDATE_SCALE` times that or larger. Not shared between threads."""

    def __init__(self, size: tuple[int, int], tiles: LayerPairShader) -> None:
        self.size, self._tiles = size, tiles
        self._filler = HoleFiller(size, tiles.threads)

    def __call__(
        self, layers: LayerPair, rule: BlendRule, source_samplers: tuple[SourceSampler, SourceSampler]
    ) -> tuple[Float32[np.ndarray, "channels height width"], WarpCandidates]:
        """The channels of both parts, and the candidates that the network chooses from."""
        fine = downsampled_pair(layers, (CANDIDATE_SCALE * self.size[0], CANDIDATE_SCALE * self.size[1]), self._tiles)
        first, second = (_halve(layer) for layer in fine)
        baseline = float(np.linalg.norm(first.offset - second.offset))
        channels = fusion_input_channels(first, second, rule, baseline, self._filler)
        candidates = make_warp_candidates(*fine, source_samplers, baseline, self._tiles.threads)
        return np.concatenate([channels, candidates.channels]), candidates


def downsampled_pair(
    layers: LayerPair, size: tuple[int, int], tiles: LayerPairShader
) -> tuple[LayerArrays, LayerArrays]:
    """Both layers at a smaller size: weighted block means of what is seen; colours are clipped to [0, 1]."""
    (height, _), (rows, _) = tiles.size, size
    colours, rhos = np.empty((2, *size, 4), np.float32), np.empty((2, *size), np.float32)
    both = (layers.first, layers.second)

    def downsample(top: int, bottom: int, *shaded: np.ndarray) -> None:
        for layer, colour, coarse, rho in zip(both, shaded, colours, rhos, strict=True):
            downsample_rows(colour, layer.inverse_depth[top:bottom], coarse, rho, top, height)

    tiles(layers, downsample, [*(i * height // rows for i in range(0, rows, TILE_COARSE_ROWS)), height])
    first, second = (
        LayerArrays(colour[..., :3], colour[..., 3], rho, layer.target_from_source.position.astype(np.float32))
        for layer, colour, rho in zip(both, colours, rhos, strict=True)
    )
    return first, second


def _halve(layer: LayerArrays) -> LayerArrays:
    """The layer at the size of the channels."""
    rows, cols = layer.weight.shape
    size = (rows // CANDIDATE_SCALE, cols // CANDIDATE_SCALE)
    colour, rho = np.empty((*size, 4), np.float32), np.empty(size, np.float32)
    weighted = np.concatenate([layer.colour, layer.weight[..., None]], axis=-1)
    downsample_rows(weighted, layer.inverse_depth, colour, rho, 0, rows)
    return replace(layer, colour=colour[..., :3], weight=colour[..., 3], inverse_depth=rho)


@fast_kernel()
def downsample_rows(colour, rho, coarse, coarse_rho, top, height):  # type: ignore[no-untyped-def]
    """Some rows of a layer at a smaller size: means over blocks of what is seen, by its weight.

    Of large blocks only :data:`SAMPLES_PER_BLOCK_SIDE` rows and columns, or some more, are read. ``colour`` ``(rows,
    width, 4)``, RGB and weight, and ``rho`` are rows of whole blocks, from ``top`` on, of a frame of ``height`` rows.
    Written are ``coarse``, RGB in [0, 1] and mean weight, 0 where nothing is seen, and ``coarse_rho``, −1 there.
    """
    width = rho.shape[1]
    rows, cols = coarse_rho.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(-(-top * rows // height), -(-(top + len(rho)) * rows // height)):
        above, below = i * height // rows - top, (i + 1) * height // rows - top
        for j in range(cols):
            left, right = j * width // cols, (j + 1) * width // cols
            row_step = max(1, (below - above) // SAMPLES_PER_BLOCK_SIDE)
            col_step = max(1, (right - left) // SAMPLES_PER_BLOCK_SIDE)
            red = green = blue = rho_sum = total = zero
            count = 0
            for row in range(above, below, row_step):
                for col in range(left, right, col_step):
                    count += 1
                    weight = colour[row, col, 3]
                    if weight > MIN_VISIBLE_WEIGHT:
                        red += weight * colour[row, col, 0]
                        green += weight * colour[row, col, 1]
                        blue += weight * colour[row, col, 2]
                        rho_sum += weight * max(rho[row, col], zero)
                        total += weight
            weight = total / np.float32(count)
            if weight > MIN_VISIBLE_WEIGHT:
                coarse[i, j, 0] = min(one, max(zero, red / total))
                coarse[i, j, 1] = min(one, max(zero, green / total))
                coarse[i, j, 2] = min(one, max(zero, blue / total))
                coarse[i, j, 3] = weight
                coarse_rho[i, j] = rho_sum / total
            else:
                for k in range(4):
                    coarse[i, j, k] = zero
                coarse_rho[i, j] = -one
