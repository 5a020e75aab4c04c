"""Fusion with a network: the geometric fusion, corrected where the views contradict each other or see nothing.

The network looks at both renderings at a size of its own and says, for each pixel, which shares of it are to be what
the photographs show at other distances (:mod:`omnisyn_cli.fusion.warp_candidates`). So everything keeps the sharpness of
the photographs at any size of the frames. Nothing changes where something moved, which one of them shows as a whole
(:mod:`omnisyn_cli.fusion.ghosts`); towards the ends of the way the corrections fade, so that both ends are the
photographs themselves.

Source: OmniSyn, section 3.5, with shares of photographs in the place of colours.
"""

from dataclasses import replace
from typing import Protocol

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.fusion.blend_rule import BlendOptions, BlendRule
from omnisyn_cli.fusion.geometric import Confidence, GeometricFuser, Picture
from omnisyn_cli.fusion.ghost_grid import greatest_near
from omnisyn_cli.fusion.ghosts import GhostSuppression, have_same_position
from omnisyn_cli.fusion.input_builder import InputBuilder
from omnisyn_cli.fusion.input_channels import needs_no_network
from omnisyn_cli.fusion.layer_pair import LayerPair, RowTileRunner
from omnisyn_cli.fusion.warp_candidates import FINER, WarpCandidates
from omnisyn_cli.geometry.sampling import max_pool
from omnisyn_cli.types import Layer, SourceSampler

__all__ = ["ResidualFuser"]

MULTIPLE = 32
"""It halves its input five times."""

LEAST_STRENGTH = 1e-6
"""So close to an end the correction could change no colour."""


def undecided(suppression: GhostSuppression, size: tuple[int, ...]) -> Float32[np.ndarray, "rows cols"]:
    """How far it is open which view is shown: 0 where one of them is suppressed and around there, 1 elsewhere."""
    return np.asarray(1.0 - greatest_near(max_pool(np.abs(suppression.suppressed), size), 1), np.float32)


class ResidualFusionNetwork(Protocol):
    """A trained fusion network, however it is run."""

    def __call__(self, planes: Float32[np.ndarray, "planes height width"]) -> Float32[np.ndarray, "4 height width"]:
        """The shares of the candidates of a second look.

        Planes are those of :mod:`omnisyn_cli.fusion.input_channels`, then those of :mod:`omnisyn_cli.fusion.warp_candidates`.
        """
        ...


def working_size(
    size: tuple[int, int], rows: int, multiple: int = MULTIPLE, finer: int = FINER
) -> tuple[int, int] | None:
    """Height and width that a network works at for frames of ``size``; None where frames are too small for it.

    Args:
        size: of the frames.
        rows: that it looks at, at most.
        multiple: that heights and widths have to be one of.
        finer: how many times that height frames have at least.
    """
    height = min(rows, size[0] // finer, size[1] // (2 * finer)) // multiple * multiple
    return (height, 2 * height) if height else None


class ResidualFuser(GeometricFuser):
    """Blends the renderings of two views; implements :class:`omnisyn_cli.types.Fuser`. Not shared between threads.

    Args:
        size: height and width of the frames; where they are lower than twice :data:`MULTIPLE` the fusion is geometric.
        correction: the network.
        rows: that it looks at, at most; it learned from pictures of 128.
        options: of the geometric fusion.
        threads: at most this many; None is one per core.
        edges: see :class:`omnisyn_cli.fusion.geometric.GeometricFuser`.
    """

    def __init__(
        self,
        size: tuple[int, int],
        correction: ResidualFusionNetwork,
        rows: int,
        options: BlendOptions | None = None,
        threads: int | None = None,
        *,
        edges: bool = True,
    ) -> None:
        super().__init__(size, options, threads, edges=edges)
        self._correction = correction
        small = working_size(size, rows)
        self._planes = None if small is None else InputBuilder(small, RowTileRunner(self._ghosts.downsampled_size, threads))

    def __call__(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None,
        confidence: Confidence | None = None,
    ) -> Picture:  # fmt: skip
        """The fused picture, every pixel of it filled, never negative; see :class:`omnisyn_cli.types.Fuser`.

        Raises:
            InputError: the network does not take the planes, or answers something else.
        """
        rule = BlendRule.at(t, self.options)
        if self._planes is None or rule.strictness < LEAST_STRENGTH or have_same_position(first, second):
            return super().__call__(first, second, t, out, confidence)
        if self._ghosts.is_full_resolution:
            first, second = self.bands.held(first, second)
        one, other = self._ghosts.downsample(first), self._ghosts.downsample(second)
        suppression, out = self._ghosts.among(one, other, rule), self._memory(out)
        self.paint(self._judged(first, second, confidence).then(suppression), rule, out)
        among = None if suppression is None else replace(suppression, cell=self._ghosts.along)
        planes, look = self._planes(LayerPair(one, other).then(among), rule, _source_samplers(first, second))
        if not needs_no_network(planes):
            strength = np.full(planes.shape[1:], rule.strictness, np.float32)
            if suppression is not None:
                strength *= undecided(suppression, strength.shape)
            self.correct(planes, look, strength, out)
        return out

    def correct(
        self, planes: Float32[np.ndarray, "planes height width"], look: WarpCandidates,
        strength: Float32[np.ndarray, "height width"], picture: Picture,
    ) -> None:  # fmt: skip
        """Mix candidates into a picture as the network wants it.

        Args:
            planes: what the network sees.
            look: the candidates.
            strength: how much its word counts, from 0 to 1.
            picture: of the geometric fusion, changed.
        """
        look.mix_in(strength * self._correction(planes), picture, self.threads)


def _source_samplers(first: Layer, second: Layer) -> tuple[SourceSampler, SourceSampler]:
    """Those of both."""
    if first.source_sampler is None or second.source_sampler is None:
        raise ValueError("expected renderings that can be asked, got others; fuse them by rules")
    return first.source_sampler, second.source_sampler
