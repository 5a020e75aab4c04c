"""Two panoramas brought to one exposure before their depth is known, so that matching can compare them."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.fusion.photometry.exposure_curve import ExposureCurve, estimate_gain
from omnisyn_cli.fusion.photometry.exposure_kernels import look_up_rows
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.types import View

SAMPLES = (64, 128)
"""Size at which the values of a panorama are counted."""

LEAST_USABLE = 0.99
"""A sample counts where so much of it is not masked."""

WHITE = 0.99
"""A channel of a sample from here on was cut off by its camera."""

MUCH_WHITE = 0.02
"""Share of the sphere: with more of it white a picture counts as cut off."""


def rough_curve(first: View, second: View) -> ExposureCurve:
    """How much brighter the second view may be than the first, before it is known which pixels show the same places.

    Rooms a few metres apart differ by half a stop without being exposed differently: what is found has to be confirmed.
    """
    return estimate_gain(_samples(first), _samples(second))


def equalized(first: View, second: View, curve: ExposureCurve, threads: int | None = None) -> tuple[View, View]:
    """Both views exposed like the darker one; the very same views where they are exposed alike.

    The brighter picture is darkened, not the darker one brightened, which would cut off what only the darker one shows:
    depth by matching of a bright hall, one picture a stop brighter, lost 2.4 dB that way and 0.7 dB this way. What was
    white in the brighter one is grey then, and textureless where the darker one has texture; the view says so.
    """
    if curve.is_identity:
        return first, second
    if curve.gain.mean() > 0.0:
        return first, _exposed(second, curve.table(0.0, of_second=True), threads)
    return _exposed(first, curve.table(1.0, of_second=False), threads), second


def _samples(view: View) -> Float[np.ndarray, "samples 3"]:
    """Colours of the panorama, each standing for the same share of the sphere."""
    image = cv2.resize(np.asarray(view.image, np.float32), SAMPLES[::-1], interpolation=cv2.INTER_AREA)
    repeats = np.rint(10.0 * solid_angles(*SAMPLES) / solid_angles(*SAMPLES).max()).astype(np.intp)
    if view.mask is not None:
        usable = cv2.resize(view.mask.astype(np.float32), SAMPLES[::-1], interpolation=cv2.INTER_AREA)
        repeats[usable < LEAST_USABLE] = 0
    chosen = np.repeat(image.reshape(-1, 3), repeats.ravel(), axis=0)
    return np.asarray(chosen if len(chosen) else np.zeros((1, 3)), np.float64)


def _exposed(view: View, table: np.ndarray, threads: int | None) -> View:
    image = np.array(view.image, np.float32)
    run_bands(lambda begin, end: look_up_rows(image, table, begin, end), len(image), threads)
    is_clipped = bool((_samples(view).max(axis=-1) >= WHITE).mean() > MUCH_WHITE)
    return replace(view, image=image, samples=None, is_clipped=is_clipped)
