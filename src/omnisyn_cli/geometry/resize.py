"""Panoramas at other sizes, by OpenCV: averages over the area of a new pixel."""

import cv2
import numpy as np
from jaxtyping import Bool

MIN_USABLE_SHARE = 0.99  # share of a resampled pixel that the mask must allow: in effect all of it, but for rounding


def resize_area(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Averages over the area of new pixels; whole factors repeat pixels. None reaches beyond seam or poles."""
    if image.shape[:2] == size:
        return np.asarray(image, np.float32)
    return np.asarray(cv2.resize(np.ascontiguousarray(image, np.float32), size[::-1], interpolation=cv2.INTER_AREA))


def resize_mask(mask: Bool[np.ndarray, "rows cols"], size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """A mask at another size: True where no forbidden pixel contributes."""
    return np.asarray(resize_area(mask.astype(np.float32), size) > MIN_USABLE_SHARE)
