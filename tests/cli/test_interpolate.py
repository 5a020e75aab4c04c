"""``omnisyn interpolate``: what it prints where, what it leaves, and what it refuses without leaving anything."""

import json
import os
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import SIZE, STAGE_LINE, Omnisyn, folder_arguments, listing, pair_arguments, start_cli, write_pair
from interpolation_samples import described_by_ffmpeg, edit_poses, use_ffmpeg
from omnisyn_cli.cli import progress
from omnisyn_cli.io import open_video, read_spherical, write_image
from omnisyn_cli.poses.file import read_poses, write_poses
from process_limits import file_size_limit


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    return write_pair(tmp_path)


def test_a_video_a_line_on_stdout_and_one_about_its_confidence(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn
) -> None:
    before = set(listing(tmp_path))
    result = omnisyn.quiet(*pair_arguments(tmp_path, pair))
    first, second = result.out.splitlines()
    assert re.fullmatch(rf"{re.escape(str(tmp_path / 'out.mp4'))}: 3 frames of 32x16 in \d+\.\d s", first)
    assert second.startswith("confidence: high (")
    assert set(listing(tmp_path)) - before == {"out.mp4"}
    assert read_spherical(tmp_path / "out.mp4").projection == "equirectangular"


def test_quiet_prints_nothing_and_verbose_prints_seconds_on_stderr(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn
) -> None:
    assert omnisyn.quiet(*folder_arguments(tmp_path, pair, "-q")).out == ""
    verbose = omnisyn(*folder_arguments(tmp_path, pair, "-v", "--overwrite"))
    assert verbose.out.count("\n") == 2
    assert re.search(r"render: +\d+\.\d\d s", verbose.err)
    assert "2 photographs, 1 rendered, 0 shown again" in verbose.err
    assert re.search(r"triangles drawn: \d\.\d\d of \d\.\d\d million\ninfinitely far: 0%", verbose.err)


def test_json_on_stdout_has_the_plan_and_the_stages(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn) -> None:
    summary = json.loads(omnisyn.quiet(*pair_arguments(tmp_path, pair, "out.mp4", "--json")).out)
    assert {"decode", "depth", "mesh", "render", "fuse", "encode", "total"} <= set(summary["stages"])
    assert all(seconds >= 0 for seconds in summary["stages"].values())
    assert (summary["frames"], summary["size"], summary["path_metres"]) == (3, "32x16", 1.0)
    assert summary["inputs"] == [str(image) for image in pair]
    assert summary["frames_made"] == {"photographs": 2, "rendered": 1, "shown_again": 0}
    assert summary["infinitely_far"] == [{"first": 0, "share": 0.0}]
    assert all(entry["drawn"] <= entry["of"] for entry in summary["triangles"])


def test_a_dry_run_prints_the_plan_and_writes_nothing(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn) -> None:
    before = listing(tmp_path)
    arguments = pair_arguments(tmp_path, pair, "out.mp4", "--dry-run", "--save-depth", tmp_path / "depth")
    result = omnisyn.quiet(*arguments)
    lines = {"frames: 3", "encoder: h264 crf 17 preset ultrafast", "path metres: 1.0", "size: 32x16", "depth: file"}
    assert lines <= {line.strip() for line in result.out.splitlines()}
    assert re.search(r"memory mib: \d+", result.out)
    plan = omnisyn.json(*arguments)
    assert (plan["frames"], plan["depth"], plan["notes"]) == (3, "file", [])
    assert plan["memory_mib"] > 100
    assert listing(tmp_path) == before


def test_one_place_twice_is_noted_on_stderr_unless_quiet(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn) -> None:
    edit_poses(tmp_path, lambda panoramas: panoramas["b.png"].update(position=[0, 0, 0]))
    result = omnisyn.made(*folder_arguments(tmp_path, pair))
    assert result.err.startswith("note: a.png and b.png have the same position")
    assert result.err.count("\n") == 1
    assert omnisyn(*folder_arguments(tmp_path, pair, "--overwrite", "-q")).err == ""


@pytest.mark.parametrize(
    "names", [("with space.png", "ünï 日本.png"), ("-a.png", "--b.png"), ("50%d.png", "a'b\".png")]
)
def test_awkward_names_work(
    tmp_path: Path, omnisyn: Omnisyn, names: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_pair(tmp_path, names)
    monkeypatch.chdir(tmp_path)
    output = f"-{names[1]}.mp4"
    omnisyn.quiet("interpolate", "--poses", "poses.json", "-o", output, "--frames", 2, "--", *names)
    assert (tmp_path / output).stat().st_size > 0


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-400])


def as_jpeg(folder: Path) -> list[Path]:
    """The pair with a second panorama that is a JPEG cut short; decoders paint the rest grey and say nothing."""
    image = folder / "b.jpg"
    write_image(image, np.random.default_rng(0).integers(0, 255, (64, 128, 3), np.uint8))
    truncate(image)
    edit_poses(folder, lambda panoramas: panoramas.update({"b.jpg": panoramas.pop("b.png")}))
    return [folder / "a.png", image]


SCALED = {"position": [0, 0, -1], "matrix": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}


def undefined_pose(folder: Path) -> None:
    text = (folder / "poses.json").read_text()
    (folder / "poses.json").write_text(text.replace("[0.0, 0.0, -1.0]", "[0.0, NaN, -1.0]"))


BAD_INPUT: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "missing panorama": (lambda folder: (folder / "b.png").unlink(), ["b.png: expected a file, got no such file"]),
    "truncated PNG": (lambda folder: truncate(folder / "b.png"), ["b.png: expected a complete image"]),
    "truncated JPEG": (as_jpeg, ["b.jpg: expected a complete image"]),
    "no image": (lambda folder: (folder / "b.png").write_text("hello"), ["b.png: expected an image"]),
    "empty image": (lambda folder: (folder / "b.png").write_bytes(b""), ["got an empty file"]),
    "not 2:1": (
        lambda folder: write_image(folder / "b.png", np.zeros((32, 32, 3), np.uint8)),
        ["b.png", "twice as wide as high, got 32×32"],
    ),
    "no pose": (
        lambda folder: edit_poses(folder, lambda all_: all_.update({"bb.png": all_.pop("b.png")})),
        ["expected an entry for 'b.png'", "did you mean 'bb.png'?"],
    ),
    "not rigid": (lambda folder: edit_poses(folder, lambda all_: all_.update({"b.png": SCALED})),
                  ["'b.png'.matrix: expected a rigid rotation", "remove scale and shear"]),
    "NaN pose": (undefined_pose, ["poses.json: expected finite numbers, got NaN"]),
    "no JSON": (lambda folder: (folder / "poses.json").write_text("{"), ["poses.json: expected JSON"]),
    "missing poses": (lambda folder: (folder / "poses.json").unlink(), ["poses.json: expected a pose file"]),
    "unknown key": (lambda folder: edit_poses(folder, lambda all_: all_["b.png"].update(rotatoin=1)), ["rotatoin"]),
    "missing depth": (lambda folder: (folder / "depth1.exr").unlink(), ["depth1.exr: expected a file"]),
    "truncated depth": (lambda folder: truncate(folder / "depth1.exr"), ["depth1.exr: expected"]),
    "depth is a photograph": (
        lambda folder: edit_poses(folder, lambda panoramas: panoramas["b.png"].update(depth="a.png")),
        ["a.png: expected depth"],
    ),
    "output exists": (lambda folder: (folder / "out.mp4").write_text("mine"), ["out.mp4: expected a new file"]),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_one_line_code_3_and_nothing_written(tmp_path: Path, omnisyn: Omnisyn, case: str) -> None:
    spoil, words = BAD_INPUT[case]
    images = write_pair(tmp_path)
    changed = spoil(tmp_path)
    result = omnisyn.refused(*pair_arguments(tmp_path, changed if isinstance(changed, list) else images))
    assert result.startswith("omnisyn: ")
    for word in ("expected", "got", *words):
        assert word in result


BAD_OUTPUT = {
    "no folder": (["none/out.mp4"], "expected an existing folder to write into, got none"),
    "unknown ending": (["out.avi"], "expected a name ending in .mp4"),
    "slip of the pen": (["clip.mpx"], "got '.mpx'; change the name or the codec (a folder of frames: end its name"),
    "one image": (["out.png"], "add a frame number such as %06d"),
    "codec of another container": (["out.mp4", "--codec", "prores"], r".mov"),
    "images in a video": (["out.mp4", "--codec", "png"], "name a folder for images"),
    "quality": (["out.mp4", "--crf", "99"], "expected a quality from 0 (largest file) to 51"),
    "speed": (["out.mp4", "--encoder-preset", "warp"], "expected a preset among"),
    "too few frames": (["out.mp4", "--frames", "2"], "expected at least 3 frames"),
    "endless": (["out.mp4", "--duration", "1e9", "--fps", "30"], "at most 1,000,000 frames"),
    "frames into a video": (["out.mp4", "--save-frames", "b.mp4"], "expected a folder or a pattern"),
    "no folder for depth": (["out.mp4", "--save-depth", "none/depth"], "create it first"),
}


FOLDERS = {
    "walk_1.5m": ("walk_1.5m", "--codec", "png"), "walk.final": ("walk.final", "--codec", "png"),
    "frames.v2": ("frames.v2/",), "frames.mp4": ("frames.mp4/",),
    "frames.2024": ("out", "--save-frames", "frames.2024"), "frames.new": ("out", "--save-frames", "frames.new/"),
}  # fmt: skip


@pytest.mark.parametrize("folder", FOLDERS)
def test_folders_may_have_a_dot_in_their_names(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["interpolate", *pair, "--poses", "poses.json", "--frames", 3, "--threads", 1, "-o", *FOLDERS[folder]]
    assert omnisyn.json(*arguments, "--dry-run")["encoder"] == "png images"
    assert not (tmp_path / folder).exists()
    omnisyn.made(*arguments)
    assert set(listing(tmp_path / folder)) == {f"00000{k}.png" for k in range(3)}


def test_notes_about_a_plan_are_said_once(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn) -> None:
    arguments = pair_arguments(tmp_path, [pair[0], pair[0]], "out.mp4", "--dry-run")
    result = omnisyn(*arguments)
    assert "note: " in result.err
    assert (result.out + result.err).count("there is no parallax to follow") == 1
    assert "no parallax" in "".join(omnisyn.json(*arguments)["notes"])


def test_help_warns_of_a_quality_that_few_players_play(tmp_path: Path, omnisyn: Omnisyn) -> None:
    """At 0 x264 leaves the profiles that players know; right above it does not."""
    words = omnisyn("interpolate", "--help-all").out.split()
    assert "h264 at 0 is lossless, which few players support" in " ".join(words)
    for crf, profile in ((0, "High 4:4:4 Predictive"), (1, "High")):
        with open_video(tmp_path / f"{crf}.mp4", size=(32, 64), fps=25, crf=crf) as sink:
            sink.write(np.full((32, 64, 3), 9, np.uint8))
        assert f"h264 ({profile})" in described_by_ffmpeg(tmp_path / f"{crf}.mp4")


@pytest.mark.parametrize(
    ("more", "words"),
    [(("--cut", 0.1, "--cut-metres", 2), "expected --cut or --cut-metres, got both; leave one of them out"),
     (("--fps", "30/0"), "--fps")],
)  # fmt: skip
def test_wrong_usage_leaves_nothing(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, more: tuple[object, ...], words: str
) -> None:
    assert words in omnisyn.misused(*folder_arguments(tmp_path, pair, *more))


@pytest.mark.parametrize("case", BAD_OUTPUT)
def test_unusable_outputs_are_refused_before_any_work(
    tmp_path: Path, omnisyn: Omnisyn, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, words = BAD_OUTPUT[case]
    images = write_pair(tmp_path, ("a.png", "b.png", "c.png"))
    monkeypatch.chdir(tmp_path)
    frames = [] if case == "endless" else ["--frames", "3"]
    assert words in omnisyn.refused("interpolate", *images, "--poses", "poses.json", *frames, "-o", *arguments)


def test_a_read_only_folder_is_refused(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK)
    assert "expected a writable folder, got a read-only one" in omnisyn.refused(*pair_arguments(tmp_path, pair))


def test_overwriting_has_to_be_allowed_and_replaces_only_the_output(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn
) -> None:
    for more, code in (((), 0), ((), 3), (("--overwrite",), 0)):
        assert omnisyn(*folder_arguments(tmp_path, pair, *more)).code == code
    (tmp_path / "out" / "notes.txt").write_text("mine")
    omnisyn.made(*folder_arguments(tmp_path, pair, "--overwrite"))
    assert set(listing(tmp_path / "out")) == {"000000.png", "000001.png", "000002.png", "notes.txt"}


ENCODER_FAILURES = {
    "at the start": ("sys.exit('level 9.9 is not supported')", "level 9.9 is not supported"),
    "in the middle": ("sys.stdin.buffer.read(2000)\nsys.exit('lost my mind')", "lost my mind"),
    "at the end": ("sys.stdin.buffer.read()\nsys.exit('cannot write the index')", "cannot write the index"),
    "full disk": (
        "sys.stdin.buffer.read()\nsys.exit('[mp4 @ 0x1] x\\n[out#0] Error: No space left on device')",
        "expected room for the video, got 'No space left on device'; free some space",
    ),
    "without a word": ("sys.exit(7)", "got exit code 7"),
    "missing": ("", "expected an ffmpeg with libx264"),
}


@pytest.mark.parametrize("case", ENCODER_FAILURES)
def test_a_failing_encoder_is_code_1_with_its_own_words_and_no_file(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    script, words = ENCODER_FAILURES[case]
    use_ffmpeg(monkeypatch, tmp_path, script, "libx265" if case == "missing" else "libx264")
    more = ("--save-frames", tmp_path / "frames", "--save-depth", tmp_path / "depth", "--frames", 9)
    assert words in omnisyn.refused(*pair_arguments(tmp_path, pair, "out.mp4", *more), code=1)


@pytest.mark.parametrize("setting", ["NUMBA_NUM_THREADS=0", "NUMBA_DISABLE_JIT=1"])
def test_settings_that_kernels_cannot_work_with_are_named(tmp_path: Path, pair: list[Path], setting: str) -> None:
    name, _, value = setting.partition("=")
    process = start_cli(*folder_arguments(tmp_path, pair, "-q"), folder=tmp_path, **{name: value})
    err = process.communicate(timeout=300)[1].decode()
    assert (process.returncode, err.count("\n")) == (3, 1)
    assert "NUMBA_" in err


def test_memory_that_is_short_is_said_before_the_work(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "memory_limit", lambda: 10**8)
    assert "GB of memory, got a limit of 0.1;" in omnisyn.made(*folder_arguments(tmp_path, pair, "--dry-run")).err
    monkeypatch.undo()
    assert "got a limit" not in omnisyn.made(*folder_arguments(tmp_path, pair, "--dry-run")).err


def test_a_folder_that_is_called_like_a_video_is_no_place_for_images(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn
) -> None:
    """Unless a slash says that it is meant."""
    (tmp_path / "walk.mp4").mkdir()
    words = folder_arguments(tmp_path, pair)
    at = words.index("-o") + 1
    assert "expected a file name, got a folder" in omnisyn.refused(*words[:at], tmp_path / "walk.mp4", *words[at + 1 :])
    omnisyn.made(*words[:at], f"{tmp_path / 'walk.mp4'}/", *words[at + 1 :])
    assert len(list((tmp_path / "walk.mp4").iterdir())) == 3


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limits there")
@pytest.mark.parametrize("kind", ["frames", "depth"])
def test_a_full_disk_is_code_1_and_one_line(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, kind: str) -> None:
    more = ["--size", "128x64"] if kind == "frames" else ["--save-depth", tmp_path / "depth", "--size", "8x4"]
    omnisyn(*folder_arguments(tmp_path, pair, *more))  # kernels are compiled and kept while there is room
    for made in ("out", "depth"):
        shutil.rmtree(tmp_path / made, ignore_errors=True)
    with file_size_limit(900 if kind == "frames" else 250):
        assert "check free space" in omnisyn.refused(*folder_arguments(tmp_path, pair, *more), code=1)


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals there")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)], ids=["INT", "TERM", "HUP"]
)
def test_a_signal_in_the_middle_leaves_nothing(tmp_path: Path, pair: list[Path], number: int, code: int) -> None:
    before = listing(tmp_path)
    more = ("--frames", 20_000, "--save-frames", tmp_path / "frames", "--save-depth", tmp_path / "depth")
    process = start_cli(*pair_arguments(tmp_path, pair, "out.mp4", *more), folder=tmp_path)
    try:
        deadline = time.monotonic() + 600
        for half_done in (".omnisyn-*/000004.png", ".omnisyn-*.mp4"):
            while not list(tmp_path.glob(half_done)):
                assert process.poll() is None, process.communicate()
                assert time.monotonic() < deadline
                time.sleep(0.02)
        process.send_signal(number)
        out, err = process.communicate(timeout=600)
    finally:
        process.kill()
    assert (process.returncode, out) == (code, b"")
    assert STAGE_LINE.sub("", err.decode()).strip().count("\n") == 0
    assert b"nothing was left half written" in err
    assert listing(tmp_path) == before


def test_panoramas_of_16_bits_may_become_any_kind_of_frame(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn) -> None:
    entries = read_poses(tmp_path / "poses.json").panoramas
    deep = tmp_path / "deep.png"
    write_image(deep, np.full((*SIZE, 3), 30_000, np.uint16))
    write_poses(tmp_path / "poses.json", {**entries, "deep.png": entries["b.png"]})
    for codec in ("png", "jpg", "exr", "tif"):
        more = ("-o", tmp_path / codec, "--codec", codec, "--overwrite", "-q")
        omnisyn.quiet(*folder_arguments(tmp_path, [pair[0], deep], *more))
        assert set(listing(tmp_path / codec)) == {f"00000{k}.{codec}" for k in range(3)}
