"""Spherical tags go in and come out, and nothing else of a video changes."""

import contextlib
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interpolation_samples import described_by_ffmpeg, ffmpeg
from omnisyn_cli.errors import InputError, WriteError
from omnisyn_cli.io import inject_spherical, open_video, read_spherical
from omnisyn_cli.io.boxes import Box, serialize, top_level_boxes
from omnisyn_cli.io.spherical import _is_wide


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A video with sound and without tags, moov last."""
    path = tmp_path_factory.mktemp("video") / "plain.mp4"
    video = ["-f", "lavfi", "-i", "testsrc2=s=64x32:r=10:d=1", "-f", "lavfi", "-i", "sine=d=1"]
    assert ffmpeg(*video, "-c:v", "libx264", "-preset", "ultrafast", "-c:a", "aac", path).returncode == 0
    return path


@pytest.fixture(scope="module")
def variants(plain):
    """The same media with moov first, in a MOV file, and with a 64-bit mdat size and 64-bit offsets."""
    paths = {"moov last": plain, "moov first": plain.with_name("first.mp4"), "mov": plain.with_name("plain.mov")}
    ffmpeg("-i", plain, "-c", "copy", "-movflags", "+faststart", paths["moov first"])
    ffmpeg("-i", plain, "-c", "copy", paths["mov"])
    paths["wide"] = plain.with_name("wide.mp4")
    paths["wide"].write_bytes(widened(plain.read_bytes()))
    return paths


def widened(data: bytes) -> bytes:
    """``mdat`` with a 64-bit size; its content stays where it is because ffmpeg puts a ``free`` box before it."""
    at = data.index(b"mdat") - 4
    assert data[at - 8 : at] == struct.pack(">I4s", 8, b"free")
    (size,) = struct.unpack_from(">I", data, at)
    return data[: at - 8] + struct.pack(">I4sQ", 1, b"mdat", size + 8) + data[at + 8 :]


def decoded(path: Path) -> bytes:
    result = ffmpeg("-v", "error", "-i", path, "-f", "framemd5", "-")
    assert result.returncode == 0
    assert result.stderr == b""
    return result.stdout


@pytest.mark.parametrize("name", ["moov last", "moov first", "mov", "wide"])
def test_tags_go_in_and_the_media_stay_the_same(tmp_path, variants, name):
    source, target = variants[name], tmp_path / f"-tagged '1' ü{variants[name].suffix}"
    assert not read_spherical(source).has_version_1
    assert not read_spherical(source).has_version_2
    inject_spherical(source, target)
    metadata = read_spherical(target)
    assert metadata.has_version_1
    assert metadata.has_version_2
    assert (metadata.projection, metadata.stereo_mode) == ("equirectangular", "mono")
    assert b"prhd" + bytes(16) in target.read_bytes()  # yaw, pitch and roll are 0
    assert decoded(target) == decoded(source)
    assert [box.kind for box in top_level_boxes(target)][:2] == [b"ftyp", b"moov"]
    assert "Spherical Mapping: equirectangular" in described_by_ffmpeg(target)
    assert list(tmp_path.iterdir()) == [target]


def test_tagging_twice_is_tagging_once(tmp_path, plain):
    inject_spherical(plain, tmp_path / "once.mp4")
    inject_spherical(tmp_path / "once.mp4", tmp_path / "twice.mp4")
    assert (tmp_path / "once.mp4").read_bytes() == (tmp_path / "twice.mp4").read_bytes()


def test_tagging_a_file_in_its_own_place_works(tmp_path, plain):
    copy = tmp_path / "a.mp4"
    copy.write_bytes(plain.read_bytes())
    inject_spherical(copy, copy)
    assert read_spherical(copy).has_version_2
    assert decoded(copy) == decoded(plain)


def test_offsets_are_64_bit_where_the_file_needs_them(tmp_path, plain, monkeypatch):
    monkeypatch.setattr("omnisyn_cli.io.spherical._is_wide", lambda boxes, movie: True)
    inject_spherical(plain, tmp_path / "a.mp4")
    data = (tmp_path / "a.mp4").read_bytes()
    assert b"co64" in data
    assert b"stco" not in data
    assert decoded(tmp_path / "a.mp4") == decoded(plain)


def test_a_file_beyond_4_gib_counts_as_wide(tmp_path):
    large = tmp_path / "large.mp4"
    with large.open("wb") as file:
        file.write(serialize(Box(b"ftyp", b"isom")) + struct.pack(">I4sQ", 1, b"mdat", 5 << 30))
        file.truncate(12 + (5 << 30))
    assert _is_wide(top_level_boxes(large), Box(b"moov", b""))


@pytest.mark.parametrize(
    ("options", "words"), [(("-movflags", "frag_keyframe+empty_moov"), "fragments"), (("-vn",), "video track")]
)
def test_fragmented_files_and_sound_alone_are_refused(tmp_path, plain, options, words):
    source = tmp_path / "a.mp4"
    ffmpeg("-i", plain, "-c", "copy", *options, source)
    with pytest.raises(InputError, match=words):
        inject_spherical(source, tmp_path / "out.mp4")
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize("name", ["moov last", "moov first"])
def test_a_truncated_file_is_an_input_error(tmp_path, variants, name):
    whole, cut = variants[name].read_bytes(), tmp_path / "cut.mp4"
    ends = {box.end for box in top_level_boxes(variants[name])}
    for length in {*range(0, len(whole), len(whole) // 150), *range(len(whole) - 20, len(whole))} - ends:
        cut.write_bytes(whole[:length])
        with pytest.raises(InputError):
            read_spherical(cut)


@settings(max_examples=150)
@given(st.data())
def test_any_damage_to_the_movie_box_is_an_input_error_or_harmless(plain, tmp_path_factory, data):
    whole = bytearray(plain.read_bytes())
    start = whole.index(b"moov") - 4
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(start, len(whole) - 1))] = data.draw(st.sampled_from([0, 1, 8, 127, 255]))
    damaged = tmp_path_factory.getbasetemp() / "damaged.mp4"
    damaged.write_bytes(whole)
    with contextlib.suppress(InputError):
        inject_spherical(damaged, damaged.with_suffix(".out.mp4"))
        read_spherical(damaged.with_suffix(".out.mp4"))


@pytest.mark.parametrize(
    "data",
    [b"", b"moov", b"\0\0\0\0moov" * 50, b"\0\0\0\x01moov" + b"\xff" * 8, b"RIFF____AVI ", b"\0\0\0\x08free" * 200_000],
)
def test_hostile_bytes_are_an_input_error_at_once(tmp_path, data):
    (tmp_path / "a.mp4").write_bytes(data)
    with pytest.raises(InputError):
        read_spherical(tmp_path / "a.mp4")


def test_a_missing_file_is_an_input_error_and_a_missing_folder_a_write_error(tmp_path, plain):
    with pytest.raises(InputError, match="No such file"):
        inject_spherical(tmp_path / "none.mp4", tmp_path / "out.mp4")
    with pytest.raises(WriteError):
        inject_spherical(plain, tmp_path / "none" / "out.mp4")


def test_videos_of_ours_are_tagged(tmp_path):
    with open_video(tmp_path / "a.mp4", size=(32, 64), fps=10, preset="ultrafast") as sink:
        sink.write(np.zeros((32, 64, 3), np.uint8))
    assert read_spherical(tmp_path / "a.mp4").software == "OmniSyn"
