"""A 360° video as input: frames of it become panoramas, squeezed ones are stretched, and nothing is left behind."""

import os
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli.cli_samples import Omnisyn, listing
from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation import summary
from omnisyn_cli.io import open_video, read_header
from omnisyn_cli.io.ffmpeg_process import frames_of_video
from omnisyn_cli.io.outputs import temporary_name
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

SIZE = (216, 384)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds along a street, a picture a second, squeezed to 16:9."""
    path = tmp_path_factory.mktemp("video") / "walk.mp4"
    scene = generate_scene("street", 101)
    with open_video(path, size=SIZE, fps=2, crf=8) as sink:
        for pose in sample_path(scene, 101, 4):
            image, _ = render_panorama(scene, pose, (192, 384), threads=2)
            frame = cv2.resize(np.rint(image * 255).astype(np.uint8), SIZE[::-1], interpolation=cv2.INTER_CUBIC)
            sink.write(frame)
            sink.write(frame)
    return path


def test_frames_come_every_so_many_seconds_and_are_gone_afterwards(video: Path) -> None:
    for seconds, count in ((1.0, 4), (2.0, 2), (0.5, 8)):
        with frames_of_video(video, seconds) as frames:
            assert len(frames) == count
            assert (read_header(frames[0]).height, read_header(frames[0]).width) == SIZE
        assert not any(frame.exists() for frame in frames)
    with pytest.raises(InputError, match="more than 9 s, got one frame"), frames_of_video(video, 9.0):
        pass


def test_a_video_between_frames_of_a_video(
    video: Path, tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"  # of its own: other tests run beside this one and clean up behind themselves
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    left = Path(str(temporary_name(temporary)).replace(f"-{os.getpid()}-", "-99999999-"))
    left.mkdir()  # by a run that was killed
    monkeypatch.setattr(summary, "CONFIDENCE_WORDS", ((1.1, "high"), (0.0, "low")))
    out = tmp_path / "out"
    out.mkdir()
    result = omnisyn.made("interpolate", video, "--every", "2s", "-o", out / "out.mp4", "--frames", 3,
                          "--size", "64x32", "--preset", "fast", "--threads", 2)  # fmt: skip
    assert "to try: " in result.out
    assert result.err.count(".omnisyn-") == 1
    assert f"remove them with: rm -r {left}\n" in result.err
    assert ".omnisyn-" not in result.out  # no command that names frames that are gone
    assert "16:9, taken for squeezed frames of a 360° video" in result.err
    assert list(listing(out)) == ["out.mp4"]
    assert list(temporary.iterdir()) == [left]


def test_videos_and_the_option_go_together(video: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    assert "add --every 2s" in omnisyn.refused("interpolate", video)
    assert "leave --every out" in omnisyn.refused("interpolate", tmp_path, "--every", 2)
    assert "not overwritten" in omnisyn.refused("interpolate", video, "--every", 2, "-o", video, "--overwrite")
    (tmp_path / "broken.mp4").write_bytes(b"nothing")
    assert "expected a video" in omnisyn.refused("interpolate", tmp_path / "broken.mp4", "--every", "1s")
