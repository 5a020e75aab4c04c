"""LPIPS through an ONNX file: here a tiny network, the mean squared difference."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.metrics.lpips import Lpips, cube_directions


def write_network(path: Path, shape=("batch", 3, "height", "width"), names=("image", "truth"), kind=TensorProto.FLOAT):
    """``mean (image − truth)²``; with a single input the mean square of it."""
    difference = (
        helper.make_node("Sub", list(names), ["difference"])
        if len(names) == 2
        else helper.make_node("Identity", list(names), ["difference"])
    )
    square = helper.make_node("Mul", ["difference", "difference"], ["square"])
    mean = helper.make_node("ReduceMean", ["square"], ["distance"], keepdims=1)
    graph = helper.make_graph(
        [difference, square, mean], "distance",
        [helper.make_tensor_value_info(name, kind, shape) for name in names],
        [helper.make_tensor_value_info("distance", kind, (1, 1, 1, 1))],
    )  # fmt: skip
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10), path)
    return path


@pytest.fixture
def network(tmp_path):
    return write_network(tmp_path / "lpips.onnx")


def test_the_faces_of_the_cube_cover_the_sphere_once():
    """Their pixels' solid angles, area / distance³, sum to 4π, and their directions to nothing."""
    directions = cube_directions(40, 40)
    distance = np.linalg.norm(directions, axis=-1)
    solid_angle = (2 / 40) ** 2 / distance**3
    assert solid_angle.sum() == pytest.approx(4 * np.pi, rel=1e-3)
    assert (directions / distance[..., None] * solid_angle[..., None]).sum(axis=(0, 1, 2)) == pytest.approx(0, abs=1e-9)
    second_moment = np.einsum("fhwi,fhwj,fhw->ij", directions, directions, solid_angle / distance**2)
    assert second_moment == pytest.approx(4 * np.pi / 3 * np.eye(3), rel=1e-3, abs=1e-9)


def test_the_four_faces_around_stand_upright():
    faces = cube_directions(4, 8)
    around = [face for face in faces if abs(face[..., 1].mean()) < 1e-9]
    assert len(around) == 4
    for face in around:
        assert face[0, :, 1] == pytest.approx(0.75), "up is up"
        to_the_right = np.cross(face[2, -1] - face[2, 0], face.mean(axis=(0, 1)))
        assert to_the_right[1] > 0, "not mirrored: right × forward is up"


def test_equal_pictures_have_no_distance_and_a_constant_difference_is_doubled(network):
    """[0, 1] becomes [−1, 1], so a difference of d is one of 2·d to the network."""
    lpips, truth = Lpips(network, threads=1), np.full((64, 128, 3), 0.4)
    assert lpips(truth, truth) == 0.0
    assert lpips(truth + 0.1, truth) == pytest.approx(0.2**2, rel=1e-4)


def test_the_channels_and_the_range_reach_the_network_as_they_are(tmp_path):
    """A second picture of 0.5 is 0 to the network, so the mean square is that of the colours of the first."""
    lpips = Lpips(write_network(tmp_path / "lpips.onnx"))
    colour = np.broadcast_to(np.array([0.0, 0.75, 1.0]), (64, 128, 3))
    assert lpips(colour, np.full((64, 128, 3), 0.5)) == pytest.approx((1 + 0.25 + 1) / 3, rel=1e-5)


def test_all_directions_count_and_the_upper_half_is_half(network):
    truth = np.zeros((64, 128, 3))
    upper = truth.copy()
    upper[:32] = 0.5
    assert Lpips(network)(upper, truth) == pytest.approx(0.5, rel=0.03)
    for turn in range(0, 128, 32):
        quarter = truth.copy()
        quarter[:, turn : turn + 32] = 0.5
        assert Lpips(network)(quarter, truth) == pytest.approx(0.25, rel=0.05)


def test_a_size_that_the_file_fixes_is_kept(tmp_path):
    lpips = Lpips(write_network(tmp_path / "fixed.onnx", shape=(1, 3, 24, 20)))
    truth = np.zeros((64, 128, 3))
    assert lpips(truth + 0.5, truth) == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize(
    ("change", "got"),
    [({"names": ("image",)}, "image"), ({"shape": ("batch", 1, "height", "width")}, "1"),
     ({"shape": (2, 3, 64, 64)}, "2, 3, 64, 64"), ({"shape": (3, "height", "width")}, "3, 'height', 'width'"),
     ({"kind": TensorProto.DOUBLE}, "tensor(double)")],
)  # fmt: skip
def test_another_network_is_refused_with_what_it_expects(tmp_path, change, got):
    path = write_network(tmp_path / "other.onnx", **change)
    with pytest.raises(InputError, match="expected two float images") as raised:
        Lpips(path)
    assert got in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_file_that_is_no_network_is_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("no network")
    for name in ("text.onnx", "absent.onnx"):
        with pytest.raises(InputError, match="expected an ONNX model in"):
            Lpips(tmp_path / name)


def test_other_sizes_are_refused(network):
    with pytest.raises(ValueError, match="one size"):
        Lpips(network)(np.zeros((16, 32, 3)), np.zeros((32, 64, 3)))
