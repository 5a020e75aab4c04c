"""Two panoramas brought to one exposure before their depth is known, so that stereo matching can compare them."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.photometry.exposure_curve import ExposureCurve, estimate_gain
from omnisyn_cli.fusion.photometry.exposure_kernels import look_up_rows
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.types import View

SAMPLE_SIZE = (64, 128)  # height and width at which the values of a panorama are counted. Set by hand.
MIN_UNMASKED_SHARE = 0.99  # share of a sample that has to be unmasked. Set by hand.
CLIPPED_SRGB = 0.99  # sRGB value from which on a channel of a sample was clipped by its camera. Set by hand.
MAX_CLIPPED_SHARE = 0.02  # share of the sphere above which a picture counts as clipped. Set by hand.


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
