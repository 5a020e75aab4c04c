"""SynSin's networks: what they are by construction, whatever their weights."""

import pytest
import torch

from omnisyn_cli.networks.synsin import (
    SYNSIN_VARIANTS,
    FeatureEncoder,
    MonocularNetwork,
    RefinementDecoder,
    SynSinConfig,
    SynSinNetwork,
    inverse_depth_of,
)

TINY = SynSinConfig("tiny", (32, 64), features=6, depth_widths=(6, 8), decoder_widths=(6, 8, 8), fine=4)


@pytest.fixture
def network():
    torch.manual_seed(0)
    return SynSinNetwork(TINY).eval()


@pytest.mark.parametrize("part", ["depth", "encoder", "decoder"])
def test_no_network_knows_where_the_seam_is(network, part):
    """Turned by a multiple of the coarsest stride, every answer turns along."""
    channels = TINY.features + 1 if part == "decoder" else 3
    x, answer = torch.rand(1, channels, 32, 64), getattr(network, part)
    with torch.no_grad():
        torch.testing.assert_close(answer(x.roll(24, dims=-1)), answer(x).roll(24, dims=-1), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("part", ["depth", "encoder", "decoder"])
def test_every_network_knows_up_from_down(network, part):
    channels = TINY.features + 1 if part == "decoder" else 3
    x, answer = torch.full((1, channels, 32, 64), 0.5), getattr(network, part)
    with torch.no_grad():
        rows = answer(x)[0, -1, 8:24, 0]
    assert (rows - rows.flip(0)).abs().max() > 1e-6


def test_the_first_features_are_the_colours_and_a_picture_begins_as_one_of_points(network):
    image, points = torch.rand(2, 3, 32, 64), torch.rand(2, TINY.features + 1, 32, 64)
    points[:, -1] = 0.5 + 0.5 * points[:, -1]
    with torch.no_grad():
        features, picture = network.encoder(image), network.decoder(points)
    assert features.shape == (2, TINY.features, 32, 64)
    assert torch.equal(features[:, :3], image)
    assert (picture - points[:, :3] / points[:, -1:]).abs().mean() < 0.1


def test_inverse_depth_is_bounded_and_a_root_below_zero_is_infinitely_far(network):
    sqrt_inv_depths = torch.tensor([-1.0, 0.0, 0.5, 9.0])
    assert inverse_depth_of(sqrt_inv_depths, TINY).tolist() == [0.0, 0.0, 0.25, 4.0]
    with torch.no_grad():
        first = network.depth(torch.rand(1, 3, 32, 64))
    assert first.shape == (1, 1, 32, 64)
    assert (first - 0.4).abs().mean() < 0.1  # six metres, until it has learned better


def test_sizes_that_cannot_be_halved_often_enough_are_refused(network):
    for part, channels in ((network.depth, 3), (network.decoder, TINY.features + 1)):
        with pytest.raises(ValueError, match=r"multiples of 8, got 64×36"):
            part(torch.rand(1, channels, 36, 64))


def test_the_configuration_survives_a_checkpoint():
    small = SYNSIN_VARIANTS["small"]
    assert SynSinConfig.from_dict({**small.as_dict(), "depth_widths": list(small.depth_widths)}) == small
    with pytest.raises(TypeError):
        SynSinConfig.from_dict({**small.as_dict(), "colour": 1})


def test_the_shipped_variant_is_small():
    config = SYNSIN_VARIANTS["small"]
    parts = [MonocularNetwork(config), FeatureEncoder(config), RefinementDecoder(config)]
    assert 4 * sum(parameter.numel() for part in parts for parameter in part.parameters()) < 12e6
