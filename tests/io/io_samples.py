"""Small images for tests, written by OpenImageIO or Pillow-free means, and bytes to break."""

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO

OIIO_TYPES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}


def smooth_image(height: int = 32, width: int = 64, channels: int = 3, seed: int = 0) -> np.ndarray:
    """uint8 samples that JPEG keeps within a few steps, different in every row, column and channel."""
    row, col, channel = np.meshgrid(np.arange(height), np.arange(width), np.arange(channels), indexing="ij")
    return ((row * 3 + col * 2 + channel * 37 + seed * 11) % 200 + 20).astype(np.uint8)


def write_with(
    path: Path, samples: np.ndarray, *, names: tuple[str, ...] = (), window: Any = None, **tags: Any
) -> Path:
    """Write samples with tags (``Orientation=6``, ``**{"GPano:...": 3}``), channel names and an EXR data window."""
    height, width, channels = samples.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, OIIO_TYPES[str(samples.dtype)])
    if names:
        spec.channelnames = names
    if window is not None:
        spec.y, spec.x, spec.full_height, spec.full_width = window
    for name, value in tags.items():
        if isinstance(value, tuple):
            spec.attribute(name, *value)
        else:
            spec[name] = value
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec)
    assert writer.write_image(np.ascontiguousarray(samples))
    assert writer.close()
    writer.geterror()
    return path
