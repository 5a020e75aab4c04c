"""What networks say, to look at while they learn: the picture, the answer, the truth, and the error."""

import cv2
import numpy as np
from jaxtyping import Float, Float32
from torch import Tensor

# Difference of √(inverse depth × baseline) with the brightest colour; fixed, so that steps can be compared.
MAX_SHOWN_ERROR = 0.25
# Percentile of the truth that has the last colour: a few pixels at the nadir would take the whole scale.
NEAR_PERCENTILE = 99.0
SHEET_GAP_PIXELS = 4  # Pixels between the pictures of a sheet


def depth_pictures(
    image: Float[Tensor, "3 height width"], sqrt_inv_depth: Float[Tensor, "height width"],
    truth: Float[Tensor, "height width"],
) -> dict[str, Float32[np.ndarray, "height width 3"]]:  # fmt: skip
    """``input``, ``prediction``, ``truth`` and ``error`` as RGB in [0, 1].

    Estimated and true √(inverse depth × baseline) have the Turbo colours (red is near, dark blue infinitely far, both
    on one scale), errors those of Inferno; what is not known (NaN) is black.
    """
    found, true = as_array(sqrt_inv_depth), as_array(truth)
    known = np.isfinite(true)
    largest = max(float(np.percentile(true[known], NEAR_PERCENTILE)), 1e-3) if known.any() else 1.0
    error = np.where(known, np.abs(found - np.where(known, true, 0.0)), 0.0)
    return {
        "input": as_array(image),
        "prediction": _colourize(found / largest, cv2.COLORMAP_TURBO),
        "truth": np.where(known[..., None], _colourize(true / largest, cv2.COLORMAP_TURBO), np.float32(0.0)),
        "error": _colourize(error / MAX_SHOWN_ERROR, cv2.COLORMAP_INFERNO),
    }


def as_array(x: Float[Tensor, "*channels height width"]) -> Float32[np.ndarray, "height width *channels"]:
    """What is to be seen."""
    return np.ascontiguousarray((x.movedim(0, -1) if x.ndim == 3 else x).cpu().numpy(), np.float32)


def contact_sheet(pictures: dict[str, Float32[np.ndarray, "height width 3"]]) -> Float32[np.ndarray, "rows cols 3"]:
    """All pictures, of one size, two in a row, with black between them."""
    gap = (0, SHEET_GAP_PIXELS)
    shown = [np.pad(picture, (gap, gap, (0, 0))) for picture in pictures.values()]
    shown += [np.zeros_like(shown[0])] * (len(shown) % 2)
    rows = [np.concatenate(pair, axis=1) for pair in zip(shown[::2], shown[1::2], strict=True)]
    return np.concatenate(rows)[:-SHEET_GAP_PIXELS, :-SHEET_GAP_PIXELS]


def _colourize(share: np.ndarray, colours: int) -> Float32[np.ndarray, "height width 3"]:
    """RGB of values in [0, 1]; beyond, the last colour."""
    level = np.rint(np.clip(np.nan_to_num(share), 0.0, 1.0) * 255.0).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(level, colours)[..., ::-1], np.float32) / np.float32(255.0)
