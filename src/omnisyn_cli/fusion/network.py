"""Fusion with a network: the geometric fusion, corrected where the views contradict each other, and better holes.

The network looks at both renderings at a size of its own and says, for each pixel, by how much the geometric weights
are to be shifted from one view to the other, and what is to be added to the colour that a hole was filled with. What is
seen keeps the sharpness of the photographs at any size of the frames; where both views agree nothing changes, nor where
something moved, which one of them shows as a whole (:mod:`omnisyn_cli.fusion.ghosts`); towards the ends of the way the
corrections fade, so that both ends are the photographs themselves.

Source: OmniSyn, section 3.5, with weights in the place of colours.
"""

from dataclasses import replace
from typing import Protocol

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.fusion.bands import BandRunner, Views
from omnisyn_cli.fusion.geometric import Confidence, GeometricFuser, Picture
from omnisyn_cli.fusion.ghosts import Suppression, is_in_place
from omnisyn_cli.fusion.kernels import Correction, storing_in
from omnisyn_cli.fusion.network_kernels import colour_holes
from omnisyn_cli.fusion.planes import FusionPlanes, PlaneMaker
from omnisyn_cli.fusion.rule import BlendOptions, BlendRule
from omnisyn_cli.geometry.sampling import greatest_of_parts
from omnisyn_cli.runtime.threads import run_bands
from omnisyn_cli.types import Rendering

__all__ = ["NetworkFuser"]

WORKING_ROWS = 64
"""Rows that the network looks at, half as many as it was trained with.

With 128 a frame of 1024×512 takes 0.02 s more of one core and the mean between the twelve pairs of ``omnisyn bench`` is
0.003 ± 0.006 dB more.
"""

MULTIPLE = 32
"""It halves its input five times."""

LEAST_STRENGTH = 1e-6
"""So close to an end the correction could change no colour, and weights may be too small for their ratio to be one."""


def undecided(suppression: Suppression, size: tuple[int, ...]) -> Float32[np.ndarray, "rows cols"]:
    """How far it is open which view is shown: 0 where one of them is suppressed, 1 where neither is, at a size."""
    return np.asarray(1.0 - greatest_of_parts(np.abs(suppression.suppressed), size), np.float32)


class FusionCorrection(Protocol):
    """A trained fusion network, however it is run."""

    def __call__(
        self, planes: Float32[np.ndarray, "planes height width"]
    ) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "3 height width"]]:
        """What to add to the log-ratio of the weights, and to the colours of holes; ``planes`` as in ``planes``."""
        ...


def working_size(size: tuple[int, int], rows: int = WORKING_ROWS, multiple: int = MULTIPLE) -> tuple[int, int] | None:
    """Height and width that a network works at for frames of ``size``; None where frames are too small for it.

    Args:
        size: of the frames.
        rows: that it looks at, at most.
        multiple: that heights and widths have to be one of.
    """
    height = min(rows, size[0], size[1] // 2) // multiple * multiple
    return (height, 2 * height) if height else None


class NetworkFuser(GeometricFuser):
    """Blends the renderings of two views; implements :class:`omnisyn_cli.types.Fuser`. Not shared between threads.

    Args:
        size: height and width of the frames; where they are lower than :data:`MULTIPLE` the fusion is geometric.
        correction: the network.
        options: of the geometric fusion.
        threads: at most this many; None is one per core.
        rows: that the network looks at, at most.
        edges: see :class:`omnisyn_cli.fusion.geometric.GeometricFuser`.
    """

    def __init__(
        self,
        size: tuple[int, int],
        correction: FusionCorrection,
        options: BlendOptions | None = None,
        threads: int | None = None,
        rows: int = WORKING_ROWS,
        *,
        edges: bool = True,
    ) -> None:
        super().__init__(size, options, threads, edges=edges)
        self._correction = correction
        small = working_size(size, rows)
        self._planes = None if small is None else PlaneMaker(small, BandRunner(self._ghosts.looked_size, threads))

    def __call__(
        self, first: Rendering, second: Rendering, t: float, out: Picture | None = None,
        confidence: Confidence | None = None,
    ) -> Picture:  # fmt: skip
        """The fused picture, every pixel of it filled, never negative; see :class:`omnisyn_cli.types.Fuser`.

        Raises:
            InputError: the network does not take the planes, or answers something else.
        """
        rule = BlendRule.at(t, self.options)
        if self._planes is None or rule.strictness < LEAST_STRENGTH or is_in_place(first, second):
            return super().__call__(first, second, t, out, confidence)
        if self._ghosts.looks_everywhere:
            first, second = self.bands.held(first, second)
        one, other = self._ghosts.looked_at(first), self._ghosts.looked_at(second)
        suppression, out = self._ghosts.among(one, other, rule), self._memory(out)
        judged = self._judged(first, second, confidence).then(suppression)
        among = None if suppression is None else replace(suppression, cell=self._ghosts.along)
        seen = self._planes(Views(one, other).then(among), rule)
        if seen.is_settled:
            self.paint(judged, rule, out)
        else:
            self._correct(judged, rule, seen, suppression, out)
        return out

    def _correct(
        self, views: Views, rule: BlendRule, seen: FusionPlanes, suppression: Suppression | None, out: Picture
    ) -> None:
        """The picture as the network wants it."""
        shift, colours = self._correction(seen.planes)
        strength, storing = np.float32(rule.strictness), storing_in(out)
        shift = strength * seen.doubt * shift
        if suppression is not None:
            shift = undecided(suppression, shift.shape) * shift
        self.paint(views, rule, out, Correction(shift, seen.log_ratio, seen.both))

        def add(begin: int, end: int) -> None:
            colour_holes(self.is_seen, colours, seen.holes, strength, storing, out, begin, end)

        run_bands(add, self.size[0], self.threads)
