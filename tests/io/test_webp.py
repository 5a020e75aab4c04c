"""WebP says as much about its place on the sphere as other formats do, and a damaged one harms nobody."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from io_samples import exif_of, png_with_xmp, riff_chunk, smooth_image, webp_with, write_with, xmp_packet

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io import read_header, read_panorama
from omnisyn_cli.io.decode import panorama_tags
from omnisyn_cli.io.images import sphere_size
from omnisyn_cli.poses.formats import import_poses
from omnisyn_cli.poses.formats.files import ImportOptions

SIZE = (21, 40)
CROP = {
    "GPano:UsePanoramaViewer": "True",
    "GPano:ProjectionType": "equirectangular",
    "GPano:FullPanoWidthPixels": 64,
    "GPano:FullPanoHeightPixels": 32,
    "GPano:CroppedAreaImageWidthPixels": 40,
    "GPano:CroppedAreaImageHeightPixels": 21,
    "GPano:CroppedAreaLeftPixels": 10,
    "GPano:CroppedAreaTopPixels": 6,
    "GPano:PoseHeadingDegrees": 93.5,
    "GPano:PosePitchDegrees": "-2",
    "GPano:StitchingSoftware": "Hugin &amp; &#228;hnliche",
}
FORMS = ("attributes", "elements")


def write_crop(folder: Path, suffix: str, form: str, tags: dict[str, Any] = CROP) -> Path:
    """A panorama of :data:`SIZE` with tags in a format; PNG and WebP hold the very same packet."""
    path, samples = folder / f"a.{suffix}", smooth_image(*SIZE)
    if suffix in ("jpg", "tif"):
        return write_with(path, samples, **tags)
    plain, packet = write_with(path, samples).read_bytes(), xmp_packet(tags, form)
    path.write_bytes(png_with_xmp(plain, packet) if suffix == "png" else webp_with(plain, SIZE, xmp=packet))
    return path


@pytest.mark.parametrize("form", FORMS)
def test_the_same_crop_is_the_same_sphere_in_every_format(tmp_path, form):
    expected = np.zeros((32, 64), bool)
    expected[6:27, 10:50] = True
    for suffix in ("jpg", "png", "tif", "webp"):
        path = write_crop(tmp_path, suffix, form)
        assert sphere_size(read_header(path)) == (32, 64)
        np.testing.assert_array_equal(read_panorama(path).mask, expected, err_msg=suffix)


@pytest.mark.parametrize("form", FORMS)
def test_webp_has_the_attributes_that_the_same_packet_gives_a_png(tmp_path, form):
    attributes = [read_header(write_crop(tmp_path, suffix, form)).attributes for suffix in ("png", "webp")]
    from_png, from_webp = ({name: value for name, value in of.items() if name in CROP} for of in attributes)
    assert len(from_png) == len(CROP)
    assert from_webp == from_png


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("suffix", ["jpg", "webp"])
def test_any_prefix_may_stand_for_the_tags(tmp_path, form, suffix):
    path, packet = tmp_path / f"a.{suffix}", xmp_packet(CROP, form).replace(b"GPano", b"pano")
    plain = write_with(path, smooth_image(*SIZE)).read_bytes()
    content = b"http://ns.adobe.com/xap/1.0/\0" + packet
    jpeg = plain[:2] + b"\xff\xe1" + (len(content) + 2).to_bytes(2, "big") + content + plain[2:]
    path.write_bytes(jpeg if suffix == "jpg" else webp_with(plain, SIZE, xmp=packet))
    header = read_header(path)
    assert sphere_size(header) == (32, 64)
    assert header.number("GPano:PoseHeadingDegrees") == 93.5


@pytest.mark.parametrize("form", FORMS)
def test_heading_and_place_are_imported(tmp_path, form):
    gps = {
        "GPS:Latitude": ("float[3]", (48.0, 7.0, 30.0)), "GPS:LatitudeRef": "N",
        "GPS:Longitude": ("float[3]", (11.0, 34.0, 2.0)), "GPS:LongitudeRef": "E", "GPS:Altitude": 520.0,
    }  # fmt: skip
    jpeg = write_with(tmp_path / "a.jpg", smooth_image(*SIZE), **gps, **CROP)
    plain = write_with(tmp_path / "a.webp", smooth_image(*SIZE)).read_bytes()
    data = webp_with(plain, SIZE, xmp=xmp_packet(CROP, form), exif=exif_of(jpeg.read_bytes()))
    (tmp_path / "a.webp").write_bytes(data)
    (from_jpeg,), (from_webp,) = (
        import_poses([tmp_path / name], "exif", ImportOptions())[1].views for name in ("a.jpg", "a.webp")
    )
    assert from_webp.pose.almost_equals(from_jpeg.pose)


def test_another_projection_is_refused(tmp_path):
    path = write_crop(tmp_path, "webp", "elements", {**CROP, "GPano:ProjectionType": "cylindrical"})
    with pytest.raises(ImageError, match="projection 'cylindrical'"):
        read_panorama(path)


def test_a_file_cut_short_anywhere_is_an_image_error(tmp_path):
    whole = write_crop(tmp_path, "webp", "attributes").read_bytes()
    cut = tmp_path / "cut.webp"
    for length in range(whole.index(b"XMP "), len(whole)):
        cut.write_bytes(whole[:length])
        with pytest.raises(ImageError, match="expected an image"):
            read_header(cut)


def test_chunks_of_odd_length_are_padded_and_chunks_after_the_end_are_no_part_of_the_file(tmp_path):
    path, packet = tmp_path / "a.webp", xmp_packet({"GPano:PoseRollDegrees": 1.5}, "attributes")
    path.write_bytes(riff_chunk(b"RIFF", b"WEBP" + riff_chunk(b"ODD ", b"XMP") + riff_chunk(b"XMP ", packet)))
    assert panorama_tags(path) == {"GPano:PoseRollDegrees": 1.5}
    path.write_bytes(riff_chunk(b"RIFF", b"WEBP" + riff_chunk(b"ODD ", b"XMP")) + riff_chunk(b"XMP ", packet))
    assert panorama_tags(path) == {}


@given(st.binary(max_size=200), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_sizes_that_lie_and_bytes_that_are_no_text_are_passed_over(tmp_path_factory, data, riff_size, size):
    path = tmp_path_factory.getbasetemp() / "lies.webp"
    for kind in (b"XMP ", b"EXIF"):
        path.write_bytes(b"RIFF" + riff_size.to_bytes(4, "little") + b"WEBP" + kind + size.to_bytes(4, "little") + data)
        assert all(name.startswith("GPano:") for name in panorama_tags(path))


@pytest.mark.parametrize(
    "text",
    ["<GPano:a ", "<GPano:a>", " GPano:a='", " GPano:a=\"<GPano:a='", " GPano:a" + " " * 5000, " GPano:" + "a" * 5000],
)
def test_long_hostile_packets_and_many_chunks_take_no_time(tmp_path, text):
    """Both are read in one pass: a second is ten times what they need."""
    path = tmp_path / "a.webp"
    many = riff_chunk(b"ODD ", b"") * 9000
    packet = (text * (1_000_000 // len(text))).encode()
    path.write_bytes(riff_chunk(b"RIFF", b"WEBP" + many + riff_chunk(b"XMP ", packet)))
    begin = time.process_time()
    panorama_tags(path)
    assert time.process_time() - begin < 1


@pytest.mark.parametrize(("text", "value"), [("1e999", None), ("nan", None), ("-0", 0), ("+12.25", 12.25), ("", None)])
def test_only_finite_numbers_are_numbers(tmp_path, text, value):
    path = write_crop(tmp_path, "webp", "elements", {"GPano:PoseHeadingDegrees": text})
    assert read_header(path).number("GPano:PoseHeadingDegrees") == value
