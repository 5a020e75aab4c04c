"""``interpolate --audio`` and ``omnisyn tag``: sound as long as the video, metadata without another byte changed."""

import re
import subprocess
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from cli.cli_samples import Omnisyn, pair_arguments, write_pair
from omnisyn_cli.batch.manifest import read_manifest
from omnisyn_cli.io import read_spherical
from omnisyn_cli.io.encoders import ffmpeg_program
from omnisyn_cli.io.jpeg_metadata import GPANO


def ffmpeg(*arguments: object) -> str:
    command = [ffmpeg_program(), "-hide_banner", "-y", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False).stderr


def sound(path: Path, seconds: float) -> Path:
    ffmpeg("-f", "lavfi", "-i", f"sine=440:d={seconds}", path)
    return path


def heard(path: Path) -> np.ndarray:
    """Samples of the first sound of a file, 8000 a second, as another reader decodes it."""
    command = [
        ffmpeg_program(),
        "-v",
        "error",
        "-i",
        str(path),
        "-map",
        "0:a:0",
        "-ac",
        "1",
        "-ar",
        "8000",
        "-f",
        "f32le",
        "-",
    ]
    return np.frombuffer(subprocess.run(command, capture_output=True, check=True).stdout, np.float32)


@pytest.mark.parametrize(
    ("name", "seconds", "fit"),
    [("long.m4a", 9, "9.0 s, cut to the 3.0 s of the video, copied"),
     ("long.wav", 9, "9.0 s, cut to the 3.0 s of the video, encoded as AAC"),
     ("short.m4a", 1, "1.0 s, padded with silence to the 3.0 s of the video, encoded as AAC")],
)  # fmt: skip
def test_sound_is_cut_or_padded_to_the_video(
    tmp_path: Path, omnisyn: Omnisyn, name: str, seconds: int, fit: str
) -> None:
    words = pair_arguments(
        tmp_path, write_pair(tmp_path), "out.mp4", "--fps", 1, "--audio", sound(tmp_path / name, seconds)
    )
    assert omnisyn.json(*words, "--dry-run")["audio"] == str(tmp_path / name)
    assert omnisyn.made(*words).err == f"note: {name}: sound, {fit}\n"
    samples = heard(tmp_path / "out.mp4")
    assert len(samples) == pytest.approx(3 * 8000, abs=800)
    loud = np.abs(samples[:23600]).reshape(-1, 8).max(axis=1) > 0.01
    assert loud[:950].mean() > 0.9
    assert loud[1100:2800].mean() == pytest.approx(float(seconds > 3), abs=0.05)
    assert read_spherical(tmp_path / "out.mp4").has_version_2
    streams = re.findall(r"Stream #\S+ (\w+): (\w+)", ffmpeg("-i", tmp_path / "out.mp4"))
    assert streams == [("Video", "h264"), ("Audio", "aac")]


def test_what_has_no_sound_is_refused_before_any_frame(tmp_path: Path, omnisyn: Omnisyn) -> None:
    pair = write_pair(tmp_path)
    (tmp_path / "broken.wav").write_text("hello")
    ffmpeg("-f", "lavfi", "-i", "testsrc=d=1", tmp_path / "silent.mp4")
    for name, why in {
        "broken.wav": "got 'Error",
        "silent.mp4": "got a file without sound",
        "none.mp3": "no such",
    }.items():
        assert why in omnisyn.refused(*pair_arguments(tmp_path, pair, "out.mp4", "--audio", tmp_path / name))
    assert "expected a video for --audio" in omnisyn.refused(
        *pair_arguments(tmp_path, pair, "out", "--audio", sound(tmp_path / "a.wav", 1))[:-4],
        "--audio",
        tmp_path / "a.wav",
    )


def test_a_batch_names_sound_from_its_manifest(tmp_path: Path) -> None:
    write_pair(tmp_path)
    sound(tmp_path / "a.wav", 1)
    line = '{"id": "%s", "inputs": ["a.png", "b.png"], "poses": "poses.json", "audio": "%s"}\n'
    (tmp_path / "jobs.jsonl").write_text(line % ("one", "a.wav") + line % ("two", "b.wav"))
    manifest = read_manifest(tmp_path / "jobs.jsonl")
    assert [job.interpolation(tmp_path).audio for job in manifest.jobs] == [tmp_path / "a.wav"]
    assert "line 2: expected a file for audio, got no file" in manifest.problems[0]


def xmp(path: Path) -> bytes:
    """As another reader finds it."""
    with PIL.Image.open(path) as picture:
        packet = picture.info["xmp"]
    assert isinstance(packet, bytes)
    return packet


@pytest.fixture
def lost(tmp_path: Path) -> list[Path]:
    """A video with sound, and a picture, of 2:1 and without a word about it."""
    video, picture = tmp_path / "lost.mov", tmp_path / "lost.jpg"
    ffmpeg("-f", "lavfi", "-i", "testsrc=s=64x32:d=1", "-f", "lavfi", "-i", "sine=d=1", video)
    PIL.Image.effect_noise((64, 32), 50).save(picture)
    return [video, picture]


def test_tags_go_beside_and_change_nothing_else(lost: list[Path], omnisyn: Omnisyn) -> None:
    video = lost[0]
    before = [path.read_bytes() for path in lost]
    assert "flat" in omnisyn.made("tag", "--check", *lost).out
    assert [path.read_bytes() for path in lost] == before
    assert omnisyn.quiet("tag", *lost).out.count("tagged as 360°") == 2
    tagged = [path.with_stem("lost-360") for path in lost]
    assert [path.read_bytes() for path in lost] == before
    md5 = ["-map", "0", "-c", "copy", "-f", "md5", video.with_suffix(".md5")]
    sums = [ffmpeg("-i", path, *md5) and video.with_suffix(".md5").read_text() for path in (video, tagged[0])]
    assert sums[0] == sums[1]
    assert "Spherical Mapping: equirectangular" in ffmpeg("-i", tagged[0])
    scan = before[1].index(b"\xff\xda")
    assert tagged[1].read_bytes().endswith(before[1][scan:])
    packet = xmp(tagged[1])
    assert GPANO[1].encode() in packet
    for word in ('ProjectionType="equirectangular"', 'FullPanoWidthPixels="64"', 'CroppedAreaTopPixels="0"'):
        assert word.encode() in packet
    said = omnisyn.json("tag", "--check", *tagged)
    assert [each["tags"] for each in said] == [["version 1", "version 2"], ["GPano"]]
    assert all("360°" in each["players"][0] and "distorted" not in each["players"][0] for each in said)
    assert "got one that exists" in omnisyn.refused("tag", video)
    assert omnisyn.quiet("tag", *lost, "--in-place", "-q").out == ""
    assert [path.read_bytes() for path in lost] == [path.read_bytes() for path in tagged]


def test_what_would_be_distorted_or_cannot_be_tagged_is_refused(lost: list[Path], omnisyn: Omnisyn) -> None:
    video, picture = lost
    assert "expected 1:1 for top-bottom, got 64x32" in omnisyn.refused("tag", video, "--stereo", "top-bottom")
    assert "expected a video for --stereo" in omnisyn.refused("tag", picture, "--stereo", "top-bottom")
    assert "not overwritten" in omnisyn.refused("tag", video, "-o", video)
    assert "expected MP4, MOV or JPEG, got '.png'" in omnisyn.refused("tag", write_pair(video.parent)[0])
    PIL.Image.effect_noise((64, 20), 50).save(picture)
    assert "how much of the sphere" in omnisyn.refused("tag", picture)
    omnisyn.quiet("tag", picture, "--hfov", 360)
    assert b'CroppedAreaTopPixels="6"' in xmp(picture.with_stem("lost-360"))
    omnisyn.quiet("tag", video, "--stereo", "top-bottom", "--allow-aspect")
    assert "distorted" in omnisyn.made("tag", "--check", video.with_stem("lost-360")).out
