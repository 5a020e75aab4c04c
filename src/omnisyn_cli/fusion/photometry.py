"""Two exposures brought to one: of both layers of a frame, by the share of the way; of panoramas, before stereo."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.exposure_curve import ExposureCurve, estimate_gain, srgb_to_linear
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.types import EdgePixels, EdgeSamples, Layer, View

Array = Any  # numpy.ndarray or torch.Tensor

# sRGB value from which on a channel may be clipped: interpolation mixes white with what is near. Set by hand.
CLIPPING_SRGB = np.float32(0.94)
# Share of its weight that a clipped colour may lose; the rest fills where only it is seen. Set by hand.
MAX_CLIPPED_WEIGHT_LOSS = 0.95
SAMPLE_SIZE = (64, 128)  # height and width at which the values of a panorama are counted. Set by hand.
MIN_UNMASKED_SHARE = 0.99  # share of a sample that has to be unmasked. Set by hand.
CLIPPED_SRGB = 0.99  # sRGB value from which on a channel of a sample was clipped by its camera. Set by hand.
MAX_CLIPPED_SHARE = 0.02  # share of the sphere above which a picture counts as clipped. Set by hand.


@dataclass(frozen=True)
class ExposureMatcher:
    """Gives the layers of a pair one exposure; costs nothing where both were exposed alike."""

    curve: ExposureCurve  # gain from the first view to the second

    def __call__(self, first: Layer, second: Layer, t: float) -> tuple[Layer, Layer]:
        """Both layers as they look at a share ``t`` of the way.

        A clipped highlight in the brighter picture is only a lower bound. Once it is darkened, it weighs less than what
        the other layer shows there.
        """
        if self.curve.is_identity:
            return first, second
        exposed = [
            layer if t == end else self._expose(layer, self.curve.table(t, of_second=end == 1))
            for layer, end in ((first, 0), (second, 1))
        ]
        return exposed[0], exposed[1]

    def _expose(self, layer: Layer, table: np.ndarray) -> Layer:
        """A layer whose colours go through a table when they are shaded."""
        loss = clipped_weight_loss(table)

        def change(colour: np.ndarray) -> None:
            expose_rows(colour, table, loss, CLIPPING_SRGB)

        sampler = layer.source_sampler
        if sampler is not None:
            sample_rows = _exposed_in_place(sampler.sample_rows, change)
            sampler = replace(sampler, sample_rows=sample_rows, sample=_exposed(sampler.sample, change))
        return replace(
            layer, colour_rows=_exposed_in_place(layer.colour_rows, change), cached_colour=None,
            subsampled_colours=_exposed(layer.subsampled_colours, change), source_sampler=sampler,
            edge_samples=None if layer.edge_samples is None else partial(_exposed_samples, layer.edge_samples, change),
        )  # fmt: skip


def _exposed(colours: Callable[..., Array], change: Callable[[Array], None]) -> Callable[..., Array]:
    """A function whose colours are exposed."""

    def exposed(*arguments: Any) -> Array:
        colour = colours(*arguments)
        change(colour)
        return colour

    return exposed


def _exposed_in_place(write: Callable[..., None], change: Callable[[Array], None]) -> Callable[..., None]:
    """A function whose last argument is given exposed colours."""

    def written(*arguments: Any) -> None:
        write(*arguments)
        change(arguments[-1])

    return written


def _exposed_samples(
    edge_samples: Callable[[EdgePixels], EdgeSamples], change: Callable[[Array], None], edge_pixels: EdgePixels
) -> EdgeSamples:
    inverse_depth, colour = edge_samples(edge_pixels)
    change(colour)
    return inverse_depth, colour


def clipped_weight_loss(table: Float[np.ndarray, "3 entries"]) -> np.float32:
    """Share of its weight that a white pixel loses when it goes through ``table``, see :meth:`ExposureCurve.table`.

    The more white is darkened, the less its clipped colour says: the weight falls with the fourth power of the light
    that white becomes, in the channel that is darkened most.
    """
    white = float(srgb_to_linear(np.asarray(table[:, -1], np.float64)).min())
    return np.float32(min(MAX_CLIPPED_WEIGHT_LOSS, 1.0 - white**4))


def rough_exposure_curve(first: View, second: View) -> ExposureCurve:
    """:func:`estimate_gain` of two rooms, to be confirmed: half a stop may be the place, and not the exposure."""
    return estimate_gain(_uniform_samples(first), _uniform_samples(second))


def darken_to_match(first: View, second: View, curve: ExposureCurve, threads: int | None = None) -> tuple[View, View]:
    """Both views exposed like the darker one; the very same views where they are exposed alike.

    The brighter picture is darkened. Brightening the darker one would clip what only that one shows: with matched depth
    of a bright hall, one picture a stop brighter, it lost 2.4 dB, and darkening 0.7 dB. Clipped white becomes grey
    without texture; ``is_clipped`` of the view says so.
    """
    if curve.is_identity:
        return first, second
    if curve.gain.mean() > 0.0:
        return first, _expose(second, curve.table(0.0, of_second=True), threads)
    return _expose(first, curve.table(1.0, of_second=False), threads), second


def _uniform_samples(view: View) -> Float[np.ndarray, "samples 3"]:
    """Colours of the panorama, each of the same share of the sphere: rows repeat in proportion to their area."""
    image = cv2.resize(np.asarray(view.image, np.float32), SAMPLE_SIZE[::-1], interpolation=cv2.INTER_AREA)
    repeats = np.rint(10.0 * solid_angles(*SAMPLE_SIZE) / solid_angles(*SAMPLE_SIZE).max()).astype(np.intp)
    if view.mask is not None:
        unmasked = cv2.resize(view.mask.astype(np.float32), SAMPLE_SIZE[::-1], interpolation=cv2.INTER_AREA)
        repeats[unmasked < MIN_UNMASKED_SHARE] = 0
    samples = np.repeat(image.reshape(-1, 3), repeats.ravel(), axis=0)
    return np.asarray(samples if len(samples) else np.zeros((1, 3)), np.float64)


def _expose(view: View, table: np.ndarray, threads: int | None) -> View:
    image = np.array(view.image, np.float32)
    run_ranges(lambda begin, end: look_up_rows(image, table, begin, end), len(image), threads)
    is_clipped = bool((_uniform_samples(view).max(axis=-1) >= CLIPPED_SRGB).mean() > MAX_CLIPPED_SHARE)
    return replace(view, image=image, image_uint8=None, is_clipped=is_clipped)


@inlined(fastmath=True)
def interpolate_table(value, table, k):
    """``table[k]`` at a value from 0 to 1, linearly; beyond, in proportion to its ends: blends may overshoot."""
    last = table.shape[1] - 1
    if value <= np.float32(0.0):
        return value * table[k, 1] * np.float32(last)
    if value >= np.float32(1.0):
        return value * table[k, last]
    position = value * np.float32(last)
    index = min(int(position), last - 1)
    fraction = position - np.float32(index)
    return table[k, index] + fraction * (table[k, index + 1] - table[k, index])


@inlined(fastmath=True)
def exposed_weight(brightest, weight, loss, clipping):
    """The weight of a colour with this brightest channel, see :func:`expose_rows`."""
    zero, one = np.float32(0.0), np.float32(1.0)
    return weight * (one - loss * min(max((brightest - clipping) / (one - clipping), zero), one))


@fast_kernel()
def look_up_rows(image, table, begin, end):
    """Rows ``begin`` to ``end`` of an ``(height, width, 3)`` image through a ``(3, entries)`` table, in place."""
    for row in range(begin, end):
        for col in range(image.shape[1]):
            for k in range(3):
                image[row, col, k] = interpolate_table(image[row, col, k], table, k)


@fast_kernel()
def expose_rows(colour, table, loss, clipping):
    """Send colours ``(rows, width, 4)`` through a table, in place; clipped pixels lose a share of their weight.

    ``table`` ``(3, entries)`` is from 0 to 1 and goes on in proportion; white loses ``loss``, ``clipping`` (sRGB)
    nothing.
    """
    zero = np.float32(0.0)
    for row in range(colour.shape[0]):
        for col in range(colour.shape[1]):
            weight = colour[row, col, 3]
            if weight > zero:
                brightest = max(colour[row, col, 0], max(colour[row, col, 1], colour[row, col, 2]))
                colour[row, col, 3] = exposed_weight(brightest, weight, loss, clipping)
                for k in range(3):
                    colour[row, col, k] = interpolate_table(colour[row, col, k], table, k)
