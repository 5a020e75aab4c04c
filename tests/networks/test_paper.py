"""The paper's depth network: its sizes, its sweep, its seam, and that it learns."""

from types import SimpleNamespace

import numpy as np
import onnx
import pytest
import torch
from plane_samples import losses_of
from torch.nn import functional

from depth_samples import TINY
from omnisyn_cli.baselines.learned_depth import LearnedDepthEstimator
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import forward_frame, sweep_directions
from omnisyn_cli.networks import paper
from omnisyn_cli.networks.export import OPSET, PARITY, export_network, largest_difference
from omnisyn_cli.networks.paper import (
    PAPER_VARIANTS,
    PaperConfig,
    PaperNetwork,
    PaperPrediction,
    sphere_inverse_depths,
    sweep_grid,
    sweep_volume,
    upsample_linear,
)
from omnisyn_cli.runtime.session import open_session
from omnisyn_cli.training.losses import paper_loss
from omnisyn_cli.types import View

AHEAD = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))  # second from first camera: a baseline straight ahead


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.fixture
def pair():
    return torch.rand(1, 3, 64, 128), torch.rand(1, 3, 64, 128)


def test_it_is_as_large_as_the_authors_network():
    """Counted by hand, layer for layer: 5,697,952 features + 16,902,200 volume + 65 low head + 44,468 high head."""
    network = PaperNetwork(PAPER_VARIANTS["paper"])
    counts = {
        name: sum(parameter.numel() for parameter in part.parameters()) for name, part in network.named_children()
    }
    assert counts == {"features": 5_697_952, "volume": 16_902_200, "low_head": 65, "high_head": 44_468}
    assert sum(counts.values()) == 22_644_685


def test_every_sphere_is_painted_with_what_the_second_camera_sees_there():
    """Brute force through the plain sampler of the sphere, seam and poles included."""
    spheres, size = np.array([0.0, 0.3, 0.9, 2.0]), (8, 16)
    second = torch.rand(1, 3, *size)
    grid = sweep_grid(torch.from_numpy(spheres).float(), size)
    volume = sweep_volume(torch.zeros(1, 3, *size), second, grid)[0]
    for level, inverse_depth in enumerate(spheres):
        moved = sweep_directions(pixel_directions(*size), np.full(size, inverse_depth), AHEAD)
        expected = sample_bilinear(second[0].permute(1, 2, 0).double().numpy(), moved)
        np.testing.assert_allclose(volume[:, level].permute(1, 2, 0), expected, atol=1e-5)


def test_ahead_is_where_the_forward_frame_has_the_second_camera():
    one = Pose(rotation_from_rotation_vector(np.array([0.2, 1.0, -0.1])), np.array([0.1, 0.2, -0.3]))
    two = Pose(rotation_from_rotation_vector(np.array([-0.3, -2.0, 0.4])), np.array([0.9, 0.4, 0.7]))
    first, second, baseline = forward_frame(one, two)
    second_from_first = second.inverse() @ first
    np.testing.assert_allclose(second_from_first.rotation, AHEAD.rotation, atol=1e-12)
    np.testing.assert_allclose(second_from_first.position / baseline, AHEAD.position, atol=1e-12)


def test_the_spheres_are_even_in_inverse_depth_and_begin_at_infinity():
    spheres = sphere_inverse_depths(PAPER_VARIANTS["paper"])
    assert (len(spheres), spheres[0], spheres[-1]) == (64, 0.0, 2.0)
    np.testing.assert_allclose(np.diff(spheres), 2.0 / 63)


def inside_a_ball(first, truth):
    """What a second camera, one baseline straight ahead, sees of a ball around the first one, 1 / truth away."""
    points = pixel_directions(*first.shape[-2:])
    reach = points @ np.array([0.0, 0.0, -1.0])
    distance = -reach + np.sqrt(reach**2 - 1.0 + 1.0 / truth**2)
    seen = np.array([0.0, 0.0, -1.0]) + distance[..., None] * points
    second = sample_bilinear(first[0].permute(1, 2, 0).double().numpy(), seen)
    return torch.from_numpy(second).permute(2, 0, 1).float()[None]


def test_the_difference_is_least_on_the_true_sphere():
    """Inside a ball around the first camera: features of the second are those of the first, seen from a metre ahead."""
    size, truth = (32, 64), 0.4
    spheres = np.linspace(0.0, 0.8, 9)
    first = functional.interpolate(torch.rand(1, 8, 8, 16), size=size, mode="bilinear")
    second = inside_a_ball(first, truth)
    volume = sweep_volume(first, second, sweep_grid(torch.from_numpy(spheres).float(), size)).mean(dim=1)[0]
    sideways = volume[:, 10:22, 20:28].argmin(dim=0)
    assert (sideways == 4).float().mean() > 0.95


def test_the_seam_is_nowhere(pair, monkeypatch):
    """Rolling both panoramas by a quarter turn rolls the answer, when the second camera is where it then is."""
    network = PaperNetwork(TINY).eval()
    plain = network(*pair)
    size = (16, 32)
    turned = sweep_grid(torch.from_numpy(sphere_inverse_depths(TINY)).float(), size).roll(8, 2)
    turned[..., 0] = (turned[..., 0] + 1 + 16 / 33 - 1 / 33) % (64 / 33) - 1 + 1 / 33  # a baseline to the right
    monkeypatch.setattr(paper, "sweep_grid", lambda *_: turned)
    rolled = network(*(image.roll(32, -1) for image in pair))
    torch.testing.assert_close(rolled.high, plain.high.roll(32, -1), atol=1e-5, rtol=0)
    torch.testing.assert_close(rolled.low, plain.low.roll(32, -1), atol=1e-5, rtol=0)
    assert plain.high.std() > 0


@pytest.mark.parametrize("seed", range(4))
def test_a_fresh_network_prefers_the_spheres_on_which_colours_match(seed):
    """A ball twice as near looks nearer to it, whatever the random weights are; what it learns reaches all blocks."""
    torch.manual_seed(seed)
    network = PaperNetwork(TINY)
    first = functional.interpolate(0.4 + 0.2 * torch.rand(1, 3, 16, 32), size=(64, 128), mode="bilinear")
    far, near = (network(first, inside_a_ball(first, truth)).low[..., 16:48, :].mean() for truth in (0.4, 0.8))
    assert near > far
    (near - far).backward()
    assert all(block.second.weight.grad.abs().max() > 0 for block in (*network.features.blocks, *network.volume.blocks))


@pytest.mark.parametrize("shape", [(1, 2, 4, 8), (1, 2, 3, 4, 8)])
def test_enlarging_goes_across_the_seam(shape):
    x = torch.rand(*shape)
    large = upsample_linear(x, 2)
    assert large.shape[2:] == tuple(2 * side for side in shape[2:])
    torch.testing.assert_close(upsample_linear(x.roll(3, -1), 2), large.roll(6, -1))
    if len(shape) == 4:
        row = large[0, 0, 0]
        edge = 0.75 * x[0, 0, 0, 0] + 0.25 * x[0, 0, 0, -1]
        torch.testing.assert_close(row[0], edge)


def test_answers_are_bounded_and_as_large_as_the_image(pair):
    network = PaperNetwork(TINY).eval()
    with torch.no_grad():
        network.high_head[-1].second.bias.fill_(-100.0)
        low = network(*pair)
        network.high_head[-1].second.bias.fill_(100.0)
        high = network(*pair)
    assert low.inverse_depth().shape == (1, 1, 64, 128)
    assert torch.all(low.inverse_depth() == 0)
    assert torch.all(high.inverse_depth() == 4)


def test_confidence_is_that_both_heads_agree():
    high = torch.tensor([1.0, 1.0, 1.0, 0.0, -1.0]).view(1, 1, 1, 5)
    low = torch.tensor([1.0, 0.9, 0.5, 0.0, -2.0]).view(1, 1, 1, 5)
    confidence = PaperPrediction(low, high).confidence().flatten()
    torch.testing.assert_close(confidence, torch.tensor([1.0, 0.5, 1 / 26, 1.0, 1.0]))


@pytest.mark.parametrize("size", [(48, 128), (64, 80)])
def test_sizes_that_do_not_divide_are_refused(size):
    with pytest.raises(ValueError, match="multiples of 32"):
        PaperNetwork(TINY)(torch.zeros(1, 3, *size), torch.zeros(1, 3, *size))


def test_gradients_are_finite_and_reach_every_weight(pair):
    network = PaperNetwork(TINY)
    paper_loss(network(*pair), 0.3 + torch.rand(1, 1, 64, 128)).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert torch.all(torch.isfinite(parameter.grad)), name


def test_a_few_steps_learn_one_pair(pair):
    network = PaperNetwork(TINY)
    target = 0.5 + 0.4 * functional.interpolate(torch.rand(1, 1, 4, 8), size=(64, 128), mode="bilinear")
    losses = losses_of(network, lambda: paper_loss(network(*pair), target), steps=20)
    assert np.mean(losses[-5:]) < 0.5 * losses[0]


@pytest.mark.parametrize("size", [(64, 128), (64, 64)])
def test_it_is_exported_and_used_like_every_other_network(tmp_path, size):
    """Square images too; the file says which frame it wants, and the estimates are two to one."""
    config = PaperConfig("small", size, TINY.widths, TINY.volume_widths, TINY.levels)
    network, path = PaperNetwork(config).eval(), tmp_path / "paper.onnx"
    with torch.no_grad():
        network.high_head[-1].second.bias.fill_(0.5)
    export_network(network, path)
    pairs = np.random.default_rng(0).random((2, 2, 1, 3, *size), dtype=np.float32)
    assert largest_difference(network, path, map(tuple, pairs)) < PARITY
    model = onnx.load(path)
    assert [opset.version for opset in model.opset_import] == [OPSET]
    assert {entry.key: entry.value for entry in model.metadata_props} == {"frame": "forward"}
    session = open_session(path, device="cpu", threads=1)
    views = [
        View(np.random.default_rng(seed).random((64, 128, 3), dtype=np.float32), Pose(np.eye(3), position))
        for seed, position in enumerate(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -2.0]]))
    ]
    for estimate in LearnedDepthEstimator(session)(*views):
        assert estimate.inverse_depth.shape == estimate.confidence.shape == (64, 128)
        assert estimate.inverse_depth.min() >= 0
        assert np.isfinite(estimate.inverse_depth).all()
    if size == (64, 128):  # both cameras are held as the forward frame holds them: nothing is resampled
        shown = [torch.from_numpy(view.image).permute(2, 0, 1)[None] for view in views]
        with torch.no_grad():
            expected = network(*shown).inverse_depth()[0, 0].numpy() / 2.0
        found = LearnedDepthEstimator(session)(*views)[0].inverse_depth
        np.testing.assert_allclose(found, expected, atol=2e-4)


def test_a_frame_that_nobody_knows_is_refused():
    from omnisyn_cli.errors import InputError

    session = SimpleNamespace(
        get_inputs=lambda: [SimpleNamespace(name=name, shape=[1, 3, 64, 128]) for name in ("first", "second")],
        get_modelmeta=lambda: SimpleNamespace(custom_metadata_map={"frame": "sideways"}),
    )
    with pytest.raises(InputError, match="sideways"):
        LearnedDepthEstimator(session)
