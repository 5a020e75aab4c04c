"""``interpolate --audio`` and ``omnisyn tag``: sound as long as the video, metadata without another byte changed."""

from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from cli.cli_samples import Omnisyn, pair_arguments, write_pair
from interpolation_samples import ffmpeg
from omnisyn_cli.batch.manifest import read_manifest
from omnisyn_cli.io import read_spherical


def sound(path: Path, seconds: float) -> Path:
    ffmpeg("-f", "lavfi", "-i", f"sine=440:d={seconds}", path)
    return path


@pytest.mark.parametrize(
    ("name", "seconds", "fit"),
    [("long.m4a", 9, "9.0 s, cut to the 3.0 s of the video, copied"),
     ("long.wav", 9, "9.0 s, cut to the 3.0 s of the video, encoded as AAC"),
     ("short.m4a", 1, "1.0 s, padded with silence to the 3.0 s of the video, encoded as AAC")],
)  # fmt: skip
def test_sound_is_cut_or_padded_to_the_video(
    tmp_path: Path, omnisyn: Omnisyn, name: str, seconds: int, fit: str
) -> None:
    audio, video = sound(tmp_path / name, seconds), tmp_path / "out.mp4"
    words = pair_arguments(tmp_path, write_pair(tmp_path), "out.mp4", "--fps", 1, "--audio", audio)
    assert omnisyn.json(*words, "--dry-run")["audio"] == str(audio)
    assert omnisyn.made(*words).err == f"note: {name}: sound, {fit}\n"
    samples = np.frombuffer(
        ffmpeg("-i", video, "-map", "0:a:0", "-ac", 1, "-ar", 8000, "-f", "f32le", "-").stdout, "<f4"
    )
    assert len(samples) == pytest.approx(3 * 8000, abs=800)
    loud = np.abs(samples[:23600]).reshape(-1, 8).max(axis=1) > 0.01
    assert loud[:950].mean() > 0.9
    assert loud[1100:2800].mean() == pytest.approx(float(seconds > 3), abs=0.05)
    assert read_spherical(video).has_version_2
    assert b"Audio: aac" in ffmpeg("-i", video).stderr


def test_what_has_no_sound_is_refused_before_any_frame(tmp_path: Path, omnisyn: Omnisyn) -> None:
    pair = write_pair(tmp_path)
    (tmp_path / "broken.wav").write_text("hello")
    ffmpeg("-f", "lavfi", "-i", "testsrc=d=1", tmp_path / "silent.mp4")
    for name, why in {"broken.wav": "got 'Error", "silent.mp4": "a file without sound", "none.mp3": "no such"}.items():
        assert why in omnisyn.refused(*pair_arguments(tmp_path, pair, "out.mp4", "--audio", tmp_path / name))
    line = '{"id": "%s", "inputs": ["a.png", "b.png"], "poses": "poses.json", "audio": "%s"}\n'
    (tmp_path / "jobs.jsonl").write_text(line % ("one", "silent.mp4") + line % ("two", "none.mp3"))
    manifest = read_manifest(tmp_path / "jobs.jsonl")
    assert [job.interpolation(tmp_path).audio for job in manifest.jobs] == [tmp_path / "silent.mp4"]
    assert "line 2: expected a file for audio, got no file" in manifest.problems[0]


@pytest.fixture
def lost(tmp_path: Path) -> list[Path]:
    """A video with sound, and a picture, of 2:1 and without a word about it."""
    video, picture = tmp_path / "lost.mov", tmp_path / "lost.jpg"
    ffmpeg("-f", "lavfi", "-i", "testsrc=s=64x32:d=1", "-f", "lavfi", "-i", "sine=d=1", video)
    PIL.Image.effect_noise((64, 32), 50).save(picture)
    return [video, picture]


def xmp(path: Path) -> str:
    """As another reader finds it."""
    with PIL.Image.open(path) as picture:
        return str(picture.info["xmp"], "utf-8")


def test_tags_go_beside_and_change_nothing_else(lost: list[Path], omnisyn: Omnisyn) -> None:
    before = [path.read_bytes() for path in lost]
    assert omnisyn.made("tag", "--check", *lost).out.count("flat, as nothing says") == 2
    assert omnisyn.quiet("tag", *lost).out.count("tagged as 360°") == 2
    assert [path.read_bytes() for path in lost] == before
    video, picture = tagged = [path.with_stem("lost-360") for path in lost]
    sums = [ffmpeg("-i", path, "-map", 0, "-c", "copy", "-f", "md5", "-").stdout for path in (lost[0], video)]
    assert sums[0].startswith(b"MD5=")
    assert sums[0] == sums[1]
    assert "Spherical Mapping: equirectangular" in str(ffmpeg("-i", video).stderr)
    assert picture.read_bytes().endswith(before[1][before[1].index(b"\xff\xda") :])
    for word in ('ProjectionType="equirectangular"', 'FullPanoWidthPixels="64"', 'CroppedAreaTopPixels="0"'):
        assert word in xmp(picture)
    said = omnisyn.json("tag", "--check", *tagged)
    assert [each["tags"] for each in said] == [["version 1", "version 2"], ["GPano"]]
    assert all(each["players"][0].partition(": ")[2] in ("360°", "360°, mono") for each in said)
    assert "got one that exists" in omnisyn.refused("tag", lost[0])
    omnisyn.quiet("tag", *lost, "--in-place", "-q")
    assert [path.read_bytes() for path in lost] == [path.read_bytes() for path in tagged]


def test_what_would_be_distorted_or_cannot_be_tagged_is_refused(lost: list[Path], omnisyn: Omnisyn) -> None:
    video, picture = lost
    assert "expected 1:1 for top-bottom, got 64x32" in omnisyn.refused("tag", video, "--stereo", "top-bottom")
    assert "expected a video for --stereo" in omnisyn.refused("tag", picture, "--stereo", "top-bottom")
    assert "not overwritten" in omnisyn.refused("tag", video, "-o", video)
    assert "got '.png'" in omnisyn.refused("tag", write_pair(video.parent)[0])
    PIL.Image.effect_noise((64, 20), 50).save(picture)
    assert "how much of the sphere" in omnisyn.refused("tag", picture)
    omnisyn.quiet("tag", picture, "--hfov", 360)
    assert 'CroppedAreaTopPixels="6"' in xmp(picture.with_stem("lost-360"))
    omnisyn.quiet("tag", video, "--stereo", "top-bottom", "--allow-aspect")
    assert "distorted" in omnisyn.made("tag", "--check", video.with_stem("lost-360")).out
