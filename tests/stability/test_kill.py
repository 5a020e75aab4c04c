"""``kill -9`` at any moment, and no room left: nothing broken has a final name, and what was there before stays."""

import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

import omnisyn_cli
from cli.cli_samples import Omnisyn
from omnisyn_cli.errors import WriteError
from omnisyn_cli.io import read_depth, read_panorama, write_image
from omnisyn_cli.io.placement import Reading
from process_limits import file_size_limit
from synthesis_samples import as_bytes, posed, write_hall

SOURCES = str(Path(omnisyn_cli.__file__).parents[1])
TESTS = str(Path(__file__).resolve().parents[1])
LONGEST = 300.0  # Seconds that a small command may take on a busy machine.


def command_line(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "omnisyn_cli", *map(str, arguments)]


def start(command: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
    """A process in a folder, with the package of this checkout."""
    path = os.pathsep.join([SOURCES, TESTS, str(Path(TESTS) / "training")])
    variables = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, cwd=folder, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def finish(command: Sequence[str], folder: Path) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command that is left in peace."""
    with start(command, folder) as process:
        out, err = process.communicate(timeout=LONGEST)
        return process.returncode, out.decode(), err.decode()


def kill_after(command: Sequence[str], folder: Path, seconds: float) -> bool:
    """Start a command and ``kill -9`` it; whether it was still at work then."""
    with start(command, folder) as process:
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return True
        process.communicate()
        return False


def duration(command: Sequence[str], folder: Path) -> float:
    """Seconds that a command takes here and now; it has to succeed."""
    begin = time.monotonic()
    code, _, err = finish(command, folder)
    assert code == 0, err
    return time.monotonic() - begin


def visible_files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder that has a final name: neither it nor a folder above it is hidden or partial."""
    found = {}
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if path.is_file() and not any(part.startswith(".") or part.endswith(".partial") for part in parts):
            found["/".join(parts)] = path.read_bytes()
    return found


pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="neither SIGKILL nor file size limits there")
ROOM = Path(__file__).parents[2] / "examples" / "room"
TRAIN = """
import sys
from pathlib import Path
from training_samples import TINY
from omnisyn_cli.training.loop import train
from omnisyn_cli.training.tasks import TrainConfig
pools = {"pool": sys.argv[1], "validation_pool": sys.argv[1]}
config = TrainConfig(**pools, size=(64, 128), batch=1, validate_every=2, save_every=1)
print(train(TINY, config, Path(sys.argv[2]), steps=6).step)
"""


@dataclass(frozen=True)
class Case:
    prepare: Callable[[Path], object]  # makes its inputs in a folder
    command: list[str]  # of a fresh run
    again: list[str]  # of one after a kill; without --overwrite where nothing or everything is there then
    is_same_bytes: bool = True  # whether equal runs write equal files


def _hall(folder: Path) -> None:
    write_hall(folder, [posed((0, 0, 0.4)), posed((0.2, 0, -0.4), 0.3)], (32, 64))


def _scenes(folder: Path) -> None:
    for index in range(2):
        scene = folder / "scenes" / f"s{index}"
        scene.mkdir(parents=True)
        write_hall(scene, [posed((0, 0, 0.5 - 0.25 * at)) for at in range(5)], (32, 64))


def _photographs(folder: Path) -> None:
    for name in ("first", "second"):
        image = read_panorama(ROOM / f"{name}.jpg", reading=Reading(size=(128, 256))).image
        write_image(folder / f"{name}.png", as_bytes(image))


def _jobs(folder: Path) -> None:
    _hall(folder)
    common = {"inputs": ["p0.png", "p1.png"], "poses": "poses.json", "encoder_preset": "ultrafast"}
    jobs = [{"id": f"j{frames}", "frames": frames, **common} for frames in (3, 4)]
    (folder / "jobs.jsonl").write_text("".join(json.dumps(job) + "\n" for job in jobs))


def _pool(folder: Path) -> None:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "training"))
    from training_samples import make_pool

    make_pool(folder / "pool")


INTERPOLATE = command_line(
    "interpolate", "p0.png", "p1.png", "--poses", "poses.json", "-o", "out.mp4", "--frames", 12, "--threads", 1,
    "--save-frames", "frames", "--save-depth", "depth", "--encoder-preset", "ultrafast", "-q",
)  # fmt: skip
MAKE = command_line("scenes", "make", "out", "--count", 2, "--size", "128x64", "--frames", 2, "--threads", 1, "-q")
EVAL = command_line("eval", "scenes", "--report", "report", "--methods", "crossfade,oracle-depth", "--threads", 1, "-q")
PAIR = ("p0.png", "p1.png", "--poses", "poses.json", "--threads", 1, "-q")
EXPORT = command_line("export", *PAIR, "-o", "out", "--format", "colmap")
VIEW = command_line("view", *PAIR, "-o", "walk.html")
FOLDER = command_line("view", *PAIR, "-o", "walk", "--folder")
FRAMES = command_line("interpolate", *PAIR, "-o", "frames", "--frames", 12)
ESTIMATE = command_line("poses", "estimate", "first.png", "second.png", "--baseline", 1, "-o", "poses.json", "-q")
BATCH = command_line("batch", "jobs.jsonl", "-o", "out", "--workers", 1, "-q")
CASES = {
    "export": Case(_hall, EXPORT, EXPORT), "frames": Case(_hall, FRAMES, FRAMES),
    "poses estimate": Case(_photographs, ESTIMATE, ESTIMATE), "batch": Case(_jobs, BATCH, BATCH, is_same_bytes=False),
    "view": Case(_hall, VIEW, VIEW), "view --folder": Case(_hall, FOLDER, FOLDER),
    "interpolate": Case(_hall, INTERPOLATE, [*INTERPOLATE, "--overwrite"]),
    "scenes make": Case(lambda folder: None, MAKE, [*MAKE, "--overwrite"]),
    "eval": Case(_scenes, EVAL, EVAL, is_same_bytes=False),
    "train": Case(_pool, *[[sys.executable, "-c", TRAIN, "pool", "run"]] * 2, is_same_bytes=False),
}  # fmt: skip


def check_whole(name: str, content: bytes, path: Path) -> None:
    """A file under its final name can be read to its end."""
    if path.suffix == ".png":
        assert read_panorama(path, allow_aspect=True).image.size
    elif path.suffix == ".exr":
        assert read_depth(path).size
    elif path.suffix == ".json":
        json.loads(content)
    elif path.suffix == ".jsonl":
        for line in content.split(b"\n")[:-1]:
            json.loads(line)
    elif path.suffix == ".pt":
        import torch

        assert torch.load(path, weights_only=True)["step"] > 0
    else:
        assert path.suffix in (".html", ".md", ".csv", ".tex"), f"{name}: what is this?"
        assert content


def check_killed(case: Case, folder: Path, expected: dict[str, bytes]) -> None:
    """What a killed run has left is what the whole run leaves, as far as it is there."""
    for name, content in visible_files(folder).items():
        if name in expected and (case.is_same_bytes or content == expected[name]):
            assert content == expected[name], f"{name} differs from that of an undisturbed run"
        else:
            assert not case.is_same_bytes, f"{name} is not there after an undisturbed run"
            check_whole(name, content, folder / name)


def kill_and_repeat(case: Case, place: Path, kills: int, seed: int) -> None:
    """However often a run is killed, the last one makes what an undisturbed one makes; it ends before: less time."""
    calm, disturbed = place / "calm", place / "disturbed"
    for folder in (calm, disturbed):
        folder.mkdir()
        case.prepare(folder)
    seconds = duration(case.command, calm)
    expected = visible_files(calm)
    rng = random.Random(seed)  # noqa: S311 - the moments shall be the same again
    while kills:
        was_at_work = kill_after(case.again, disturbed, rng.uniform(0.3, 1.0) * seconds)
        check_killed(case, disturbed, expected)
        kills -= was_at_work
        if not was_at_work:
            seconds *= 0.8
            shutil.rmtree(disturbed)
            disturbed.mkdir()
            case.prepare(disturbed)
    is_complete = visible_files(disturbed).keys() == expected.keys()
    code, _, err = finish(case.again, disturbed)
    assert code == 0 or (is_complete and "--overwrite" in err), err
    found = visible_files(disturbed)
    assert set(found) == set(expected)
    if case.is_same_bytes:
        assert found == expected


@pytest.mark.parametrize("name", ["interpolate", "scenes make", "export"])
def test_a_killed_run_leaves_nothing_broken_and_a_second_one_finishes(tmp_path: Path, name: str) -> None:
    kill_and_repeat(CASES[name], tmp_path, kills=2, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_ten_kills_at_random_moments(tmp_path: Path, name: str) -> None:
    kill_and_repeat(CASES[name], tmp_path, kills=10, seed=2)


def test_scenes_need_room(tmp_path: Path, omnisyn: Omnisyn) -> None:
    make = ("scenes", "make", tmp_path / "out", "--size", "64x32", "--frames", 2, "--threads", 1, "-q")
    omnisyn.made(*make)
    before = visible_files(tmp_path)
    with file_size_limit(300):
        assert "check free space" in omnisyn.refused(*make, "--overwrite", "--seed", 1, code=1)
    assert visible_files(tmp_path) == before


def test_an_evaluation_needs_room(tmp_path: Path, omnisyn: Omnisyn) -> None:
    scene = tmp_path / "scenes" / "a"
    scene.mkdir(parents=True)
    write_hall(scene, [posed((0, 0, 0.5 - 0.25 * at)) for at in range(5)], (32, 64))
    run = ("eval", tmp_path / "scenes", "--report", tmp_path / "report", "--methods", "crossfade", "--threads", 1, "-q")
    with file_size_limit(200):
        failed = omnisyn.ended(1, *run)
    assert (failed.out, failed.err.count("\n")) == ("", 1)
    assert "check free space" in failed.err
    omnisyn.made(*run)
    assert (tmp_path / "report" / "report.html").is_file()


def test_a_checkpoint_needs_room_and_the_former_one_stays(tmp_path: Path) -> None:
    import torch

    from omnisyn_cli.training.checkpoint import load_checkpoint, save_checkpoint

    path = tmp_path / "checkpoint.pt"
    state = {"kind": "depth", "network": {}, "training": {}, "step": 1, "average": {}}
    save_checkpoint(path, state)
    with file_size_limit(20_000), pytest.raises(WriteError, match="check free space") as caught:
        save_checkpoint(path, {**state, "step": 2, "weights": torch.zeros(100_000)})
    assert "\n" not in str(caught.value)
    assert load_checkpoint(path)["step"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
