import pytest
import torch
from plane_samples import SILHOUETTES, awake, random_planes

from omnisyn_cli.networks.silhouettes import MOST_CORRECTED, ROOT_PLANE, SilhouetteNetwork, SilhouettePrediction


@pytest.fixture(scope="module")
def network():
    return awake(SILHOUETTES)


def test_a_fresh_network_keeps_the_map():
    torch.manual_seed(0)
    given = random_planes(SILHOUETTES.planes)
    with torch.no_grad():
        answer = SilhouetteNetwork(SILHOUETTES)(given)
    assert torch.equal(answer.root(), given[:, ROOT_PLANE : ROOT_PLANE + 1])


def test_what_is_kept_is_kept_exactly_and_what_is_moved_lies_beside_a_surface_around(network):
    given = random_planes(SILHOUETTES.planes)
    own, nearer, farther = given[:, ROOT_PLANE : ROOT_PLANE + 3].split(1, dim=1)
    with torch.no_grad():
        answer = network(given)
    assert torch.equal(answer.roots[:, :1], own)
    for root, surface in zip(answer.roots[:, 1:].split(1, dim=1), (own + nearer, own - farther), strict=True):
        assert (root - surface.clamp(min=0.0)).abs().max() <= MOST_CORRECTED + 1e-6
        assert (root - surface).abs().max() > 1e-3  # it is corrected


@pytest.mark.parametrize("likeliest", [0, 1, 2])
def test_the_answer_is_the_likeliest_of_the_three(likeliest):
    logits = torch.tensor([0.2, -0.3, 0.1]).view(1, 3, 1, 1).clone()
    logits[0, likeliest] = 1.0
    roots = torch.tensor([0.5, 0.9, 0.2]).view(1, 3, 1, 1)
    answer = SilhouettePrediction(logits, roots, torch.zeros((1, 1, 1, 1)))
    assert float(answer.root()) == float(roots[0, likeliest])
    torch.testing.assert_close(answer.inverse_depth(), roots[:, likeliest : likeliest + 1].square())


def test_inverse_depth_is_never_negative(network):
    given = random_planes(SILHOUETTES.planes)
    given[:, ROOT_PLANE] = 0.0
    with torch.no_grad():
        assert torch.all(network(given).roots >= 0.0)
