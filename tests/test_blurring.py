"""``--blur``: what is black in a mask, or a face that a detector finds, is nowhere in what is made."""

import json
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from cli.cli_samples import Omnisyn, folder_arguments, write_pair
from omnisyn_cli.interpolation.blurring import blur
from omnisyn_cli.interpolation.job import FACE_MODEL_VARIABLE
from omnisyn_cli.io import write_image

FACE, EYES = np.s_[120:136, 200:216], np.s_[122:136:4, 202:216:4]
MAGENTA, GREEN = (255, 0, 255), (0, 255, 0)


@pytest.fixture
def people(tmp_path: Path) -> list[Path]:
    """A pair with a magenta face with green eyes in the first picture, and a mask for each."""
    images = write_pair(tmp_path, size=(256, 512))
    picture = cv2.imread(str(images[0]))
    picture[FACE], picture[EYES] = MAGENTA, GREEN
    write_image(images[0], picture[..., ::-1].copy())
    for k in range(2):
        mask = np.full((256, 512), 255, np.uint8)
        if k == 0:
            mask[116:140, 196:220] = 0
        write_image(tmp_path / f"mask{k}.png", mask)
    return images


def face_network(path: Path) -> Path:
    """With the inputs and outputs of YuNet: a magenta cell is a face of two cells."""
    known = {"weights": np.array([0.5, -1.0, 0.5], np.float32).reshape(1, 3, 1, 1) / 255.0,
             "zero": np.float32(0), "one": np.float32(1), "rows": np.array([1, -1, 1], np.int64)}  # fmt: skip
    nodes, outputs, make = [helper.make_node("Conv", ["input", "weights"], ["map"])], [], helper.make_node
    for side in (8, 16, 32):
        nodes += [make("AveragePool", ["map"], [f"mean{side}"], kernel_shape=[side] * 2, strides=[side] * 2),
                  make("Clip", [f"mean{side}", "zero", "one"], [f"score{side}"]),
                  make("Reshape", [f"score{side}", "rows"], [f"cls_{side}"])]  # fmt: skip
        for name, values in (("obj", [1.0]), ("bbox", [0.5, 0.5, 0.69, 0.69]), ("kps", [0.5] * 10)):
            of = np.array(values, np.float32).reshape(1, 1, -1)
            known |= {f"no_{name}": np.zeros_like(of), f"of_{name}": of}
            nodes.append(make("Mul", [f"cls_{side}", f"no_{name}"], [f"{name}{side}"]))
            nodes.append(make("Add", [f"{name}{side}", f"of_{name}"], [f"{name}_{side}"]))
        sizes = (("cls", 1), ("obj", 1), ("bbox", 4), ("kps", 10))
        outputs += [helper.make_tensor_value_info(f"{name}_{side}", 1, [1, None, count]) for name, count in sizes]
    picture = helper.make_tensor_value_info("input", 1, [1, 3, "height", "width"])
    weights = [numpy_helper.from_array(np.asarray(values), name) for name, values in known.items()]
    graph = helper.make_graph(nodes, "faces", [picture], outputs, weights)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 11)], ir_version=8), str(path))
    return path


def has_eyes(path: Path) -> bool:
    picture = cv2.imread(str(path)).astype(int)
    return bool((picture[..., 1] - picture[..., ::2].max(axis=-1) > 150).any())


@pytest.mark.parametrize("how", ["masks", "faces"])
def test_faces_are_nowhere_in_a_video_and_its_walk(
    tmp_path: Path, people: list[Path], omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    before = [path.read_bytes() for path in people]
    assert has_eyes(people[0])
    network = face_network(tmp_path / "faces.onnx")
    blurs = [word for k in range(2) for word in ("--blur", tmp_path / f"mask{k}.png")]
    if how == "faces":
        monkeypatch.setenv(FACE_MODEL_VARIABLE, str(network))
        blurs = ["--blur", "auto-faces"]
    omnisyn.made(*folder_arguments(tmp_path, people, *blurs))
    assert not any(has_eyes(frame) for frame in sorted((tmp_path / "out").iterdir()))
    omnisyn.made("view", *people, "-o", tmp_path / "walk", "--folder", "--threads", 1, *blurs)
    manifest = json.loads((tmp_path / "walk" / "walk.json").read_text())
    photographs = [level for panorama in manifest["panoramas"] for level in panorama["photo"]]
    assert photographs
    assert not any(has_eyes(tmp_path / "walk" / manifest["files"][level["block"]]) for level in photographs)
    assert [path.read_bytes() for path in people] == before


def test_what_cannot_be_blurred_is_refused(tmp_path: Path, people: list[Path], omnisyn: Omnisyn) -> None:
    words = folder_arguments(tmp_path, people, "--blur")
    assert "one mask to blur for each of 2" in omnisyn.refused(*words, tmp_path / "mask0.png")
    assert "github.com/opencv/opencv_zoo" in omnisyn.refused(*words, "auto-faces")
    assert "(no such file)" in omnisyn.refused(*words, "auto-faces", "--face-model", tmp_path / "none.onnx")
    assert "a YuNet face detector" in omnisyn.refused(*words, "auto-faces", "--face-model", people[0])
    write_image(tmp_path / "small.png", np.zeros((64, 128), np.uint8))
    small = (tmp_path / "small.png", "--blur", tmp_path / "mask1.png")
    assert "expected a mask of 512×256 pixels" in omnisyn.refused(*words, *small)


def test_blurred_areas_hold_few_numbers_whatever_their_size() -> None:
    """Pictures of equal means of cells are blurred to the same: nothing else of them is left."""
    rng = np.random.default_rng(0)
    area = np.zeros((256, 512), bool)
    area[100:110, 50:58], area[40:200, 200:360] = True, True
    first = rng.integers(0, 256, (256, 512, 3)).astype(np.uint8)
    second = first.reshape(64, 4, 128, 4, 3)[:, ::-1, :, ::-1].reshape(first.shape)
    one, other = (blur(picture, area) for picture in (first, second))
    assert np.abs(one[area].astype(int) - other[area]).max() <= 1
    np.testing.assert_array_equal(one[~area], first[~area])
    assert one[area].std() < 0.2 * first[area].std()
