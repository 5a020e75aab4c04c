"""Frames become videos of the right colours, whole or not at all, and ffmpeg's words reach the user."""

import re
import struct
import subprocess
import sys
import threading
from contextlib import nullcontext
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from interpolation_samples import described_by_ffmpeg
from omnisyn_cli.errors import EncodingError, InputError, OmnisynError, OutputPathError, WriteError
from omnisyn_cli.io import check_output, check_video, open_video, read_panorama
from omnisyn_cli.io.boxes import children_of
from omnisyn_cli.io.encoders import CODECS, EncoderSettings, encoder_command
from omnisyn_cli.io.ffmpeg_process import EncoderProcess, read_frames

PATCHES = np.array(
    [[255, 0, 0], [0, 255, 0], [0, 0, 255], [250, 200, 30], [30, 60, 90], [128, 128, 128], [255, 255, 255], [0, 0, 0]],
    np.uint8,
)
FRAME = np.broadcast_to(np.repeat(PATCHES, 32, axis=0), (128, 256, 3))
KINDS = [("h264", ".mp4", "uint8"), ("h265", ".mp4", "uint8"), ("h265", ".mov", "uint16"), ("av1", ".mp4", "uint8"),
         ("av1", ".mp4", "uint16"), ("prores", ".mov", "uint8"), ("prores", ".mov", "uint16")]  # fmt: skip
FAST = {"h264": "ultrafast", "h265": "ultrafast", "av1": "12", "prores": "hq"}


def decoded(path: Path) -> np.ndarray:
    """Frames ``(count, 128, 256, 3)`` as a player that believes in BT.709 shows them."""
    return np.array(list(read_frames(path, (128, 256), 1000)), int)


@pytest.mark.parametrize(("codec", "suffix", "dtype"), KINDS)
def test_colours_survive_within_rounding_and_are_tagged_bt709(tmp_path, codec, suffix, dtype):
    path = tmp_path / f"-a 'b\" ü{suffix}"
    frame = FRAME if dtype == "uint8" else FRAME.astype(np.uint16) * 257
    with open_video(path, size=(128, 256), fps=25, codec=codec, preset=FAST[codec], dtype=dtype) as sink:
        for _ in range(3):
            sink.write(frame)
    centres = np.s_[:, 16:-16, 16::32]
    shown = decoded(path)
    assert len(shown) == sink.frame_count == 3
    assert np.abs(shown[centres] - FRAME[None].astype(int)[centres]).max() <= 3
    stream = described_by_ffmpeg(path)
    assert re.search(r"\(tv, bt709, progressive\), 256x128", stream)
    assert re.search(r"\b25 fps", stream)
    assert "Spherical Mapping: equirectangular" in stream
    assert ("hvc1" in stream) == (codec == "h265")
    assert list(tmp_path.iterdir()) == [path]


def content(path: Path, *kinds: bytes) -> bytes:
    """What is in the box of a file that these kinds lead to."""
    data = path.read_bytes()
    for kind in kinds:
        data = next(box.head for box in children_of(path, data).children or () if box.kind == kind)
    return data


MEDIA = (b"moov", b"trak", b"mdia")
SAMPLES = (*MEDIA, b"minf", b"stbl")


@pytest.mark.parametrize(("codec", "suffix"), [(name, end) for name, codec in CODECS.items() for end in codec.suffixes])
def test_whatever_is_offered_is_encoded_and_says_its_colours_and_its_shape(tmp_path, codec, suffix):
    path = tmp_path / f"a{suffix.upper()}"
    with open_video(path, size=(64, 128), fps=25, codec=codec, preset=FAST[codec]) as sink:
        for _ in range(2):
            sink.write(FRAME[:64, :128])
    (entry,) = children_of(path, content(path, *SAMPLES, b"stsd"), 8).children or ()
    boxes = {box.kind: box.head for box in children_of(path, entry.head, 78).children or ()}
    assert {b"colr", b"st3d", b"sv3d"} <= set(boxes)
    expected = b"nclc" if suffix == ".mov" else b"nclx"
    assert boxes[b"colr"][:10] == expected + struct.pack(">HHH", 1, 1, 1)


def test_frames_keep_their_order_and_count(tmp_path):
    with open_video(tmp_path / "a.mp4", size=(128, 256), fps=30000 / 1001, preset="ultrafast") as sink:
        for level in range(0, 240, 8):
            sink.write(np.full((128, 256, 3), level, np.uint8))
    means = decoded(tmp_path / "a.mp4").mean(axis=(1, 2, 3))
    np.testing.assert_allclose(means, np.arange(0, 240, 8), atol=2)
    assert "29.97 fps" in described_by_ffmpeg(tmp_path / "a.mp4")


RATES = {
    23.976: (24000, 1001), 23.98: (24000, 1001), 29.97: (30000, 1001), 30000 / 1001: (30000, 1001),
    47.95: (48000, 1001), 59.94: (60000, 1001), 119.88: (120000, 1001), Fraction(30000, 1001): (30000, 1001),
    24: (24, 1), 29.9: (299, 10), 29.98: (1499, 50), 12.5: (25, 2),
}  # fmt: skip


@pytest.mark.parametrize("fps", RATES)
def test_rates_of_television_are_exact_in_the_file(tmp_path, fps):
    with open_video(tmp_path / "a.mp4", size=(32, 64), fps=fps, preset="ultrafast") as sink:
        for _ in range(3):
            sink.write(np.zeros((32, 64, 3), np.uint8))
    (timescale,) = struct.unpack_from(">I", content(tmp_path / "a.mp4", *MEDIA, b"mdhd"), 12)
    count, samples, delta = struct.unpack(">III", content(tmp_path / "a.mp4", *SAMPLES, b"stts")[4:])
    assert (count, samples) == (1, 3)
    assert Fraction(timescale, delta) == Fraction(*RATES[fps])


def interrupted(path: Path, error: type[BaseException], *, overwrite: bool = False) -> None:
    with open_video(path, size=(32, 64), fps=10, overwrite=overwrite) as sink:
        sink.write(np.zeros((32, 64, 3), np.uint8))
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, OSError])
@pytest.mark.parametrize("name", ["a.mp4", "frames", "view_%04d.jpg"])
def test_an_interrupted_writer_leaves_nothing(tmp_path, error, name, monkeypatch):
    started: list[subprocess.Popen[bytes]] = []
    monkeypatch.setattr(EncoderProcess, "_started", lambda self, command: remembered(started, command))
    with pytest.raises(error):
        interrupted(tmp_path / name, error)
    assert not list(tmp_path.iterdir())
    assert all(process.returncode is not None for process in started)
    assert len(started) == (name == "a.mp4")
    assert not [thread for thread in threading.enumerate() if thread.name == "ffmpeg-stderr"]


def remembered(started: list[subprocess.Popen[bytes]], command: list[str]) -> subprocess.Popen[bytes]:
    started.append(subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE))
    return started[-1]


def test_a_failed_overwrite_keeps_the_former_file(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"former")
    with pytest.raises(RuntimeError):
        interrupted(tmp_path / "a.mp4", RuntimeError, overwrite=True)
    assert (tmp_path / "a.mp4").read_bytes() == b"former"


def fake_ffmpeg(folder: Path, script: str) -> list[str]:
    program = folder / "fake_ffmpeg.py"
    program.write_text(f"import sys\n{script}\n")
    return [sys.executable, str(program)]


def write_many(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str, count: int = 300) -> None:
    program = fake_ffmpeg(folder, script)
    monkeypatch.setattr("omnisyn_cli.io.encoders.encoder_command", lambda path, settings: [*program, str(path)])
    (folder / "out").mkdir()
    with open_video(folder / "out" / "a.mp4", size=(32, 64), fps=10) as sink:
        for _ in range(count):
            sink.write(np.zeros((32, 64, 3), np.uint8))


KILL = "import os, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_DFL)\nos.kill(os.getpid(), signal.{})"
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="no signals")


@pytest.mark.parametrize(
    ("script", "kind", "words"),
    [
        ("read(10)\nsys.exit('level 9.9 is not supported')", EncodingError, r"level 9\.9 is not supported"),
        (
            "read()\nopen(sys.argv[1], 'w').write('half')\nsys.exit('muxer lost its mind')",
            EncodingError,
            "lost its mind",
        ),
        ("read(10)\nsys.exit('av_interleaved_write_frame(): No space left on device')", WriteError, "No space left"),
        # a talkative one does not block
        (
            "read(1)\nsys.stderr.write('blah\\n' * 400_000)\nread()\nsys.exit('enough said')",
            EncodingError,
            "enough said",
        ),
        pytest.param(KILL.format("SIGKILL"), EncodingError, "ended by SIGKILL; where memory is short", marks=POSIX),
        pytest.param(KILL.format("SIGXFSZ"), WriteError, "a limit on files", marks=POSIX),
    ],
)
def test_what_an_encoder_says_at_its_end_reaches_the_user(tmp_path, monkeypatch, script, kind, words):
    with pytest.raises(kind, match=words):
        write_many(tmp_path, monkeypatch, f"read = sys.stdin.buffer.read\n{script}")
    assert not list((tmp_path / "out").iterdir())


def test_ffmpegs_real_words_reach_the_user(tmp_path):
    settings = EncoderSettings((32, 64), 10)
    command = ["nosuch" if word == "libx264" else word for word in encoder_command(tmp_path / "a.mp4", settings)]
    result = subprocess.run(command, input=b"", capture_output=True, text=False, check=False)
    assert result.returncode != 0
    assert b"nosuch" in result.stderr


def test_no_frame_is_an_error(tmp_path):
    for name in ("a.mp4", "frames"):
        with pytest.raises(EncodingError, match="expected a frame"), open_video(tmp_path / name, size=(2, 4), fps=9):
            pass
    assert not list(tmp_path.iterdir())


def test_frames_of_another_shape_are_refused(tmp_path):
    for name in ("a.mp4", "frames"):
        with (
            pytest.raises(ValueError, match="expected a frame"),
            open_video(tmp_path / name, size=(32, 64), fps=9) as sink,
        ):
            sink.write(np.zeros((64, 32, 3), np.uint8))
    with pytest.raises(ValueError, match="uint8"), open_video(tmp_path / "a.mp4", size=(32, 64), fps=9) as sink:
        sink.write(np.zeros((32, 64, 3), np.float32))


REFUSED = {
    "odd": ({"size": (31, 63)}, InputError, "63×31"),
    "rate": ({"fps": 0}, InputError, "frame rate"),
    "hardly any rate": ({"fps": 0.0004}, InputError, "frame rate from 0.001"),
    "undefined rate": ({"fps": float("nan")}, InputError, "frame rate"),
    "codec": ({"codec": "h266"}, InputError, "h264, h265, av1, prores"),
    "extension": ({"path": "a.mp4", "codec": "prores"}, OutputPathError, r"\.mov"),
    "unknown extension": ({"path": "a.mkv"}, OutputPathError, r"\.mp4 or"),
    "slip of the pen": ({"path": "a.mpx"}, OutputPathError, r"\.mp4 or .*got '\.mpx'; .*end its name with /"),
    "slip in a pattern": ({"path": "a_%d.pgn"}, OutputPathError, r"\.mp4 or"),
    "slip with a video codec": ({"path": "a.mvo", "codec": "prores"}, OutputPathError, r"\.mov for prores"),
    "version with a video codec": ({"path": "a.v2", "codec": "h265"}, OutputPathError, r"video\.mp4"),
    "other kind of image": ({"path": "a.gif", "codec": "png"}, OutputPathError, "folder for images"),
    "one image": ({"path": "a.png"}, OutputPathError, "frame number"),
    "folder for video": ({"path": "folder", "codec": "h264"}, OutputPathError, "video.mp4"),
    "video for images": ({"codec": "png"}, OutputPathError, "folder for images"),
    "pattern of another kind": ({"path": "a_%d.png", "codec": "jpg"}, OutputPathError, r"\.jpg"),
    "two numbers": ({"path": "a_%d_%d.png"}, OutputPathError, "got 2"),
    "quality": ({"crf": 99}, InputError, "0 .*to 51"),
    "quality of prores": ({"path": "a.mov", "codec": "prores", "crf": 9}, InputError, "no quality"),
    "preset": ({"preset": "warp"}, InputError, "ultrafast"),
    "type": ({"dtype": "uint16"}, InputError, "uint8 frames"),
    "no folder": ({"path": "none/a.mp4"}, OutputPathError, "create it first"),
    "no folder for frames": ({"path": "none/x/%d.png"}, OutputPathError, "create it first"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_work_is_refused_before_any_work(tmp_path, case):
    changes, error, words = REFUSED[case]
    arguments: dict[str, object] = {"size": (32, 64), "fps": 10, "path": "a.mp4", **changes}
    arguments["path"] = tmp_path / str(arguments["path"])
    with pytest.raises(error, match=words):
        check_video(**arguments)  # type: ignore[arg-type]
    with pytest.raises(error, match=words), open_video(**arguments):  # type: ignore[arg-type]
        pass
    assert not list(tmp_path.iterdir())


def test_existing_targets_are_kept_unless_told_otherwise(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"former")
    with pytest.raises(OutputPathError, match="allow overwriting"):
        check_output(tmp_path / "a.mp4")
    check_output(tmp_path / "a.mp4", overwrite=True)
    with pytest.raises(OutputPathError, match="folder"):
        check_output(tmp_path, overwrite=True)
    with open_video(tmp_path / "a.mp4", size=(32, 64), fps=10, overwrite=True) as sink:
        sink.write(np.zeros((32, 64, 3), np.uint8))
    assert "h264" in described_by_ffmpeg(tmp_path / "a.mp4")


@pytest.mark.parametrize(
    ("name", "codec", "first"),
    [("frames", None, "frames/000000.png"), ("f", "jpg", "f/000000.jpg"), ("v_%03d.exr", None, "v_000.exr"),
     ("100%_%d.png", None, "100%_0.png"), ("walk_1.5m", None, "walk_1.5m/000000.png"),
     ("frames.2024", "jpg", "frames.2024/000000.jpg"), ("frames.v2", None, "frames.v2/000000.png"),
     ("walk.final", "tif", "walk.final/000000.tif"), ("v_%02d", "jpg", "v_00.jpg")],
)  # fmt: skip
def test_frames_become_numbered_images(tmp_path, name, codec, first):
    with open_video(tmp_path / name, size=(32, 64), fps=10, codec=codec) as sink:
        for level in (10, 200):
            sink.write(np.full((32, 64, 3), level, np.uint8))
    np.testing.assert_allclose(read_panorama(tmp_path / first).image, 10 / 255, atol=1 / 255)
    assert len([file for file in tmp_path.rglob("*") if file.is_file()]) == 2


@pytest.mark.parametrize("name", ["a.mp4", "frames/000000.png"])
def test_what_appeared_in_the_meantime_is_kept_unless_told_otherwise(tmp_path, name):
    """As when one command is given twice: the second run to end does not replace what the first one made."""
    mine = tmp_path / name
    target = mine if mine.suffix == ".mp4" else mine.parent
    for overwrite in (False, True):
        writing = open_video(target, size=(128, 256), fps=30, overwrite=overwrite)
        with pytest.raises(OutputPathError, match="--overwrite") if not overwrite else nullcontext(), writing as sink:
            sink.write(FRAME)
            mine.parent.mkdir(exist_ok=True)
            mine.write_bytes(b"mine")
        assert (mine.read_bytes() == b"mine") is not overwrite
        assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine]


def test_overwriting_a_sequence_leaves_no_stale_frames_and_no_stranger_touched(tmp_path):
    stranger = tmp_path / "notes.txt"
    stranger.write_text("mine")
    for count, overwrite in ((5, False), (2, True)):
        with open_video(tmp_path / "f_%02d.png", size=(2, 4), fps=10, overwrite=overwrite) as sink:
            for _ in range(count):
                sink.write(np.zeros((2, 4, 3), np.uint8))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["f_00.png", "f_01.png", "notes.txt"]
    with pytest.raises(OutputPathError, match="got 2"):
        check_video(tmp_path / "f_%02d.png", size=(2, 4), fps=10)


def test_every_refusal_is_one_of_ours(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OmnisynError, match="got a file"):
        check_video(tmp_path / "file", size=(2, 4), fps=1)


def test_frames_of_a_video_can_be_read_again(tmp_path):
    with open_video(tmp_path / "a.mp4", size=(128, 256), fps=25, preset="ultrafast", crf=1) as sink:
        for _ in range(3):
            sink.write(FRAME)
    frames = list(read_frames(tmp_path / "a.mp4", (128, 256), 2))
    centres = np.s_[:, 16:-16, 16::32]
    assert np.abs(np.array(frames, int)[centres] - FRAME[None].astype(int)[centres]).max() <= 3
    assert (len(frames), len(list(read_frames(tmp_path / "a.mp4", (128, 256), 9)))) == (2, 3)
    with pytest.raises(EncodingError, match="ffmpeg can read"):
        list(read_frames(tmp_path / "none.mp4", (128, 256), 1))
