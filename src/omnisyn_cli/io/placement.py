"""Where the stored pixels lie on the full sphere: cropped panoramas and OpenEXR windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io.decode import ImageHeader

__all__ = ["Placement", "placement_of"]

TRANSPOSING_ORIENTATIONS = frozenset({5, 6, 7, 8})


@dataclass(frozen=True)
class Placement:
    """A rectangle of ``height × width`` pixels at (``top``, ``left``) of a sphere of ``full_height × full_width``."""

    height: int
    width: int
    top: int
    left: int
    full_height: int
    full_width: int

    @property
    def is_whole(self) -> bool:
        """Whether the stored pixels are the whole sphere."""
        return (self.top, self.left, self.full_height, self.full_width) == (0, 0, self.height, self.width)

    def put(
        self, samples: Shaped[np.ndarray, "height width *channels"]
    ) -> Shaped[np.ndarray, "full_height full_width *channels"]:
        """Samples in their place on the full sphere, zero elsewhere; what lies outside is cut off."""
        full = np.zeros((self.full_height, self.full_width, *samples.shape[2:]), samples.dtype)
        top, left = max(self.top, 0), max(self.left, 0)
        bottom, right = min(self.top + self.height, self.full_height), min(self.left + self.width, self.full_width)
        if bottom > top and right > left:
            full[top:bottom, left:right] = samples[
                top - self.top : bottom - self.top, left - self.left : right - self.left
            ]
        return full


def placement_of(header: ImageHeader) -> Placement:
    """Where the upright image lies on the sphere: GPano tags first, then OpenEXR windows, else it is the whole.

    Raises:
        ImageError: the tags name another projection or contradict themselves.
    """
    projection = header.attributes.get("GPano:ProjectionType", "equirectangular")
    if str(projection).strip().lower() != "equirectangular":
        raise ImageError(
            f"{header.path}: expected an equirectangular panorama, got GPano projection '{projection}'; "
            "export it as equirectangular"
        )
    height, width = header.height, header.width
    if header.orientation in TRANSPOSING_ORIENTATIONS:
        height, width = width, height
    cropped = _google_placement(header, height, width)
    if cropped is not None:
        return cropped
    return Placement(height, width, header.top, header.left, *_full_size(header, height, width))


def _full_size(header: ImageHeader, height: int, width: int) -> tuple[int, int]:
    has_window = (header.full_height, header.full_width) != (header.height, header.width)
    return (header.full_height, header.full_width) if has_window else (height, width)


def _google_placement(header: ImageHeader, height: int, width: int) -> Placement | None:
    """Placement by GPano tags, or None where they do not speak of a crop.

    A picture that was scaled after stitching keeps the tags of its former size, so they are read as proportions.

    Source: Google, "Photo Sphere XMP Metadata".
    """
    full_width = header.number("GPano:FullPanoWidthPixels")
    full_height = header.number("GPano:FullPanoHeightPixels")
    if full_width is None or full_height is None:
        return None
    crop_width = _number_or(header.number("GPano:CroppedAreaImageWidthPixels"), width)
    crop_height = _number_or(header.number("GPano:CroppedAreaImageHeightPixels"), height)
    left = _number_or(header.number("GPano:CroppedAreaLeftPixels"), 0)
    top = _number_or(header.number("GPano:CroppedAreaTopPixels"), 0)
    if (crop_width, crop_height) == (full_width, full_height):
        return None
    fits = 0 <= left <= full_width - crop_width and 0 <= top <= full_height - crop_height
    if not fits or crop_width < 1 or crop_height < 1:
        raise ImageError(
            f"{header.path}: expected a GPano crop inside its full panorama, got {crop_width:g}×{crop_height:g} at "
            f"({left:g}, {top:g}) of {full_width:g}×{full_height:g}; correct or remove the GPano tags"
        )
    across, down = width / crop_width, height / crop_height
    return Placement(
        height,
        width,
        round(top * down),
        round(left * across),
        max(round(full_height * down), height),
        max(round(full_width * across), width),
    )


def _number_or(number: float | None, default: float) -> float:
    return default if number is None else number
