from dataclasses import replace

import numpy as np
import pytest
import torch

from depth_samples import TINY
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.networks.depth import DepthNetwork
from omnisyn_cli.networks.depth_config import VARIANTS, DepthConfig, level_roots
from omnisyn_cli.networks.layers import unit_groups
from omnisyn_cli.networks.sphere_volume import lookup, meridian_products, resampling_matrix, sphere_volume


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.fixture
def pair():
    return torch.rand(2, 3, 64, 128), torch.rand(2, 3, 64, 128)


def random_network(config=TINY):
    """Weights far from their quiet start, so that every part speaks."""
    network = DepthNetwork(config).eval()
    for stage in network.refinements:
        torch.nn.init.normal_(stage.choice.weight, std=0.5)
        torch.nn.init.normal_(stage.upsample.weight, std=0.5)
    torch.nn.init.normal_(network.coarse.logits.weight, std=1.0)
    return network


def test_the_matrix_is_a_sphere_sweep_in_three_dimensions():
    """Brute force: every pixel of every sphere, moved by the homogeneous formula and looked up."""
    roots, rows_first, rows_second = np.array([-0.1, 0.0, 0.3, 0.9, 1.7]), 8, 16
    matrix = resampling_matrix(roots, rows_first, rows_second)
    directions = pixel_directions(rows_first, 2 * rows_first)
    second_from_first = Pose(np.eye(3), np.array([0.0, -1.0, 0.0]))  # the second camera stands 1 m up the zenith
    signal = np.random.default_rng(0).random(rows_second)
    for level, root in enumerate(roots):
        inverse_depth = np.full(directions.shape[:2], max(root, 0.0) ** 2)
        moved = sweep_directions(directions, inverse_depth, second_from_first)
        row, col = direction_to_pixel(moved, (rows_second, 2 * rows_first))
        np.testing.assert_allclose(col - np.arange(2 * rows_first), 0.0, atol=1e-9)  # matches lie in the same column
        expected = np.interp(row, np.arange(rows_second), signal)
        np.testing.assert_allclose((matrix[level] @ signal)[:, None] + 0 * row, expected, atol=1e-6)


def test_at_infinity_the_matrix_changes_nothing():
    np.testing.assert_allclose(resampling_matrix(np.array([0.0]), 8, 8)[0], np.eye(8), atol=1e-6)


def test_products_compare_each_meridian_with_itself():
    first, second = torch.rand(2, 3, 4, 5, 6), torch.rand(2, 3, 4, 7, 6)
    expected = torch.einsum("bgciw,bgcjw->bgwij", first, second)
    torch.testing.assert_close(meridian_products(first, second), expected)


def test_looking_up_the_levels_gives_the_volume():
    """The lookup around an estimate and the constant matrix are the same function."""
    products = torch.rand(2, 3, 6, 8, 8)
    roots = level_roots(TINY)
    volume = sphere_volume(products, torch.from_numpy(resampling_matrix(roots, 8, 8)))
    candidates = torch.from_numpy(roots).float().view(1, -1, 1, 1).expand(2, -1, 8, 6)
    torch.testing.assert_close(lookup(products, candidates), volume, atol=1e-5, rtol=0)


def test_the_volume_is_highest_at_the_true_sphere():
    """Features of the second image that are those of the first, moved by a known root."""
    roots = level_roots(TINY)
    truth = 9
    matrix = torch.from_numpy(resampling_matrix(roots, 32, 64))
    second = unit_groups(torch.randn(1, 16, 64, 8), 1)
    first = unit_groups(torch.einsum("ij,bcjw->bciw", matrix[truth], second[:, 0]), 1)
    volume = sphere_volume(meridian_products(first, second), matrix)[0, 0]
    middle = volume[:, 8:20].argmax(dim=0)
    assert (middle == truth).float().mean() > 0.95


def test_outputs_are_bounded_never_negative_and_as_large_as_the_image(pair):
    prediction = random_network()(*pair)
    assert [tuple(root.shape) for root in prediction.roots] == [(2, 1, 16, 32), (2, 1, 32, 64), (2, 1, 64, 128)]
    inverse_depth, confidence = prediction.inverse_depth(), prediction.confidence()
    reach = sum(TINY.reach * stage.step for stage in random_network().refinements)
    assert inverse_depth.min() >= 0
    assert inverse_depth.max() <= (TINY.greatest_root + reach) ** 2
    assert inverse_depth.std() > 0
    assert confidence.shape == inverse_depth.shape
    assert 0 <= confidence.min() <= confidence.max() <= 1


def test_infinity_is_exactly_zero(pair):
    network = DepthNetwork(TINY).eval()
    with torch.no_grad():
        network.coarse.logits.bias[0] = 100.0
    assert torch.all(network(*pair).inverse_depth() == 0)


def test_the_seam_is_nowhere(pair):
    """Rolling both images rolls the answer, once the channels that say where the ground is are switched off.

    Exact for rolls by a multiple of the coarsest stride, 64 pixels here; the azimuth channel alone breaks it.
    """
    network = random_network()
    rolled = [image.roll(64, -1) for image in pair]
    assert not torch.allclose(network(*rolled).roots[-1], network(*pair).roots[-1].roll(64, -1), atol=1e-5)
    with torch.no_grad():
        network.encoder.stem.first.weight[:, -1] = 0
        network.encoder.stem.shortcut.weight[:, -1] = 0
        for stage in (network.coarse, *network.refinements):
            stage.enter.first.weight[:, -1] = 0
            stage.enter.shortcut.weight[:, -1] = 0
    torch.testing.assert_close(network(*rolled).roots[-1], network(*pair).roots[-1].roll(64, -1), atol=1e-5, rtol=0)


def test_gradients_are_finite_and_reach_every_weight(pair):
    network = random_network()
    prediction = network(*pair)
    (sum(root.square().mean() for root in prediction.roots) + prediction.confidence().mean()).backward()
    for name, parameter in network.named_parameters():
        unused = name.startswith("refinements.0.confidence")  # only the last stage's confidence is given
        assert unused or (parameter.grad is not None and torch.all(torch.isfinite(parameter.grad))), name


def test_plain_images_give_finite_answers():
    black = torch.zeros(1, 3, 64, 128)
    assert torch.all(torch.isfinite(random_network()(black, black).roots[-1]))


def test_single_precision_is_enough(pair):
    network = random_network()
    single = network(*pair).inverse_depth()
    double = network.double()(*(image.double() for image in pair)).inverse_depth()
    torch.testing.assert_close(single.double(), double, rtol=1e-3, atol=1e-4)


def test_answers_do_not_depend_on_the_number_of_threads(pair):
    network, threads = random_network(), torch.get_num_threads()
    answers = []
    for count in (1, 2):
        torch.set_num_threads(count)
        answers.append(network(*pair).inverse_depth())
    torch.set_num_threads(threads)
    torch.testing.assert_close(answers[0], answers[1], atol=1e-4, rtol=0)


@pytest.mark.parametrize("size", [(60, 120), (64, 64)])
def test_sizes_that_do_not_divide_are_refused(size):
    with pytest.raises(ValueError, match="multiples of 64"):
        DepthNetwork(TINY)(torch.zeros(1, 3, *size), torch.zeros(1, 3, *size))


@pytest.mark.parametrize("config", [*VARIANTS.values(), TINY], ids=lambda config: config.name)
def test_configurations_survive_a_round_trip(config):
    assert DepthConfig.from_dict(config.as_dict()) == config
    with pytest.raises(TypeError):
        DepthConfig.from_dict(config.as_dict() | {"surprise": 1})


def test_filters_over_the_volume_are_an_option(pair):
    network = random_network(replace(TINY, volume_filters=4))
    assert torch.all(torch.isfinite(network(*pair).roots[-1]))
