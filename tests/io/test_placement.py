"""Cropped panoramas that were scaled afterwards lie on a whole sphere, where they were cropped."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from io_samples import smooth_image, write_with

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io import read_panorama
from omnisyn_cli.io.decode import ImageHeader
from omnisyn_cli.io.placement import Placement, placement_of

ROUNDINGS = (round, math.floor, math.ceil)  # How programs make whole pixels of a scaled height and width.
Crop = tuple[int, int, int, int, int]


def header_of(height: int, width: int, crop: Crop, full_width: float | None = None) -> ImageHeader:
    """A JPEG of a size whose tags say ``crop``: height of the full sphere, then height, width, top, left."""
    sizes = ("FullPanoHeight", "CroppedAreaImageHeight", "CroppedAreaImageWidth", "CroppedAreaTop", "CroppedAreaLeft")
    tags: dict[str, float] = {f"GPano:{name}Pixels": value for name, value in zip(sizes, crop, strict=True)}
    tags["GPano:FullPanoWidthPixels"] = 2 * crop[0] if full_width is None else full_width
    path, names = Path("a.jpg"), ("R", "G", "B")
    return ImageHeader(path, "jpeg", height, width, 0, 0, height, width, names, "uint8", -1, False, 1, tags)


@st.composite
def crops(draw: st.DrawFn) -> Crop:
    """Part of a sphere, often of full width, often at an edge."""
    full_height = draw(st.integers(4, 4096))
    width = draw(st.just(2 * full_height) | st.integers(1, 2 * full_height))
    height = draw(st.integers(1, full_height - (width == 2 * full_height)))
    above, beside = full_height - height, 2 * full_height - width
    top = draw(st.sampled_from((0, above)) | st.integers(0, above))
    return full_height, height, width, top, draw(st.sampled_from((0, beside)) | st.integers(0, beside))


def miss(start: int, length: int, tagged_start: float, tagged_length: float, scale: float) -> float:
    """Pixels between the centre of a picture and its exact place."""
    return abs(start + length / 2 - (tagged_start + tagged_length / 2) * scale)


@given(crops(), st.floats(0.02, 3.0), st.sampled_from(ROUNDINGS))
@example((2048, 1400, 4096, 300, 0), 0.5001, round)
@example((2048, 1023, 4096, 1025, 0), 0.5, math.floor)
def test_a_scaled_crop_lies_on_a_whole_sphere_within_a_pixel_of_its_place(crop, scale, rounding):
    tagged_full, tagged_height, tagged_width, tagged_top, tagged_left = crop
    height, width = rounding(tagged_height * scale), rounding(tagged_width * scale)
    assume(min(height, width) >= 1)
    placement = placement_of(header_of(height, width, crop))
    assert placement.full_width == 2 * placement.full_height
    assert 0 <= placement.top <= placement.full_height - height
    assert 0 <= placement.left <= placement.full_width - width
    actual = placement.full_height / tagged_full
    assert miss(placement.top, height, tagged_top, tagged_height, actual) <= 1
    assert miss(placement.left, width, tagged_left, tagged_width, actual) <= 1
    # The sphere's own size is known as well as the larger side of its part was rounded.
    known = max(tagged_width / (2 * tagged_full), tagged_height / tagged_full)
    assert abs(placement.full_height - tagged_full * scale) <= 1.25 / known + 0.5


@given(crops(), st.floats(0.02, 3.0), st.sampled_from(ROUNDINGS))
def test_pictures_as_wide_as_the_sphere_stay_so(crop, scale, rounding):
    full_height = crop[0]
    height, width = rounding(crop[1] * scale), rounding(2 * full_height * scale)
    assume(height >= 1 and width >= 2 and crop[1] < full_height)
    placement = placement_of(header_of(height, width, (full_height, crop[1], 2 * full_height, crop[3], 0)))
    assert placement.full_width == max(width + width % 2, 2 * height)


@given(crops())
def test_a_crop_that_was_not_scaled_lies_exactly_where_its_tags_say(crop):
    full_height, height, width, top, left = crop
    expected = Placement(height, width, top, left, full_height, 2 * full_height)
    assert placement_of(header_of(height, width, crop)) == expected


def test_what_was_stretched_or_was_never_2_to_1_is_taken_as_its_tags_say():
    stretched = placement_of(header_of(50, 200, (100, 100, 100, 0, 50)))
    assert stretched == Placement(50, 200, 0, 100, 50, 400)
    assert placement_of(header_of(50, 50, (100, 100, 100, 0, 50), full_width=180)) == Placement(50, 50, 0, 25, 50, 90)


@pytest.mark.parametrize("scale", [0.25, 0.37, 0.5, 0.731])
def test_a_scaled_strip_is_read_as_a_sphere(tmp_path, scale):
    """As stitched from a row of photographs: all around, without zenith and nadir."""
    height, width = round(141 * scale), round(512 * scale)
    tags = {
        "GPano:FullPanoWidthPixels": 512, "GPano:FullPanoHeightPixels": 256, "GPano:CroppedAreaImageWidthPixels": 512,
        "GPano:CroppedAreaImageHeightPixels": 141, "GPano:CroppedAreaLeftPixels": 0, "GPano:CroppedAreaTopPixels": 67,
    }  # fmt: skip
    panorama = read_panorama(write_with(tmp_path / "a.jpg", smooth_image(height, width), **tags))
    assert panorama.image.shape[1] == 2 * panorama.image.shape[0] == width + width % 2
    assert panorama.mask is not None
    assert panorama.mask.sum() == height * width
    assert abs(np.flatnonzero(panorama.mask.any(axis=1))[0] - 67 * scale) <= 1


def test_sizes_beyond_all_numbers_are_refused():
    with pytest.raises(ImageError, match="inside its full panorama"):
        placement_of(header_of(20, 40, (10**300, 1, 1, 0, 0), full_width=2e300))
