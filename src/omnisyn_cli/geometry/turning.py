"""A panorama as a camera held otherwise in the same place would have taken it; no depth is needed for that."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.sampling import sample_bicubic
from omnisyn_cli.geometry.sphere import pixel_directions

__all__ = ["turned_directions", "turned_image"]


def turned_directions(
    size: tuple[int, int], source: Float[np.ndarray, "3 3"], held: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "height width 3"]:
    """Unit vectors in the frame of a panorama through the pixels of a camera that is held otherwise.

    Args:
        size: height and width of that camera's image.
        source: world-from-camera rotation of the panorama.
        held: world-from-camera rotation of that camera.
    """
    return np.asarray(pixel_directions(*size) @ (source.T @ held).T)


def turned_image(
    image: Float[np.ndarray, "rows cols 3"],
    source: Float[np.ndarray, "3 3"],
    held: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
) -> Float[np.ndarray, "height width 3"]:
    """A panorama as a network is shown it, in training and after: bicubic, averaged over areas where it is larger.

    Args:
        image: RGB in [0, 1].
        source: world-from-camera rotation of the panorama.
        held: world-from-camera rotation of the camera that would have taken the result.
        size: height and width of the result.

    Returns:
        RGB in [0, 1].
    """
    numbers = np.asarray(image, np.float32)
    if numbers.shape[0] > size[0]:
        numbers = np.asarray(cv2.resize(numbers, size[::-1], interpolation=cv2.INTER_AREA))
    return np.asarray(np.clip(sample_bicubic(numbers, turned_directions(size, source, held)), 0.0, 1.0))
