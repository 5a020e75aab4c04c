"""The values that travel between the layers: frozen dataclasses with shaped fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Integer, Shaped, UInt8

from omnisyn_cli.errors import ImageError
from omnisyn_cli.geometry.perspective import target_tables
from omnisyn_cli.geometry.pose import Pose

Array = Any  # numpy.ndarray or torch.Tensor

# Colours of a lower weight count as unseen: alpha is interpolated, so beside a mask it is rarely exactly 0.
MIN_VISIBLE_WEIGHT = np.float32(1e-4)
# Confidence in the depth of a colour per unit of its weight, clipped to 1. Cut edges have a weight of a quarter, and
# their depth is right.
DEPTH_CONFIDENCE_GAIN = 4.0


@dataclass(frozen=True)
class DepthEstimate:
    """What is known about the distances around one panorama, in its own equirectangular frame."""

    inverse_depth: Float[np.ndarray, "height width"]  # 1/metre, finite and >= 0; 0 is infinitely far
    confidence: Float[np.ndarray, "height width"]  # in [0, 1]; 0 where the value is a guess
    # True where stereo matching gave a valid disparity, before completion and refinement, at a size of its own; None
    # without matching. Only evaluation reads it.
    stereo_valid: Bool[np.ndarray, "rows cols"] | None = None


@dataclass(frozen=True)
class View:
    """A posed panorama."""

    image: Float[np.ndarray, "height width 3"]  # RGB in [0, 1], equirectangular
    pose: Pose  # world-from-camera
    mask: Bool[np.ndarray, "height width"] | None = None  # True where the image may be used; None means everywhere
    known_depth: DepthEstimate | None = None  # that came with the panorama, at a resolution of its own
    # whether much of it was clipped at white before it was darkened to the exposure of another panorama; the true
    # colours there are unknown
    is_clipped: bool = False
    image_uint8: UInt8[np.ndarray, "height width 3"] | None = None  # the same image, if it came with 8 bits per channel
    # whether masked pixels may be shown where the panorama itself is, at the ends of the way: they have colours of
    # their own, such as those of a cap
    shows_masked: bool = False

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        place = ", ".join(f"{metres:.3g}" for metres in self.pose.position)
        extras = {"mask": self.mask, "depth": self.known_depth}
        known = "".join(f", with {name}" for name, value in extras.items() if value is not None)
        return f"View({width}x{height} at ({place}) m{known})"

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


class DirectionTables(NamedTuple):
    """Directions of the pixels of a target, factored into rows and columns, float32. Kernels take it as it is."""

    sin_p: Float32[np.ndarray, " rows"]  # sines of the polar angles of the rows
    cos_p: Float32[np.ndarray, " rows"]
    sin_a: Float32[np.ndarray, " cols"]  # sines of the azimuths of the columns
    cos_a: Float32[np.ndarray, " cols"]

    @staticmethod
    def of_size(height: int, width: int) -> DirectionTables:
        """Of all pixels of an equirectangular target."""
        return DirectionTables.of_target((height, width))

    @staticmethod
    def of_target(size: tuple[int, int]) -> DirectionTables:
        """Of all pixels of a target of any kind, see :mod:`omnisyn_cli.geometry.perspective`."""
        return DirectionTables(*(table.astype(np.float32) for table in target_tables(size)))

    def of_rows(self, rows: slice | Integer[np.ndarray, " some"]) -> DirectionTables:
        """Of some rows."""
        return self._replace(sin_p=self.sin_p[rows], cos_p=self.cos_p[rows])

    def of_cols(self, cols: slice | Integer[np.ndarray, " some"]) -> DirectionTables:
        """Of some columns."""
        return self._replace(sin_a=self.sin_a[cols], cos_a=self.cos_a[cols])


EDGE_TILE_COLUMNS = 4  # columns of pixels per entry of :attr:`EdgePixels.tile_begins`. Set by hand.
# Rows of edge pixels are padded to a multiple of this: SIMD kernels process the samples of two pixels at a time.
EDGE_PIXEL_MULTIPLE = 2


class EdgePixels(NamedTuple):
    """Pixels of some target rows that are supersampled 2x2. Their samples are pixels of a target of twice the size.

    Per-sample arrays have the shape ``(2, 2·pixels, ...)``: the upper and the lower row of samples of every pixel, and
    in each the left and the right sample. Kernels take this tuple as it is.
    """

    top: int  # the target row of the first row of edge pixels
    cols: Int32[np.ndarray, " pixels"]  # target columns, row after row, ascending in each; −1 is padding
    # for each row, the index of the first edge pixel at or after every :data:`EDGE_TILE_COLUMNS` columns; last, the
    # index after the row
    tile_begins: Int32[np.ndarray, "rows tiles"]
    # for each of these, how many edge pixels before it in its row have samples without a known depth
    unknown_counts: Int32[np.ndarray, "rows tiles"]
    inverse_depth: Float32[np.ndarray, "2 samples"]  # 1/metre; negative where it is still to be rasterised
    sin_a: Float32[np.ndarray, " samples"]  # sines of the azimuths of the samples of a row, two for every pixel
    cos_a: Float32[np.ndarray, " samples"]


EdgeSamples = tuple[Float32[np.ndarray, "2 samples"], Float32[np.ndarray, "2 samples 4"]]
"""Inverse depth of the samples of edge pixels, negative where nothing is seen, and RGB with blend weight."""


@dataclass(frozen=True)
class SourceSampler:
    """Backward warping of one source photograph into a target, at depths that the caller supposes.

    Points are given as inverse depths (1/metre from the target) along the rays of the target's pixels. Negative means
    no point. The view's own depth is not used to find colours, only to measure occlusion.
    """

    # called with the points of some target rows at the frames' size, the first row, and a buffer that it writes: RGB
    # and alpha of the photograph at these points; 0 without a point. Thread-safe.
    sample_rows: Callable[[Float32[np.ndarray, "rows width"], int, Float32[np.ndarray, "rows width 4"]], None]
    # the same for a target of any size, given its points, with mip mapping for that size
    sample: Callable[[Float32[np.ndarray, "height width"]], Float32[np.ndarray, "height width 4"]]
    # called with points of a target of any size and the smallest inverse depth to compare against. Returns how much
    # nearer to the source the view's own surface is than the point, relative to the larger inverse depth: 1 where it
    # hides the point, 0 where it agrees, −1 where it lies far behind.
    occlusion: Callable[[Float32[np.ndarray, "height width"], float], Float32[np.ndarray, "height width"]]


@dataclass(frozen=True)
class Layer:
    """One source view rendered into a target. Its depth is there; its colours are shaded on demand.

    Arrays are numpy arrays, or torch tensors if the layer was rendered on a device.
    """

    inverse_depth: Float32[Array, "height width"]  # 1/metre from the target; negative where nothing is seen
    # called with a first row, the row after the last, and a buffer ``(rows, width, 4)`` that it writes: RGB and blend
    # weight. The weight is 0 where nothing is seen, else up to 1; beside a mask interpolation may overshoot slightly.
    # Thread-safe until the layer's renderer is called again.
    colour_rows: Callable[[int, int, Array], None]
    # returns such colours ``(rows, columns, 4)`` where given ascending rows and columns cross
    subsampled_colours: Callable[[np.ndarray, np.ndarray], Array]
    target_from_source: Pose  # the transform it was rendered with
    cached_colour: Float32[Array, "height width 4"] | None = None  # all colours, if they are shaded already
    # inverse depth and colours of the samples of edge pixels, in new arrays; None if the renderer cannot supersample.
    # Called like ``colour_rows``.
    edge_samples: Callable[[EdgePixels], EdgeSamples] | None = None
    source_sampler: SourceSampler | None = None  # backward warping of the same source; None if the renderer has none

    @staticmethod
    def from_arrays(inverse_depth: Array, colour: Array, target_from_source: Pose) -> Layer:
        """A layer whose colours are shaded already."""

        def colour_rows(begin: int, end: int, out: Array) -> None:
            out[:] = colour[begin:end]

        return Layer(
            inverse_depth, colour_rows, lambda rows, cols: colour[rows].take(cols, axis=1), target_from_source, colour
        )

    @cached_property
    def colour(self) -> Float32[Array, "height width 4"]:
        """All colours; shaded once."""
        if self.cached_colour is not None:
            return self.cached_colour
        colour = np.empty((*self.inverse_depth.shape, 4), np.float32)
        self.colour_rows(0, len(colour), colour)
        return colour


ColourStep = Callable[[Array, Array, int], None]
"""Changes some rows of two layers' colours in place. Arguments: colours of the first and second layer, first row."""


class KnownDepth:
    """The depth that came with the panoramas; implements :class:`DepthEstimator`."""

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """``known_depth`` of both; ValueError: a view has none."""
        if first.known_depth is None or second.known_depth is None:
            raise ValueError("expected views with known depth, got one without; choose another depth method")
        return first.known_depth, second.known_depth


class Fuser(Protocol):
    """Anything that fuses the layers of two views into one picture."""

    def __call__(
        self,
        first: Layer,
        second: Layer,
        t: float,
        out: Shaped[np.ndarray, "height width 3"] | None = None,
        confidence: Float32[np.ndarray, "height width"] | None = None,
    ) -> Shaped[np.ndarray, "height width 3"]:
        """The fused picture at a share ``t``, in [0, 1], of the way from the first view to the second.

        ``out`` is written and returned: float32 >= 0, or unsigned integers; by default float32 in a buffer that the
        next call may overwrite. ``confidence`` is written if given: how reliable every pixel is, in [0, 1]. Callers
        pass them only if they need them: a fuser without them may take three arguments.
        """
        ...
