"""The paper's fusion: the network sees both renderings as in training, and its picture is the frame."""

import numpy as np
import pytest
import torch
from test_residual_fuser import copy, geometric, pair

from omnisyn_cli.baselines import direct_fuser
from omnisyn_cli.baselines.direct_fuser import SIZE_MULTIPLE, DirectFuser
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.input_builder import downsampled_pair
from omnisyn_cli.fusion.input_channels import INPUT_CHANNELS, fusion_input_channels
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.networks.fusion import FUSION_VARIANTS
from omnisyn_cli.training.losses import network_inputs
from omnisyn_cli.types import Layer


class RecordingNetwork:
    """Stands in for the network: answers with a picture, or with the first view; remembers what it was shown."""

    def __init__(self, picture=None):
        self.picture, self.shown = picture, []

    def __call__(self, channels):
        self.shown.append(channels.copy())
        return channels[:3].copy() if self.picture is None else self.picture


def predict(views, network, t=0.5, threads=1):
    size = views[0].inverse_depth.shape
    return DirectFuser(size, network, threads)(*map(copy, views), t).copy()


@pytest.mark.parametrize(("size", "most"), [((64, 128), 1024), ((128, 256), 64), ((100, 200), 1024)])
def test_the_network_sees_what_it_was_trained_with(monkeypatch, size, most):
    """Against the planes that training takes from a pool, which another module makes."""
    monkeypatch.setattr(direct_fuser, "MAX_NETWORK_ROWS", most)
    views, network = pair(size), RecordingNetwork()
    predict(views, network)
    first, second = downsampled_pair(LayerPair(*views), (64, 128), LayerPairShader(size, 1))
    rule = BlendRule.at(0.5)
    recorded = fusion_input_channels(first, second, rule, 1.0, lambda image, weight: image)
    assert len(recorded) == INPUT_CHANNELS
    expected = network_inputs(FUSION_VARIANTS["paper-narrow"], torch.from_numpy(recorded)[None])[0].numpy()
    np.testing.assert_array_equal(network.shown[0], expected)
    assert {0.0, 1.0} == set(np.unique(network.shown[0][6:]))


def test_at_its_own_size_the_picture_is_the_frame_within_the_range_of_colours():
    picture = np.random.default_rng(0).uniform(-0.5, 1.5, (3, 64, 128)).astype(np.float32)
    found = predict(pair((64, 128)), RecordingNetwork(picture))
    np.testing.assert_array_equal(found, picture.transpose(1, 2, 0).clip(0, 1))


def test_it_paints_from_the_first_frame_to_the_last():
    """Nothing fades towards the ends: the authors' network is not told how far the way is."""
    views, picture = pair((64, 128)), np.full((3, 64, 128), 0.25, np.float32)
    for t in (0.002, 0.5, 0.998):
        assert (predict(views, RecordingNetwork(picture), t) == 0.25).all()


def test_larger_frames_are_enlarged_across_the_seam_and_the_poles(monkeypatch):
    monkeypatch.setattr(direct_fuser, "MAX_NETWORK_ROWS", 64)
    picture = np.random.default_rng(1).random((64, 128, 3), np.float32)
    found = predict(pair((200, 400)), RecordingNetwork(picture.transpose(2, 0, 1)))
    expected = sample_bilinear(picture.astype(float), pixel_directions(200, 400))
    np.testing.assert_allclose(found, expected, atol=0.02)  # OpenCV knows 32 places between two pixels
    assert np.abs(found - expected).mean() < 0.005


def test_from_one_place_views_are_cross_faded_without_the_network():
    first, second = pair((64, 128))
    views = first, Layer.from_arrays(second.inverse_depth, second.colour, first.target_from_source)
    network = RecordingNetwork()
    np.testing.assert_array_equal(predict(views, network), geometric(views, 0.5))
    assert network.shown == []


def test_frames_that_cannot_be_halved_often_enough_are_fused_by_rules():
    views, network = pair((SIZE_MULTIPLE // 2, SIZE_MULTIPLE)), RecordingNetwork()
    np.testing.assert_array_equal(predict(views, network), geometric(views, 0.5))
    assert network.shown == []


def test_threads_change_nothing():
    views = pair((96, 192))
    np.testing.assert_array_equal(predict(views, RecordingNetwork()), predict(views, RecordingNetwork(), threads=3))
