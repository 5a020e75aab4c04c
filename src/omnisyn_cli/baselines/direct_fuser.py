"""Direct fusion as in the paper: a network predicts the colour of every pixel from both layers and their visibility.

It sees the frame at its own size, up to :data:`MAX_NETWORK_ROWS`; larger frames are enlarged. It is not told which view
or surface is nearer, or the position on the way. Only both ends are the photographs. Source: OmniSyn, section 3.5.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_kernels import quantize_rows
from omnisyn_cli.fusion.geometric import Confidence, GeometricFuser, Picture
from omnisyn_cli.fusion.ghosts import have_same_position
from omnisyn_cli.fusion.residual import downsampled_pair, network_size
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import Layer

MAX_NETWORK_ROWS = 1024  # rows of the network's picture; its memory grows with it
SIZE_MULTIPLE = 64  # of the network's input: it halves its input six times


# Takes both layers' colours in [0, 1], 0 where nothing is seen, and both seen masks to a picture, channels first.
DirectFusionNetwork = Callable[[np.ndarray], np.ndarray]


class DirectFuser(GeometricFuser):
    """A :class:`omnisyn_cli.types.Fuser` that predicts frames; geometric below :data:`SIZE_MULTIPLE` rows."""

    def __init__(self, size: tuple[int, int], network: DirectFusionNetwork, threads: int | None = None) -> None:
        super().__init__(size, threads=threads)
        self._network = network
        small = self._small = network_size(size, MAX_NETWORK_ROWS, SIZE_MULTIPLE, scale=1)
        self._enlarge = (
            None if small is None or small == size else RemapTable.for_directions(pixel_directions(*size), small)
        )

    def __call__(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None, confidence: Confidence | None = None
    ) -> Picture:
        """The predicted picture in [0, 1]; InputError: the network does not take channels or answers otherwise."""
        if self._small is None or have_same_position(first, second):
            return super().__call__(first, second, t, out, confidence)
        layers = downsampled_pair(self._with_confidence(first, second, confidence), self._small, self.tiles)
        channels = [*(layer.colour.transpose(2, 0, 1) for layer in layers), *(layer.is_seen[None] for layer in layers)]
        picture = self._network(np.concatenate(channels).astype(np.float32)).transpose(1, 2, 0)
        if self._enlarge is not None:
            picture = self._enlarge.bilinear(picture)
        out = self._output_buffer(out)
        if out.dtype == np.float32:
            return np.clip(picture, 0.0, 1.0, out=out)
        run_ranges(partial(quantize_rows, picture, np.float32(np.iinfo(out.dtype).max), out), len(out), self.threads)
        return out
