"""Pictures with another exposure, by the definition: linear light times a power of two, cut off at white, 8 bits."""

import numpy as np


def linear(stored: np.ndarray) -> np.ndarray:
    return np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)


def stored(light: np.ndarray) -> np.ndarray:
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 1e-12) ** (1 / 2.4) - 0.055)


def exposed(image: np.ndarray, stops: float | np.ndarray) -> np.ndarray:
    """``stops`` may have one number per channel."""
    return stored(np.clip(linear(image) * 2.0 ** np.asarray(stops), 0, 1)).astype(np.float32)


def in_eight_bits(image: np.ndarray) -> np.ndarray:
    return (np.rint(np.clip(image, 0, 1) * 255) / 255).astype(np.float32)
