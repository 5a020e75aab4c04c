"""Connected regions of a map on the sphere."""

import cv2
import numpy as np
from jaxtyping import Bool, Int32


def connected_regions(mask: Bool[np.ndarray, "rows cols"], *, is_diagonal: bool) -> Int32[np.ndarray, "rows cols"]:
    """A number > 0 per region of neighbours (seam included, corners if ``is_diagonal``), 0 outside of the mask."""
    closed = np.concatenate([mask, mask[:, :1]], axis=1).astype(np.uint8)  # repeats the first column after the last
    count, labels = cv2.connectedComponents(closed, connectivity=8 if is_diagonal else 4)
    parent = np.arange(count, dtype=np.int32)
    for pair in np.unique(labels[mask[:, 0]][:, [0, -1]], axis=0):
        low, high = sorted(parent[pair])
        parent[parent == high] = low
    return np.asarray(parent[labels[:, :-1]])
