"""Fusion as in the paper: a network paints every pixel of the picture from two renderings and what they show at all.

The network sees the frame at its own size, up to :data:`MOST_ROWS`; larger frames are painted at that size and
enlarged. Nothing here knows which view is nearer, how far the way is or which surface is in front: that is left to the
network, as the authors leave it. It paints from the first frame after a photograph to the last before the next.

Source: OmniSyn, section 3.5.
"""

from functools import partial
from typing import Protocol

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.fusion.blend_kernels import quantize_rows
from omnisyn_cli.fusion.geometric import Confidence, GeometricFuser, Picture
from omnisyn_cli.fusion.ghosts import have_same_position
from omnisyn_cli.fusion.input_builder import downsampled_pair
from omnisyn_cli.fusion.residual import working_size
from omnisyn_cli.geometry.lookup import Lookup
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import Layer

__all__ = ["DirectFuser"]

MOST_ROWS = 1024
"""Of a picture that is painted: the network's own memory grows with it."""

MULTIPLE = 64
"""It halves its input six times."""


class DirectFusionNetwork(Protocol):
    """A trained network that paints, however it is run."""

    def __call__(self, planes: Float32[np.ndarray, "8 height width"]) -> Float32[np.ndarray, "3 height width"]:
        """The picture; planes are both views' colours in [0, 1], 0 where nothing is seen, and 1 where something is."""
        ...


class DirectFuser(GeometricFuser):
    """Paints; implements :class:`omnisyn_cli.types.Fuser`. Not shared between threads.

    Args:
        size: height and width of the frames; where they are lower than :data:`MULTIPLE` the fusion is geometric.
        painter: the network.
        threads: at most this many; None is one per core.
    """

    def __init__(self, size: tuple[int, int], painter: DirectFusionNetwork, threads: int | None = None) -> None:
        super().__init__(size, threads=threads)
        self._painter = painter
        small = self._small = working_size(size, MOST_ROWS, MULTIPLE, finer=1)
        self._enlarged = None if small is None or small == size else Lookup.along(pixel_directions(*size), small)

    def __call__(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None,
        confidence: Confidence | None = None,
    ) -> Picture:  # fmt: skip
        """The painted picture in [0, 1]; see :class:`omnisyn_cli.types.Fuser`.

        Raises:
            InputError: the network does not take the planes, or answers something else.
        """
        if self._small is None or have_same_position(first, second):
            return super().__call__(first, second, t, out, confidence)
        views = downsampled_pair(self._judged(first, second, confidence), self._small, self.bands)
        planes = [*(view.colour.transpose(2, 0, 1) for view in views), *(view.is_seen[None] for view in views)]
        painted = self._painter(np.concatenate(planes).astype(np.float32)).transpose(1, 2, 0)
        if self._enlarged is not None:
            painted = self._enlarged.bilinear(painted)
        return self._stored(painted, self._memory(out))

    def _stored(self, picture: Float32[np.ndarray, "height width 3"], out: Picture) -> Picture:
        """The picture within [0, 1], as numbers or samples."""
        if out.dtype == np.float32:
            return np.clip(picture, 0.0, 1.0, out=out)
        run_bands(partial(quantize_rows, picture, np.float32(np.iinfo(out.dtype).max), out), len(out), self.threads)
        return out
