"""Files as cameras and telephones write them: HEIC, AVIF, JPEG XL, several pictures in one file, other colours."""

import struct
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO
import pytest
from io_samples import exif_of, smooth_image, write_with, xmp_packet

from omnisyn_cli.errors import ImageError
from omnisyn_cli.io import read_header, read_mask, read_panorama, write_image
from omnisyn_cli.io.colour import parse_profile
from omnisyn_cli.io.placement import Reading

# XYZ under D50 of Display P3's primaries, as Apple's profile has them (columns: red, green, blue).
P3 = np.array([[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]])
ADOBE = np.array([[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]])
SRGB = np.array([[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]])
SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def fixed(*numbers: float) -> bytes:
    return b"".join(struct.pack(">i", round(number * 65536)) for number in numbers)


def icc_profile(columns: np.ndarray, curve: bytes) -> bytes:
    """A profile of an RGB display."""
    tags = {f"{name}XYZ".encode(): b"XYZ \0\0\0\0" + fixed(*columns[:, k]) for k, name in enumerate("rgb")}
    tags |= {f"{name}TRC".encode(): curve for name in "rgb"}
    offset, table, body = 132 + 12 * len(tags), struct.pack(">I", len(tags)), b""
    for name, data in tags.items():
        table += name + struct.pack(">II", offset + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    size = 128 + len(table) + len(body)
    header = struct.pack(">I4sI4s4s4s", size, b"none", 0x04000000, b"mntr", b"RGB ", b"XYZ ").ljust(36, b"\0")
    return (header + b"acsp").ljust(128, b"\0") + table + body


SRGB_LIKE = b"para\0\0\0\0" + struct.pack(">HH", 3, 0) + fixed(*SRGB_CURVE)
GAMMA_22 = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(2.19921875 * 256))
PROFILES = {"p3": icc_profile(P3, SRGB_LIKE), "adobe": icc_profile(ADOBE, GAMMA_22)}


def with_profile(path: Path, samples: np.ndarray, profile: bytes) -> Path:
    return write_with(path, samples, ICCProfile=(f"uint8[{len(profile)}]", np.frombuffer(profile, np.uint8)))


XYZ_UNDER_D65 = {
    "p3": [[0.4865709, 0.2656677, 0.1982173], [0.2289746, 0.6917385, 0.0792869], [0, 0.0451134, 1.0439444]],
    "adobe": [[0.5767309, 0.185554, 0.1881852], [0.2973769, 0.6273491, 0.0752741], [0.0270343, 0.0706872, 0.9911085]],
}
SRGB_OF_XYZ = [
    [3.2404542, -1.5371385, -0.4985314],
    [-0.969266, 1.8760108, 0.041556],
    [0.0556434, -0.2040259, 1.0572252],
]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("name", PROFILES)
def test_embedded_profiles_become_srgb(tmp_path, name, dtype):
    """By the standards' own definitions under D65, out of gamut colours clipped."""
    peak = np.iinfo(dtype).max
    colours = np.array([(1, 1, 1), (0.8, 0.35, 0.2), (0.5, 0.5, 0.5), (0.1, 0.2, 0.15)])
    samples = np.rint(np.resize(colours, (4, 8, 3)) * peak).astype(dtype)
    with_profile(tmp_path / "a.png", samples, PROFILES[name])
    panorama = read_panorama(tmp_path / "a.png")
    curve = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    light = colours**2.19921875 if name == "adobe" else curve
    linear = np.clip(light @ np.array(XYZ_UNDER_D65[name]).T @ np.array(SRGB_OF_XYZ).T, 0, 1)
    expected = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(panorama.image[0, :4], expected, atol=1.2 / 255)
    assert panorama.original is not None
    assert panorama.original.dtype == dtype


def test_srgb_by_another_name_changes_nothing(tmp_path):
    path = with_profile(tmp_path / "a.png", smooth_image(8, 16), icc_profile(SRGB, SRGB_LIKE))
    np.testing.assert_array_equal(read_panorama(path).original, smooth_image(8, 16))


@pytest.mark.parametrize("profile", [b"", PROFILES["p3"][:140], b"\xff" * 300, icc_profile(0 * P3, SRGB_LIKE)])
def test_what_is_no_profile_of_a_display_is_passed_over(profile):
    assert parse_profile(profile) is None


def write_with_pillow(path: Path, samples: np.ndarray, **info: Any) -> Path:
    image = pytest.importorskip("PIL.Image")
    if path.suffix == ".heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    image.fromarray(samples).save(path, quality=95, **info)
    return path


@pytest.mark.parametrize("suffix", [".heic", ".avif"])
def test_pictures_of_telephones_are_read_with_their_tags(tmp_path, suffix):
    samples = cv2.GaussianBlur(smooth_image(64, 128), (0, 0), 4)
    tags = {"GPano:FullPanoWidthPixels": 128, "GPano:PoseHeadingDegrees": 93.5}
    path = write_with_pillow(tmp_path / f"a{suffix}", samples, xmp=xmp_packet(tags, "attributes"))
    header = read_header(path)
    assert (header.height, header.width, header.dtype) == (64, 128, "uint8")
    assert header.number("GPano:PoseHeadingDegrees") == 93.5
    panorama = read_panorama(path)
    assert panorama.path == path
    assert np.abs(panorama.image * 255 - samples).mean() < 3
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ImageError, match="damaged"):
        read_panorama(path)


@pytest.mark.parametrize("suffix", [".heic", ".avif"])
def test_without_a_reader_it_is_said_how_to_convert_them(tmp_path, suffix, monkeypatch):
    (tmp_path / f"a{suffix}").write_bytes(b"\0\0\0\x18ftypheic")
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(
        ImageError, match=rf"pip install 'omnisyn-cli\[heic\]'\), or convert it: magick a{suffix} a\.jpg"
    ):
        read_header(tmp_path / f"a{suffix}")


def test_jpeg_xl(tmp_path):
    samples = smooth_image()
    path = write_with(tmp_path / "a.jxl", samples)
    assert np.abs(read_panorama(path).image * 255 - samples).mean() < 4


@pytest.mark.parametrize("name", ["a.jpg", "a.mpo"])
def test_the_first_of_several_pictures_in_a_jpeg_is_the_panorama(tmp_path, name):
    """Multi-picture files of cameras, and telephones' gain maps behind the photograph."""
    first, second = (np.full((16, 32, 3), level, np.uint8) for level in (200, 40))
    for index, samples in enumerate((first, second)):
        write_image(tmp_path / f"{index}.jpg", samples)
    (tmp_path / name).write_bytes((tmp_path / "0.jpg").read_bytes() + (tmp_path / "1.jpg").read_bytes())
    assert np.abs(read_panorama(tmp_path / name).image * 255 - 200).max() < 3


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_linear_light_is_shown_as_screens_do_if_that_is_asked_for(tmp_path, suffix):
    light = np.resize(np.array([0.0, 0.0025, 0.18, 0.5, 1.0, 20.0], np.float32)[:, None].repeat(3, 1), (12, 24, 3))
    path = write_with(tmp_path / f"a{suffix}", light)
    shown = read_panorama(path, reading=Reading(view_transform=True)).image[0, :6, 0]
    np.testing.assert_allclose(shown[:4], [0, 0.0323, 0.4614, 0.7354], atol=3e-3)
    assert shown[3] < shown[4] < shown[5] <= 1.0
    np.testing.assert_allclose(read_panorama(path).image[0, :6, 0], light[0, :6, 0], rtol=0.01)


def sphere_picture(height: int, width: int) -> np.ndarray:
    """Something that closes at its seam and has a colour at each pole."""
    azimuth, polar = np.meshgrid(np.arange(width) / width * 2 * np.pi, (np.arange(height) + 0.5) / height * np.pi)
    waves = np.sin(polar) * np.sin(3 * azimuth) * 60 + 40 * np.cos(polar)
    return np.stack([128 + waves, 128 - waves, 128 + 40 * np.cos(polar)], axis=-1).astype(np.uint8)


def test_squeezed_video_frames_are_stretched_and_other_pictures_of_16_to_9_are_refused(tmp_path):
    write_image(tmp_path / "frame.png", sphere_picture(180, 320))
    panorama = read_panorama(tmp_path / "frame.png")
    assert panorama.image.shape == (160, 320, 3)
    assert np.abs(panorama.image * 255 - sphere_picture(160, 320)).mean() < 1
    write_image(tmp_path / "photograph.png", smooth_image(180, 320))
    with pytest.raises(ImageError, match=r"twice as wide as high, got 320×180; .*\(--hfov\)"):
        read_panorama(tmp_path / "photograph.png")


def test_top_bottom_stereo_is_recognised_and_its_upper_half_used(tmp_path):
    eye = sphere_picture(64, 128)
    write_image(tmp_path / "stereo.png", np.concatenate([eye, np.roll(eye, 1, axis=1)]))
    with pytest.raises(ImageError, match=r"upper half of top-bottom stereo \(--upper-half\)"):
        read_panorama(tmp_path / "stereo.png")
    with pytest.raises(ImageError, match=r"looks like top-bottom stereo; use the upper half \(--upper-half\)"):
        read_panorama(tmp_path / "stereo.png", allow_aspect=True)
    np.testing.assert_array_equal(
        read_panorama(tmp_path / "stereo.png", reading=Reading(upper_half=True)).original, eye
    )
    write_image(tmp_path / "square.png", cv2.resize(eye, (128, 128)))
    assert read_panorama(tmp_path / "square.png", allow_aspect=True).image.shape == (64, 128, 3)


@pytest.mark.parametrize(
    ("reading", "size", "top"),
    [
        (Reading(hfov=np.pi), (64, 128), 22),
        (Reading(vfov=np.pi / 2), (40, 80), 10),
        (Reading(hfov=np.pi, horizon=0.0), (64, 128), 32),
        (Reading(hfov=2 * np.pi), (32, 64), 6),
        (Reading(hfov=2 * np.pi, vfov=np.pi / 2), (32, 64), 8),
    ],
)
def test_partial_panoramas_lie_where_they_are_said_to(tmp_path, reading, size, top):
    """A picture of 64×20: its middle row is the horizon, or another; both angles at once may stretch it."""
    write_image(tmp_path / "a.png", np.full((20, 64, 3), 200, np.uint8))
    panorama = read_panorama(tmp_path / "a.png", reading=reading)
    assert panorama.image.shape[:2] == size
    assert panorama.mask is not None
    rows, cols = np.flatnonzero(panorama.mask.any(axis=1)), np.flatnonzero(panorama.mask.any(axis=0))
    assert abs(rows[0] - top) <= 1
    assert cols[0] + cols[-1] == size[1] - 1
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png", reading=reading), panorama.mask)


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_large_photographs_are_reduced_while_they_are_read(tmp_path, suffix):
    large = sphere_picture(256, 512)
    path = write_with(tmp_path / f"a{suffix}", large if suffix == ".png" else (large / 255).astype(np.float32))
    panorama = read_panorama(path, reading=Reading(size=(64, 128)))
    assert panorama.image.shape == (64, 128, 3)
    np.testing.assert_allclose(
        panorama.image, cv2.resize(large / 255, (128, 64), interpolation=cv2.INTER_AREA), atol=2e-3
    )
    assert (panorama.original is not None) == (suffix == ".png")
    assert read_panorama(path, reading=Reading(size=(512, 1024))).image.shape == (256, 512, 3)


def test_reduced_crops_and_alpha_keep_only_what_is_known(tmp_path):
    area = {"ImageWidth": 512, "ImageHeight": 130, "Left": 0, "Top": 62}
    tags = {f"GPano:CroppedArea{name}Pixels": value for name, value in area.items()}
    tags |= {"GPano:FullPanoWidthPixels": 512, "GPano:FullPanoHeightPixels": 256}
    path = write_with(tmp_path / "a.jpg", np.full((130, 512, 3), 90, np.uint8), **tags)
    panorama = read_panorama(path, reading=Reading(size=(64, 128)))
    assert panorama.mask is not None
    np.testing.assert_array_equal(np.flatnonzero(panorama.mask.all(axis=1)), np.arange(16, 48))
    assert np.abs(panorama.image[panorama.mask] * 255 - 90).max() < 3
    assert OpenImageIO.geterror() == ""


def test_places_of_telephones_are_read(tmp_path):
    """EXIF goes along: a HEIC picture knows where it was taken."""
    place = {"GPS:Latitude": ("float[3]", (48, 6, 30.0)), "GPS:LatitudeRef": "N"}
    jpeg = write_with(tmp_path / "a.jpg", smooth_image(), **place).read_bytes()
    path = write_with_pillow(tmp_path / "a.heic", smooth_image(64, 128), exif=b"Exif\0\0" + exif_of(jpeg))
    assert read_header(path).degrees("GPS:Latitude", "S") == pytest.approx(48 + 6.5 / 60)
