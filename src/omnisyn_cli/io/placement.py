"""Where the stored pixels lie on the full sphere: cropped panoramas, OpenEXR windows, and what users know of both."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io.decode import ImageHeader

# EXIF: those that turn a picture by a quarter, so that width and height change places.
TRANSPOSING_ORIENTATIONS = frozenset({5, 6, 7, 8})
MAX_TAGGED_PIXELS = 2**31  # largest size in a tag that is believed, in pixels: products of two sizes stay exact


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
    def full_size(self) -> tuple[int, int]:
        """Height and width of the sphere."""
        return self.full_height, self.full_width

    @property
    def is_whole(self) -> bool:
        """Whether the stored pixels are the whole sphere."""
        return (self.top, self.left, self.full_height, self.full_width) == (0, 0, self.height, self.width)

    def put(
        self, samples: Shaped[np.ndarray, "height width *channels"]
    ) -> Shaped[np.ndarray, "full_height full_width *channels"]:
        """Samples in their place on the full sphere, zero elsewhere; what lies outside is cut off."""
        if self.is_whole:
            return samples
        full = np.zeros((self.full_height, self.full_width, *samples.shape[2:]), samples.dtype)
        top, left = max(self.top, 0), max(self.left, 0)
        bottom, right = min(self.top + self.height, self.full_height), min(self.left + self.width, self.full_width)
        if bottom > top and right > left:
            full[top:bottom, left:right] = samples[
                top - self.top : bottom - self.top, left - self.left : right - self.left
            ]
        return full


@dataclass(frozen=True)
class Reading:
    """What files do not say of their pictures, and how pictures are wanted."""

    upper_half: bool = False  # only the upper half is the picture, as of top-bottom stereo
    # radians that the picture spans, for partial panoramas without tags; one follows from the other
    hfov: float | None = None
    vfov: float | None = None
    horizon: float = 0.5  # where the horizon is then, as a share of the picture's height from its top
    # show linear light (OpenEXR, Radiance HDR) as screens do, instead of taking its numbers
    view_transform: bool = False
    size: tuple[int, int] | None = None  # height and width to which a larger sphere is reduced; None keeps it

    @property
    def is_partial(self) -> bool:
        """Whether it says that pictures are parts of the sphere."""
        return self.hfov is not None or self.vfov is not None

    def placement(self, height: int, width: int) -> Placement:
        """Where an upright picture lies: centred on the sphere, its horizon on the equator."""
        across = self.hfov if self.hfov is not None else (self.vfov or 0.0) * width / height
        down = self.vfov if self.vfov is not None else across * height / width
        full_height = max(round(math.radians(180.0) * height / down), 1)
        full_width = max(round(math.radians(360.0) * width / across), 1)
        if self.hfov is None or self.vfov is None:
            full_width = 2 * full_height
        top = round(full_height / 2 - self.horizon * height)
        return Placement(height, width, top, (full_width - width) // 2, full_height, full_width)


DEFAULT_READING = Reading()  # whole spheres, as their tags and their samples say


def placement_of(header: ImageHeader, reading: Reading = DEFAULT_READING) -> Placement:
    """Where the upright image lies on the sphere: as ``reading`` says, else GPano tags, OpenEXR windows, or the whole.

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
    if reading.upper_half:
        height, header = height // 2, replace(header, full_height=header.full_height // 2, attributes={})
    if reading.is_partial:
        return reading.placement(height, width)
    cropped = _google_placement(header, height, width)
    if cropped is not None:
        return cropped
    full = header.full_height, header.full_width
    full = (height, width) if reading.upper_half or full == (header.height, header.width) else full
    return Placement(height, width, header.top, header.left, *full)


def area_tags(placement: Placement) -> dict[str, str]:
    """The GPano tags that say where a picture lies on the sphere."""
    area = {
        "FullPanoWidthPixels": placement.full_width, "FullPanoHeightPixels": placement.full_height,
        "CroppedAreaImageWidthPixels": placement.width, "CroppedAreaImageHeightPixels": placement.height,
        "CroppedAreaLeftPixels": placement.left, "CroppedAreaTopPixels": placement.top,
    }  # fmt: skip
    return {name: str(pixels) for name, pixels in area.items()}


def _google_placement(header: ImageHeader, height: int, width: int) -> Placement | None:
    """Placement by GPano tags (Google, "Photo Sphere XMP Metadata"); None where they do not speak of a crop."""
    crop = _tagged_crop(header, height, width)
    if crop is None:
        return None
    crop_height, crop_width, top, left, full_height, full_width = crop
    # A picture that was scaled after stitching keeps the tags of its former size: they are proportions.
    across, down = width / crop_width, height / crop_height
    is_even = abs(across - down) <= 1 / crop_width + 1 / crop_height
    if not is_even or full_width != 2 * full_height:
        full = max(round(full_height * down), height), max(round(full_width * across), width)
        return Placement(height, width, round(top * down), round(left * across), *full)
    # Height and width were rounded each on its own: this sphere explains both best (least squares), holds them, and is
    # 2:1 again.
    factor = (height * crop_height + width * crop_width) / (crop_height**2 + crop_width**2)
    rows = max(round(full_height * factor), height, (width + 1) // 2)
    scale = rows / full_height
    first_row = round((top + crop_height / 2) * scale - height / 2)
    first_col = round((left + crop_width / 2) * scale - width / 2)
    begin = min(max(first_row, 0), rows - height), min(max(first_col, 0), 2 * rows - width)
    return Placement(height, width, *begin, rows, 2 * rows)


def _tagged_crop(
    header: ImageHeader, height: int, width: int
) -> tuple[float, float, float, float, float, float] | None:
    """A :class:`Placement` in pixels before scaling, as GPano tags say it; None where they say all of it or nothing."""
    full_width = header.number("GPano:FullPanoWidthPixels")
    full_height = header.number("GPano:FullPanoHeightPixels")
    if full_width is None or full_height is None:
        return None
    names = ("ImageHeight", "ImageWidth", "Top", "Left")
    tagged = [header.number(f"GPano:CroppedArea{name}Pixels") for name in names]
    defaults = (height, width, 0, 0)
    crop_height, crop_width, top, left = (d if n is None else n for n, d in zip(tagged, defaults, strict=True))
    if (crop_width, crop_height) == (full_width, full_height):
        return None
    fits = 0 <= left <= full_width - crop_width and 0 <= top <= full_height - crop_height
    if not fits or crop_width < 1 or crop_height < 1 or max(full_width, full_height) > MAX_TAGGED_PIXELS:
        raise ImageError(
            f"{header.path}: expected a GPano crop inside its full panorama, got {crop_width:g}×{crop_height:g} at "
            f"({left:g}, {top:g}) of {full_width:g}×{full_height:g}; correct or remove the GPano tags"
        )
    return crop_height, crop_width, top, left, full_height, full_width
