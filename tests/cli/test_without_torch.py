"""What most users want works where torch cannot be imported; what needs it says so."""

import json
from pathlib import Path
from typing import Any

import pytest

import omnisyn_cli
from cli.cli_samples import start_cli, write_pair
from interpolation_samples import edit_poses

SMALL = ["--frames", 3, "--threads", 1]


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    """A pair whose depth has to be estimated, and beside it a package torch that cannot be imported."""
    hidden = tmp_path / "hidden" / "torch"
    hidden.mkdir(parents=True)
    (hidden / "__init__.py").write_text("raise ImportError('hidden', name='torch')\n")
    images = write_pair(tmp_path, size=(64, 128))
    edit_poses(tmp_path, lambda panoramas: [panorama.pop("depth") for panorama in panoramas.values()])
    job = {"id": "one", "inputs": ["a.png", "b.png"], "poses": "poses.json", "frames": 3, "preset": "fast"}
    (tmp_path / "jobs.jsonl").write_text(json.dumps(job))
    return images


def ended(pair: list[Path], *words: Any) -> tuple[int, str]:
    """Exit code and standard error of a command in the folder of the pair, without torch."""
    folder = pair[0].parent
    paths = f"{folder / 'hidden'}:{Path(omnisyn_cli.__file__).parents[1]}"
    process = start_cli(*words, folder=folder, PYTHONPATH=paths)
    _, err = process.communicate(timeout=300)
    return process.returncode, err.decode()


@pytest.mark.parametrize(
    ("words", "made"),
    [
        (["interpolate", "a.png", "b.png", "-o", "o.mp4", *SMALL], "o.mp4"),
        (["view", "a.png", "b.png", "-o", "o.html", "--preset", "fast"], "o.html"),
        (["export", "a.png", "b.png", "-o", "o.glb", "--preset", "fast"], "o.glb"),
        (["poses", "check", "a.png", "b.png", "--poses", "poses.json"], "poses.json"),
        (["eval", ".", "--methods", "crossfade", "--json"], "poses.json"),
        (["batch", "jobs.jsonl", "-o", "out", "--workers", 1], "out/results.jsonl"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_the_main_commands_need_no_torch(pair: list[Path], words: list[Any], made: str) -> None:
    code, err = ended(pair, *words)
    assert code == 0, err
    assert (pair[0].parent / made).is_file()


def test_what_needs_torch_says_so_in_one_line(pair: list[Path]) -> None:
    code, err = ended(pair, "export-onnx", "paper-narrow", "-o", "models")
    assert (code, err.count("\n")) == (1, 1), err
    assert "python -m pip install 'omnisyn-cli[train]'" in err
