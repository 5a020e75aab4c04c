"""The values that travel between the layers: frozen dataclasses with shaped fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Shaped, UInt8

from omnisyn_cli.errors import ImageError
from omnisyn_cli.geometry.pose import Pose

__all__ = [
    "DEPTH_CONFIDENCE_GAIN",
    "EDGE_PIXEL_MULTIPLE",
    "EDGE_TILE_COLUMNS",
    "MIN_VISIBLE_WEIGHT",
    "ColourStep",
    "DepthEstimate",
    "DepthEstimator",
    "EdgePixels",
    "EdgeSamples",
    "Fuser",
    "KnownDepth",
    "Layer",
    "SourceSampler",
    "View",
]

Array = Any  # numpy.ndarray or torch.Tensor

MIN_VISIBLE_WEIGHT = np.float32(1e-4)
"""Colours of a lower weight count as unseen: alpha is interpolated, so beside a mask it is rarely exactly 0."""

DEPTH_CONFIDENCE_GAIN = 4.0
"""Confidence in the depth of a colour per unit of its weight, clipped to 1. Cut edges have a weight of a quarter, and
their depth is right."""


@dataclass(frozen=True)
class DepthEstimate:
    """What is known about the distances around one panorama, in its own equirectangular frame.

    Attributes:
        inverse_depth: ``(height, width)`` 1/metre, finite and >= 0; 0 is infinitely far.
        confidence: ``(height, width)`` in [0, 1]; 0 where the value is a guess.
        stereo_valid: ``(rows, cols)`` True where stereo matching gave a valid disparity, before completion and
            refinement, at a size of its own; None without matching. Only evaluation reads it.
    """

    inverse_depth: Float[np.ndarray, "height width"]
    confidence: Float[np.ndarray, "height width"]
    stereo_valid: Bool[np.ndarray, "rows cols"] | None = None


@dataclass(frozen=True)
class View:
    """A posed panorama.

    Attributes:
        image: ``(height, width, 3)`` RGB in [0, 1], equirectangular.
        pose: world-from-camera.
        mask: ``(height, width)``, True where the image may be used; ``None`` means everywhere.
        known_depth: depth that came with the panorama, at a resolution of its own; ``None`` if there is none.
        is_clipped: whether much of it was clipped at white before it was darkened to the exposure of another panorama.
            The true colours there are unknown.
        samples: ``(height, width, 3)`` what ``image`` is 1/255 of, where it comes from samples of 8 bits.
    """

    image: Float[np.ndarray, "height width 3"]
    pose: Pose
    mask: Bool[np.ndarray, "height width"] | None = None
    known_depth: DepthEstimate | None = None
    is_clipped: bool = False
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


EDGE_TILE_COLUMNS = 4
"""Columns of pixels that :attr:`EdgePixels.begins` counts together."""

EDGE_PIXEL_MULTIPLE = 2
"""The spots of a row are filled up to a multiple of so many: kernels take the samples of two at a time."""


class EdgePixels(NamedTuple):
    """Some pixels of some rows of a target, each with four samples: the pixels of a target of twice the size.

    Numbers of samples come as arrays ``(2, 2·spots, ...)``: the upper and the lower row of samples of every spot, and
    in each the left and the right one. Kernels take it as it is.

    Attributes:
        top: the row of the target that the first row is.
        cols: columns of the target, row after row, ascending in each; −1 fills rows up.
        begins: for each row, the first spot at or after every :data:`EDGE_TILE_COLUMNS` columns; last, that after the row.
        counts: how many spots of the row before each of these have samples that are to be found.
        inverse_depth: of all samples, 1/metre: negative where it is to be found, else what it is.
        sin_a: sines of the azimuths of the samples of a row, two for every spot.
        cos_a: cosines of the same.
    """

    top: int
    cols: Int32[np.ndarray, " spots"]
    begins: Int32[np.ndarray, "rows tiles"]
    counts: Int32[np.ndarray, "rows tiles"]
    inverse_depth: Float32[np.ndarray, "2 samples"]
    sin_a: Float32[np.ndarray, " samples"]
    cos_a: Float32[np.ndarray, " samples"]


EdgeSamples = tuple[Float32[np.ndarray, "2 samples"], Float32[np.ndarray, "2 samples 4"]]
"""Of spots: inverse depth, negative where nothing is seen, and RGB with weight."""


@dataclass(frozen=True)
class SourceSampler:
    """What a view says about points that are supposed in front of a target, whatever its own depth says.

    Points are given as 1/metre from the target, in the directions of its pixels; negative where there is none.

    Attributes:
        colour_rows: called with points of some rows of a target of the frames' size, the first row, and memory
            ``(rows, width, 4)`` that it writes: what the photograph shows in their direction, RGB and alpha; 0 where
            there is no point. From any number of threads.
        colour: such colours for a target of any size, given its points; shrunk as a picture of that size would be.
        nearer: called with points of a target of any size, and an inverse depth that counts as next to nothing: by
            how much the view's own surface is nearer, as a share of the greater inverse depth (seen from the view);
            from −1, where it is far behind the point, to 1.
    """

    colour_rows: Callable[[Float32[np.ndarray, "rows width"], int, Float32[np.ndarray, "rows width 4"]], None]
    colour: Callable[[Float32[np.ndarray, "height width"]], Float32[np.ndarray, "height width 4"]]
    nearer: Callable[[Float32[np.ndarray, "height width"], float], Float32[np.ndarray, "height width"]]


@dataclass(frozen=True)
class Layer:
    """One view's surface as a target sees it; its colours are made when and where they are asked for.

    Arrays are numpy's, or torch's where it was made on a device.

    Attributes:
        inverse_depth: ``(height, width)`` 1/metre from the target; negative where nothing is seen.
        colour_rows: called with a first row, the row after the last, and memory ``(rows, width, 4)`` that it writes:
            RGB and, last, the weight in a blend: 0 where nothing is seen, else up to 1, or a little more beside a mask,
            where interpolation overshoots. From any number of threads, until its renderer is called again.
        colour_grid: such colours ``(rows, columns, 4)`` where some rows and columns cross, given as ascending indices.
        target_from_source: the transform it was rendered with.
        held: all colours ``(height, width, 4)``, where they are there already.
        samples: inverse depth and colours of the samples of spots, in memory of their own; None where pixels have
            none but their centre. Called as ``colour_rows`` is.
        witness: says what else the view shows; None where nobody can ask it.
    """

    inverse_depth: Float32[Array, "height width"]
    colour_rows: Callable[[int, int, Array], None]
    colour_grid: Callable[[np.ndarray, np.ndarray], Array]
    target_from_source: Pose
    held: Float32[Array, "height width 4"] | None = None
    samples: Callable[[EdgePixels], EdgeSamples] | None = None
    source_sampler: SourceSampler | None = None

    @staticmethod
    def from_arrays(inverse_depth: Array, colour: Array, target_from_source: Pose) -> Layer:
        """One whose colours are there already."""

        def colour_rows(begin: int, end: int, out: Array) -> None:
            out[:] = colour[begin:end]

        return Layer(
            inverse_depth, colour_rows, lambda rows, cols: colour[rows].take(cols, axis=1), target_from_source, colour
        )

    @cached_property
    def colour(self) -> Float32[Array, "height width 4"]:
        """All colours."""
        if self.held is not None:
            return self.held
        colour = np.empty((*self.inverse_depth.shape, 4), np.float32)
        self.colour_rows(0, len(colour), colour)
        return colour


ColourStep = Callable[[Array, Array, int], None]
"""Changes some rows of colours of a first and of a second view in place; its last argument is the first row."""


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

    def __call__(
        self,
        first: Layer,
        second: Layer,
        t: float,
        out: Shaped[np.ndarray, "height width 3"] | None = None,
        confidence: Float32[np.ndarray, "height width"] | None = None,
    ) -> Shaped[np.ndarray, "height width 3"]:
        """The picture at a share ``t`` of the way from the first to the second.

        Args:
            first: of the first view.
            second: of the second view.
            t: share of the way.
            out: written and returned: numbers >= 0, or samples of 8 bits; by default numbers in memory that the next
                call may overwrite.
            confidence: written where it is given: how far every pixel can be relied on, in [0, 1].

        What is not asked for is not passed, so three arguments do for one that makes numbers without confidence.
        """
        ...
