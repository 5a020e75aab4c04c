import torch
from plane_samples import DOUBT, awake, random_planes

from omnisyn_cli.networks.doubt import ANSWERED, FACTORS, DoubtNetwork


def test_a_fresh_network_does_not_know():
    torch.manual_seed(0)
    with torch.no_grad():
        (told,) = DoubtNetwork(DOUBT).outputs(random_planes(DOUBT.planes))
    assert (told - 0.5).abs().max() < 0.1


def test_of_the_bounds_that_it_is_taught_it_answers_with_one():
    network, given = awake(DOUBT), random_planes(DOUBT.planes)
    with torch.no_grad():
        (told,), logits = network.outputs(given), network(given)
    assert logits.shape == (1, len(FACTORS), *given.shape[-2:])
    assert FACTORS[ANSWERED] == 1.1
    torch.testing.assert_close(told[:, 0], logits[:, ANSWERED].sigmoid())
    assert told.min() >= 0.0
    assert told.max() <= 1.0
    assert told.std() > 0.01
