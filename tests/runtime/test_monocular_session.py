"""Networks that users bring: what is asked of them, what is refused, and answers that are kept."""

import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from cli.cli_samples import Omnisyn
from interpolation_samples import Hall
from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.planning.duration import expected_duration
from omnisyn_cli.interpolation.planning.memory import PriorCost
from omnisyn_cli.interpolation.planning.prior import with_prior_cost
from omnisyn_cli.runtime import monocular_session
from omnisyn_cli.runtime.monocular_session import MonocularSession, NetworkKind
from omnisyn_cli.runtime.session import open_session

PICTURE = np.random.default_rng(0).random((3, 16, 32)).astype(np.float32)


@pytest.fixture(autouse=True)
def answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return monocular_session.answers_folder()


def network(
    path: Path, nodes: Sequence[tuple[str, dict]] = (("ReduceMean", {"axes": [1]}),),
    shape: Sequence[int | str] = (1, 3, 16, 32), inputs: int = 1, kind: int = TensorProto.FLOAT,
    constant: np.ndarray | None = None,
) -> Path:  # fmt: skip
    """An ONNX file: the picture through some nodes, or a constant."""
    entries = [helper.make_tensor_value_info(f"picture{k}", kind, list(shape)) for k in range(inputs)]
    last, made, initializers = "picture0", [], []
    for k, (operator, attributes) in enumerate(nodes):
        made.append(helper.make_node(operator, [last], [f"value{k}"], **attributes))
        last = f"value{k}"
    if constant is not None:
        made, last = [helper.make_node("Identity", ["constant"], ["value"])], "value"
        initializers = [numpy_helper.from_array(constant.astype(np.float32), "constant")]
    graph = helper.make_graph(made, "g", entries, [helper.make_empty_tensor_value_info(last)], initializers)
    graph.output[0].type.tensor_type.elem_type = kind if constant is None else TensorProto.FLOAT
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def opened(path: Path, words: str = "") -> MonocularSession:
    return MonocularSession(open_session(path, device="cpu"), path, NetworkKind.from_words(words))


@pytest.mark.parametrize(
    ("shape", "words", "size", "is_panoramic"),
    [
        ((1, 3, 16, 32), "", (16, 32), True), ((1, 3, 16, 16), "", (16, 16), False),
        ((1, 3, 16, 32), "perspective", (16, 32), False), ((1, 3, "rows", "cols"), "panorama", (448, 896), True),
        (("batch", 3, "rows", "cols"), "perspective", (448, 448), False), ((1, 16, 32, 3), "", (16, 32), True),
    ],
)  # fmt: skip
def test_the_file_or_the_user_says_what_a_network_sees(tmp_path, shape, words, size, is_panoramic) -> None:
    session = opened(network(tmp_path / "a.onnx", shape=shape), words)
    assert (session.size, session.is_panoramic) == (size, is_panoramic)


@pytest.mark.parametrize("kind", [TensorProto.FLOAT, TensorProto.FLOAT16])
def test_numbers_are_those_of_the_network(tmp_path: Path, kind: int) -> None:
    numbers, readings, is_distance = opened(network(tmp_path / "a.onnx", kind=kind))(PICTURE)
    assert numbers == pytest.approx(PICTURE.mean(axis=0), abs=1e-3)
    assert readings == ("depth", "inverse-depth", "log-depth")
    assert not is_distance
    assert opened(tmp_path / "a.onnx", "inverse-depth")(PICTURE)[1] == ("inverse-depth",)


def test_points_are_distances(tmp_path: Path) -> None:
    points = np.random.default_rng(1).normal(size=(1, 16, 32, 3))
    numbers, readings, is_distance = opened(network(tmp_path / "a.onnx", constant=points), "points")(PICTURE)
    assert numbers == pytest.approx(np.linalg.norm(points[0], axis=-1), rel=1e-6)
    assert (readings, is_distance) == (("depth",), True)


def test_pictures_are_normalized_on_request(tmp_path: Path) -> None:
    numbers, _, _ = opened(network(tmp_path / "a.onnx"), "imagenet")(PICTURE)
    mean, deviation = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    expected = ((PICTURE - mean[:, None, None]) / deviation[:, None, None]).mean(axis=0)
    assert numbers == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("settings", "words", "reason"),
    [
        ({"inputs": 2}, "", "one picture of 3 channels"), ({"shape": (1, 5, 16, 32)}, "", "one picture of 3 channels"),
        ({"shape": (3, 16, 32), "nodes": [("Abs", {})]}, "", "one picture of 3 channels"),
        ({"kind": TensorProto.INT32, "nodes": [("Abs", {})]}, "", "one picture of 3 channels"),
        ({"shape": (1, 3, "rows", "cols")}, "", "--depth-prior-kind panorama or perspective"),
        ({"constant": np.full((1, 1, 16, 32), 3.0)}, "", "varies, got 3 everywhere"),
        ({"constant": np.full((1, 1, 16, 32), np.nan)}, "", "finite"),
        ({"constant": np.ones((1, 1, 16, 16))}, "", "as wide to high"),
        ({"constant": np.ones((1, 7))}, "", "as wide to high"), ({}, "points", "expected a map of points"),
    ],
)  # fmt: skip
def test_what_is_no_depth_network_is_refused(tmp_path: Path, settings: dict, words: str, reason: str) -> None:
    path = network(tmp_path / "a.onnx", **settings)
    with pytest.raises(InputError, match=reason) as error:
        opened(path, words)(PICTURE)
    assert "\n" not in str(error.value)


def test_a_file_whose_weights_lie_elsewhere_is_refused(tmp_path: Path) -> None:
    path = network(tmp_path / "a.onnx", constant=np.random.default_rng(0).random((1, 1, 16, 32)))
    onnx.save(onnx.load(path), path, save_as_external_data=True, location="weights", size_threshold=0)
    with pytest.raises(InputError, match="weights in one file"):
        opened(path)
    (tmp_path / "weights").unlink()
    with pytest.raises(InputError, match="ONNX Runtime says"):
        opened(path)


@pytest.mark.parametrize("words", ["depths", "depth,points", "panorama,perspective", "depth points"])
def test_words_that_say_nothing_are_refused(words: str) -> None:
    with pytest.raises(InputError, match="separated by commas"):
        NetworkKind.from_words(words)


def test_answers_are_kept_by_picture_and_network(tmp_path: Path, answers: Path, monkeypatch) -> None:
    """A second session asks nothing; another picture, network or kind does. A broken file is no answer."""
    first = opened(network(tmp_path / "a.onnx"))(PICTURE)[0]
    (file,) = answers.glob("*.npy")
    asked = []
    original = monocular_session.run_network
    monkeypatch.setattr(monocular_session, "run_network", lambda *each: asked.append(1) or original(*each))
    assert np.array_equal(opened(tmp_path / "a.onnx")(PICTURE)[0], first)
    assert not asked
    opened(tmp_path / "a.onnx")(PICTURE[:, ::-1])
    opened(tmp_path / "a.onnx", "imagenet")(PICTURE)
    opened(network(tmp_path / "b.onnx", nodes=[("ReduceMax", {"axes": [1]})]))(PICTURE)
    assert len(asked) == 3
    file.write_bytes(file.read_bytes()[:50])  # as a full disk leaves it
    assert np.array_equal(opened(tmp_path / "a.onnx")(PICTURE)[0], first)
    assert len(asked) == 4
    assert not list(answers.glob("*.part"))


# Ends the process in the middle of writing an answer, and has any pair ask the network.
KILLED_RUN = """
import os, signal, sys
from pathlib import Path
from omnisyn_cli.cli import main

def write(file, content, write_all=Path.write_bytes):
    if b"NUMPY" in content:
        write_all(file, content[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
    write_all(file, content)

Path.write_bytes = write
main(sys.argv[1:])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_a_run_that_is_killed_while_an_answer_is_written_is_done_again_to_the_same_result(
    pair: Hall, tmp_path: Path, answers: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plan says which answers there are already, and what the others take."""
    words = ["interpolate", str(tmp_path), "--frames", "3", "--size", "64x32", "--preset", "fast", "--threads", "1",
             "--depth-prior", str(network(tmp_path / "a.onnx")), "-o"]  # fmt: skip
    killed = subprocess.run([sys.executable, "-c", KILLED_RUN, *words, str(tmp_path / "out")], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert sorted(file.suffix for file in answers.iterdir()) == [".json", ".part"]
    plans = [omnisyn.json(*words, tmp_path / "out", "--dry-run")]
    omnisyn.made(*words, tmp_path / "out")
    plans.append(omnisyn.json(*words, tmp_path / "new", "--dry-run"))
    for kept, plan in zip((0, 2), plans, strict=True):
        assert plan["depth_prior_words"].endswith(f"for 2 pictures, {kept} of them with kept answers")
    shutil.rmtree(answers)
    omnisyn.made(*words, tmp_path / "calm")
    assert [file.read_bytes() for file in sorted((tmp_path / "out").iterdir())] == [
        file.read_bytes() for file in sorted((tmp_path / "calm").iterdir())
    ]


def test_what_a_network_takes_is_measured_once_and_counted(pair: Hall, tmp_path: Path, answers: Path) -> None:
    job = {"depth_prior": str(network(tmp_path / "a.onnx", shape=(1, 3, 16, 16))), "preset": "fast"}
    unknown = with_prior_cost(pair.plan(**job), is_measured=False)
    assert unknown.prior_cost.seconds is None
    assert expected_duration(unknown) is None
    with_prior_cost(unknown, is_measured=True)
    (file,) = answers.glob("*.json")
    file.write_text("[2.5, 3000000]")
    known, bundled = with_prior_cost(unknown, is_measured=True), replace(unknown, prior_cost=PriorCost())
    assert known.prior_cost.seconds == 2 * 14 * 2.5
    assert known.memory_estimate.program_bytes - bundled.memory_estimate.program_bytes == 3e6
    assert expected_duration(known).seconds - expected_duration(bundled).seconds == pytest.approx(70, abs=20)


def test_the_oldest_answers_go_first_and_a_broken_folder_keeps_none(tmp_path, answers: Path, monkeypatch) -> None:
    monkeypatch.setattr(monocular_session, "MAX_KEPT_ANSWERS", 2)
    session = opened(network(tmp_path / "a.onnx"))
    for turns in range(4):
        session(np.roll(PICTURE, turns, axis=2))
    assert len(list(answers.glob("*.npy"))) == 2
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "a.onnx"))
    assert session(np.roll(PICTURE, 9, axis=2))[0].shape == (16, 32)
