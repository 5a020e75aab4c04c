"""Panoramas survive reading exactly, arrive upright and whole, and damage never passes."""

import sys
from pathlib import Path

import numpy as np
import PIL.Image
import PIL.ImageCms
import pytest
from hypothesis import given
from hypothesis import strategies as st
from io_samples import smooth_image, write_with

from omnisyn_cli.errors import ImageError, OutputPathError, WriteError
from omnisyn_cli.interpolation.describe import describe_file
from omnisyn_cli.io import read_header, read_mask, read_panorama, write_image
from omnisyn_cli.io.images import upright
from process_limits import file_size_limit

AWKWARD_NAMES = [
    "with space.png", 'it\'s "quoted".png', "-leading-dash.png", "ünï日本🌍.png", "100%06d.png", "a?b=c&d.png",
]  # fmt: skip
DAMAGE = {"a.jpg": {}, "p.jpg": {"jpeg:progressive": 1}, "a.png": {}, "a.tif": {}, "a.exr": {}, "a.webp": {}}


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_integer_samples_come_back_bit_by_bit(tmp_path, suffix, dtype):
    image = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (16, 32, 3), dtype, endpoint=True)
    write_image(tmp_path / f"a{suffix}", image)
    panorama = read_panorama(tmp_path / f"a{suffix}")
    assert panorama.original is not None
    np.testing.assert_array_equal(panorama.original, image)
    assert panorama.original.dtype == dtype
    np.testing.assert_array_equal(np.rint(panorama.image * np.float32(np.iinfo(dtype).max)).astype(dtype), image)


@pytest.mark.parametrize("suffix", [".exr", ".tif"])
def test_floating_point_samples_come_back_exactly_and_may_exceed_one(tmp_path, suffix):
    image = np.random.default_rng(2).normal(1, 4, (8, 16, 3)).astype(np.float32)
    write_image(tmp_path / f"a{suffix}", image)
    panorama = read_panorama(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(panorama.image, image)
    assert panorama.original is None
    assert panorama.mask is None


def test_writing_what_was_read_from_8_bits_gives_the_same_bits(tmp_path):
    every_byte = np.resize(np.arange(256, dtype=np.uint8), (16, 32, 3))
    write_image(tmp_path / "a.png", every_byte)
    write_image(tmp_path / "b.png", read_panorama(tmp_path / "a.png").image)
    np.testing.assert_array_equal(read_panorama(tmp_path / "b.png").original, every_byte)


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".JPG"])
def test_jpeg_keeps_colours_in_their_channels(tmp_path, suffix):
    colour = np.broadcast_to(np.array([200, 120, 30], np.uint8), (32, 64, 3))
    write_image(tmp_path / f"a{suffix}", colour)
    assert np.abs(read_panorama(tmp_path / f"a{suffix}").image * 255 - colour).max() <= 2


@pytest.mark.parametrize("name", AWKWARD_NAMES)
def test_any_file_name_works(tmp_path, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_image(Path(name), smooth_image())
    np.testing.assert_array_equal(read_panorama(Path(name)).original, smooth_image())
    assert [file.name for file in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", DAMAGE)
def test_a_file_truncated_anywhere_is_an_image_error(tmp_path, name):
    samples = smooth_image(16, 32)
    whole = write_with(
        tmp_path / name, samples.astype(np.float32) if name.endswith("exr") else samples, **DAMAGE[name]
    ).read_bytes()
    cut = tmp_path / f"cut{Path(name).suffix}"
    step = max(len(whole) // 300, 1)
    for length in [*range(0, len(whole), step), *range(max(len(whole) - 20, 0), len(whole))]:
        cut.write_bytes(whole[:length])
        with pytest.raises(ImageError):
            read_panorama(cut)


@given(st.integers(1, 8))
def test_orientations_are_the_eight_symmetries_of_a_rectangle(orientation):
    stored = np.arange(6).reshape(2, 3, 1)
    seen = upright(stored, orientation)
    corners = {1: (0, 0), 2: (0, -1), 3: (-1, -1), 4: (-1, 0), 5: (0, 0), 6: (-1, 0), 7: (-1, -1), 8: (0, -1)}
    assert seen[0, 0, 0] == stored[corners[orientation]][0]
    assert seen.shape[:2] == ((2, 3) if orientation < 5 else (3, 2))
    # The next pixel to the right of the first one, by the Exif table of rows and columns.
    right = {1: 1, 2: 1, 3: 4, 4: 4, 5: 3, 6: 0, 7: 2, 8: 5}
    assert seen[0, 1, 0] == right[orientation]


def test_exif_orientation_is_applied(tmp_path):
    write_with(tmp_path / "a.tif", smooth_image(64, 32), Orientation=6)
    expected = np.rot90(smooth_image(64, 32), -1)
    np.testing.assert_array_equal(read_panorama(tmp_path / "a.tif").original, expected)


CROP = {
    "GPano:ProjectionType": "equirectangular", "GPano:FullPanoWidthPixels": 64, "GPano:FullPanoHeightPixels": 32,
    "GPano:CroppedAreaImageWidthPixels": 40, "GPano:CroppedAreaImageHeightPixels": 20,
    "GPano:CroppedAreaLeftPixels": 10, "GPano:CroppedAreaTopPixels": 6,
}  # fmt: skip


@pytest.mark.parametrize("scale", [1, 2])
def test_a_cropped_panorama_takes_its_place_and_the_rest_is_masked(tmp_path, scale):
    write_with(tmp_path / "a.jpg", smooth_image(20 * scale, 40 * scale), **CROP)
    panorama = read_panorama(tmp_path / "a.jpg")
    place = (slice(6 * scale, 26 * scale), slice(10 * scale, 50 * scale))
    expected = np.zeros((32 * scale, 64 * scale), bool)
    expected[place] = True
    assert panorama.mask is not None
    assert panorama.original is not None
    np.testing.assert_array_equal(panorama.mask, expected)
    assert not panorama.image[~expected].any()
    assert panorama.original[place].any(axis=-1).all()


def test_tags_of_a_whole_panorama_change_nothing(tmp_path):
    whole = {**CROP, "GPano:CroppedAreaImageWidthPixels": 64, "GPano:CroppedAreaImageHeightPixels": 32}
    write_with(tmp_path / "a.jpg", smooth_image(), **whole)
    assert read_panorama(tmp_path / "a.jpg").mask is None


@pytest.mark.parametrize(
    "tags",
    [{**CROP, "GPano:CroppedAreaLeftPixels": 30}, {**CROP, "GPano:ProjectionType": "cylindrical"},
     {**CROP, "GPano:FullPanoWidthPixels": 2_000_000_000, "GPano:FullPanoHeightPixels": 1_000_000_000},
     {**CROP, "GPano:FullPanoHeightPixels": 31}],
)  # fmt: skip
def test_impossible_tags_are_image_errors(tmp_path, tags):
    write_with(tmp_path / "a.jpg", smooth_image(20, 40), **tags)
    with pytest.raises(ImageError, match="expected"):
        read_panorama(tmp_path / "a.jpg")


def test_an_exr_data_window_takes_its_place(tmp_path):
    samples = smooth_image(20, 40).astype(np.float32)
    write_with(tmp_path / "a.exr", samples, window=(5, -3, 32, 64))
    panorama = read_panorama(tmp_path / "a.exr")
    np.testing.assert_array_equal(panorama.image[5:25, 0:37], samples[:, 3:])
    assert panorama.mask is not None
    assert panorama.mask.sum() == 20 * 37


@pytest.mark.parametrize("channels", [1, 2])
def test_grey_becomes_rgb(tmp_path, channels):
    samples = smooth_image(channels=channels)
    samples[..., 1:] = 255
    write_with(tmp_path / "a.png", samples, names=("Y", "A")[:channels], **{"oiio:UnassociatedAlpha": 1})
    np.testing.assert_array_equal(read_panorama(tmp_path / "a.png").original, np.repeat(samples[..., :1], 3, axis=2))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_alpha_becomes_the_mask_and_leaves_colours_alone(tmp_path, suffix):
    samples = smooth_image(channels=4)
    samples[..., 3] = np.where(np.arange(64) < 20, 127, 128)
    write_with(tmp_path / f"a{suffix}", samples, **{"oiio:UnassociatedAlpha": 1})
    panorama = read_panorama(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(panorama.mask, samples[..., 3] == 128)
    np.testing.assert_array_equal(panorama.original, samples[..., :3])


def test_a_gif_is_read_though_its_reader_counts_alpha_from_one(tmp_path):
    blue = np.broadcast_to(np.array([0, 0, 255], np.uint8), (4, 8, 3))
    panorama = read_panorama(write_with(tmp_path / "a.gif", blue))
    np.testing.assert_array_equal(panorama.image * 255, blue)
    assert panorama.mask is None


def test_premultiplied_colours_are_divided_by_alpha(tmp_path):
    samples = np.full((8, 16, 4), 0.5, np.float32)
    samples[..., 3] = 0.8
    write_with(tmp_path / "a.exr", samples, names=("R", "G", "B", "A"))
    np.testing.assert_allclose(read_panorama(tmp_path / "a.exr").image, 0.625, rtol=1e-6)


def test_layered_exr_channels_are_found_by_their_last_name(tmp_path):
    samples = np.random.default_rng(0).random((8, 16, 4)).astype(np.float32)
    names = ("View.Depth.Z", "View.Combined.B", "View.Combined.G", "View.Combined.R")
    write_with(tmp_path / "a.exr", samples, names=names)
    np.testing.assert_array_equal(read_panorama(tmp_path / "a.exr").image, samples[..., :0:-1])


def test_other_aspect_ratios_are_named_or_resampled(tmp_path):
    write_image(tmp_path / "a.png", np.full((40, 64, 3), 90, np.uint8))
    with pytest.raises(ImageError, match="64×40"):
        read_panorama(tmp_path / "a.png")
    panorama = read_panorama(tmp_path / "a.png", allow_aspect=True)
    assert panorama.image.shape == (32, 64, 3)
    np.testing.assert_allclose(panorama.image, 90 / 255, rtol=1e-6)


def test_masks_are_true_where_white(tmp_path):
    write_image(tmp_path / "a.png", np.where(np.arange(32) < 8, 255, 0).astype(np.uint8)[None].repeat(16, 0))
    assert read_mask(tmp_path / "a.png").sum() == 8 * 16


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_undefined_samples_are_counted(tmp_path, bad):
    samples = np.ones((8, 16, 3), np.float32)
    samples[1, 2, 0] = samples[3, 4, 1] = bad
    write_with(tmp_path / "a.exr", samples)
    with pytest.raises(ImageError, match="got 2 NaN or infinite"):
        read_panorama(tmp_path / "a.exr")


def test_what_is_no_image_is_an_image_error(tmp_path):
    (tmp_path / "empty.jpg").touch()
    (tmp_path / "text.png").write_text("not a picture, whatever the name says " * 9)
    for name, words in [("empty.jpg", "empty file"), ("text.png", "expected an image"), ("none.jpg", "no such file")]:
        with pytest.raises(ImageError, match=words):
            read_panorama(tmp_path / name)
    with pytest.raises(ImageError, match="a folder"):
        read_panorama(tmp_path)
    with pytest.raises(ImageError):
        read_panorama("nul\0byte.jpg")


def test_too_many_pixels_are_refused_by_the_header_alone(tmp_path):
    whole = write_with(tmp_path / "a.png", smooth_image()).read_bytes()
    (tmp_path / "header.png").write_bytes(whole[: whole.index(b"IDAT") + 8])
    with pytest.raises(ImageError, match="64×32 = 2,048"):
        read_panorama(tmp_path / "header.png", max_pixels=2047)


def test_headers_tell_gpano_and_gps(tmp_path):
    gps = {"GPS:Latitude": ("float[3]", (48.0, 30.0, 36.0)), "GPS:LatitudeRef": "S"}
    header = read_header(write_with(tmp_path / "a.jpg", smooth_image(), **CROP, **gps))
    assert (header.format, header.height, header.width, header.dtype) == ("jpeg", 32, 64, "uint8")
    assert header.number("GPano:FullPanoWidthPixels") == 64
    assert header.attributes["GPS:Latitude"] == (48.0, 30.0, 36.0)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".exr"])
def test_a_full_disk_is_a_write_error_and_leaves_the_former_file(tmp_path, suffix):
    target = tmp_path / f"a{suffix}"
    target.write_bytes(b"former")
    noise = np.random.default_rng(0).integers(0, 255, (128, 256, 3), np.uint8)
    with file_size_limit(20_000), pytest.raises(WriteError, match=f"a{suffix}"):
        write_image(target, noise)
    assert target.read_bytes() == b"former"
    assert list(tmp_path.iterdir()) == [target]


def test_places_that_cannot_be_written_are_named_first(tmp_path):
    for path, words in [(tmp_path / "none" / "a.png", "create it first"), (tmp_path / "a.bmp", "ending")]:
        with pytest.raises(OutputPathError, match=words):
            write_image(path, smooth_image())


@pytest.mark.parametrize(
    "image",
    [np.zeros((4, 8, 4), np.uint8), np.zeros((4, 8, 3), np.int32), np.full((4, 8, 3), np.nan), np.zeros((0, 0, 3))],
)
def test_what_is_no_picture_is_a_value_error(tmp_path, image):
    with pytest.raises(ValueError, match="expected"):
        write_image(tmp_path / "a.png", image)
    assert not list(tmp_path.iterdir())


def saved(path: Path, *, mode: str = "RGB", more: int = 0, size: tuple[int, int] = (32, 16)) -> Path:
    """An image as Pillow writes it, of ``more`` pictures after the first."""
    rng = np.random.default_rng(0)
    pictures = [PIL.Image.fromarray(rng.integers(0, 256, (*size[::-1], 3), np.uint8)) for _ in range(more + 1)]
    if mode == "LAB":
        profiles = PIL.ImageCms.createProfile("sRGB"), PIL.ImageCms.createProfile("LAB")
        pictures[0] = PIL.ImageCms.profileToProfile(pictures[0], *profiles, outputMode="LAB")
    else:
        pictures[0] = pictures[0].convert(mode)
    pictures[0].save(path, **({"save_all": True, "append_images": pictures[1:]} if more else {}))
    return path


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK", "YCbCr", "P", "LAB"])
def test_a_tiff_whose_colours_nobody_converts_is_refused(tmp_path: Path, mode: str) -> None:
    path = saved(tmp_path / "a.tif", mode=mode)
    if mode == "LAB":
        for read in (read_header, read_panorama):
            with pytest.raises(ImageError, match="expected colours in RGB, grey or CMYK, got CIELAB; convert"):
                read(path)
    else:
        assert read_panorama(path).image.shape == (16, 32, 3)


@pytest.mark.parametrize("name", ["a.gif", "a.webp", "a.png", "a.tif"])
def test_it_is_known_that_an_image_is_animated(tmp_path: Path, name: str) -> None:
    first = saved(tmp_path / f"one_{name}")
    many = saved(tmp_path / f"many_{name}", more=2)
    assert not read_header(first).has_more_pictures
    assert read_header(many).has_more_pictures
    assert np.abs(read_panorama(many).image - read_panorama(first).image).mean() < 0.1


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere file names are text")
def test_a_name_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.png").rename(tmp_path / "a\udc9b.png")
    for read in (read_header, read_panorama, describe_file):
        with pytest.raises(ImageError, match="expected a file name in UTF-8"):
            read(path)
