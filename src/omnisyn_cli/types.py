"""The values that travel between the layers: frozen dataclasses with shaped fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from omnisyn_cli.errors import ImageError
from omnisyn_cli.geometry.pose import Pose

__all__ = [
    "BELIEF",
    "UNSEEN",
    "DepthEstimate",
    "DepthEstimator",
    "Fuser",
    "KnownDepth",
    "Rendering",
    "RowFuser",
    "RowRenderer",
    "RowRendering",
    "View",
]

UNSEEN = np.float32(1e-4)
"""A colour worth less than this is none: alpha is interpolated, so beside a mask it is rarely exactly 0."""

BELIEF = 4.0
"""So many times its worth is a colour's depth believed, at most wholly: a quarter is enough, which cut edges have."""


@dataclass(frozen=True)
class DepthEstimate:
    """What is known about the distances around one panorama, in its own equirectangular frame.

    Attributes:
        inverse_depth: ``(height, width)`` 1/metre, finite and >= 0; 0 is infinitely far.
        confidence: ``(height, width)`` in [0, 1]; 0 where the value is a guess.
    """

    inverse_depth: Float[np.ndarray, "height width"]
    confidence: Float[np.ndarray, "height width"]


@dataclass(frozen=True)
class View:
    """A posed panorama.

    Attributes:
        image: ``(height, width, 3)`` RGB in [0, 1], equirectangular.
        pose: world-from-camera.
        mask: ``(height, width)``, True where the image may be used; ``None`` means everywhere.
        known_depth: depth that came with the panorama, at a resolution of its own; ``None`` if there is none.
        is_cut_off: whether much of it was white before it was darkened to the exposure of another: what colour that
            would have is unknown.
        samples: ``(height, width, 3)`` what ``image`` is 1/255 of, where it comes from samples of 8 bits.
    """

    image: Float[np.ndarray, "height width 3"]
    pose: Pose
    mask: Bool[np.ndarray, "height width"] | None = None
    known_depth: DepthEstimate | None = None
    is_cut_off: bool = False
    samples: UInt8[np.ndarray, "height width 3"] | None = None

    def check_shape(self) -> None:
        """Raise ImageError unless the image is 2:1."""
        height, width = self.image.shape[:2]
        if width != 2 * height:
            raise ImageError(f"expected a panorama twice as wide as high, got {width}×{height}; crop or pad it to 2:1")


class DepthEstimator(Protocol):
    """Anything that finds the depth of both panoramas of a pair."""

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``, each in its own frame."""
        ...


@dataclass(frozen=True)
class Rendering:
    """One view's surface as a target sees it.

    Attributes:
        inverse_depth: ``(height, width)`` 1/metre from the target; negative where nothing is seen.
        colour: ``(height, width, 4)`` RGB and, last, how much it is worth in a blend: 0 where nothing is seen, else up
            to 1, or a little more beside a mask, where interpolation overshoots.
        target_from_source: the transform it was rendered with.
    """

    inverse_depth: Float32[np.ndarray, "height width"]
    colour: Float32[np.ndarray, "height width 4"]
    target_from_source: Pose


@dataclass(frozen=True)
class RowRendering:
    """A :class:`Rendering` whose colours are made when and where they are asked for, and then forgotten.

    Attributes:
        inverse_depth: as of a rendering.
        colour_rows: called with a first row, the row after the last, and memory ``(rows, width, 4)`` that it writes.
        colour_at: colours ``(rows, columns, 4)`` where some rows and columns cross, given as ascending indices.
        target_from_source: as of a rendering.
    """

    inverse_depth: Float32[np.ndarray, "height width"]
    colour_rows: Callable[[int, int, np.ndarray], None]
    colour_at: Callable[[np.ndarray, np.ndarray], np.ndarray]
    target_from_source: Pose


@runtime_checkable
class RowRenderer(Protocol):
    """A panorama with its depth that gives its colours row by row."""

    def by_rows(self, target_from_source: Pose) -> RowRendering:
        """What the target sees; colours can be asked for from any number of threads, until the next call."""
        ...


class KnownDepth:
    """The depth that came with the panoramas; implements :class:`DepthEstimator`."""

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """``known_depth`` of both.

        Raises:
            ValueError: a view has none.
        """
        if first.known_depth is None or second.known_depth is None:
            raise ValueError("expected views with known depth, got one without; choose another depth method")
        return first.known_depth, second.known_depth


class Fuser(Protocol):
    """Anything that makes one picture of the renderings of two views."""

    def __call__(self, first: Rendering, second: Rendering, t: float) -> Float32[np.ndarray, "height width 3"]:
        """The picture at a share ``t`` of the way from the first to the second; the next call may overwrite it."""
        ...


@runtime_checkable
class RowFuser(Protocol):
    """Something that may make pictures of renderings that are coloured row by row."""

    def takes_rows(self) -> bool:
        """Whether it does, for frames of its size."""
        ...

    def samples(
        self, first: RowRendering, second: RowRendering, t: float, out: UInt8[np.ndarray, "height width 3"]
    ) -> None:
        """Write the picture at a share ``t`` of the way, rounded to 8 bits; not called unless it takes rows."""
        ...
