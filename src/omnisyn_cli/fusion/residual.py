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

from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.geometric import Confidence, GeometricFuser, Picture
from omnisyn_cli.fusion.ghosts import GhostSuppression, have_same_position
from omnisyn_cli.fusion.input_builder import InputBuilder
from omnisyn_cli.fusion.input_channels import needs_no_network
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.fusion.warp_candidates import CANDIDATE_SCALE, WarpCandidates
from omnisyn_cli.fusion.window_filters import dilate
from omnisyn_cli.geometry.sampling import max_pool
from omnisyn_cli.types import Layer, SourceSampler

SIZE_MULTIPLE = 32  # of the network's input: it halves its input five times
MIN_CORRECTION_STRENGTH = 1e-6  # below it the correction could change no colour, so the network is not run


def ghost_free_mask(suppression: GhostSuppression, size: tuple[int, ...]) -> Float32[np.ndarray, "rows cols"]:
    """1 where the network may choose between the layers, 0 where a ghost is suppressed and around there."""
    strength = max_pool(np.abs(suppression.signed_strength), size)
    return np.asarray(1.0 - dilate(strength, 1), np.float32)


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
        self,
        small: tuple[Layer, Layer],
        suppression: GhostSuppression | None,
        rule: BlendRule,
        source_samplers: tuple[SourceSampler, SourceSampler],
    ) -> (
        tuple[Float32[np.ndarray, "channels height width"], WarpCandidates, Float32[np.ndarray, "height width"]] | None
    ):
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
            strength *= ghost_free_mask(suppression, strength.shape)
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
