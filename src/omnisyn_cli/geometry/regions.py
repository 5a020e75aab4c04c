"""Connected regions of a map on the sphere."""

import cv2
import numpy as np
from jaxtyping import Bool, Int32


def connected_regions(mask: Bool[np.ndarray, "rows cols"], *, is_diagonal: bool) -> Int32[np.ndarray, "rows cols"]:
    """A number > 0 for every region of neighbouring pixels, those across the seam included; 0 outside of the mask.

    Pixels that share only a corner are neighbours if ``is_diagonal``.
    """
    closed = np.concatenate([mask, mask[:, :1]], axis=1).astype(np.uint8)  # repeats the first column after the last
    count, labels = cv2.connectedComponents(closed, connectivity=8 if is_diagonal else 4)
    parent = np.arange(count, dtype=np.int32)
    for pair in np.unique(labels[mask[:, 0]][:, [0, -1]], axis=0):
        low, high = sorted(parent[pair])
        parent[parent == high] = low
    return np.asarray(parent[labels[:, :-1]])
