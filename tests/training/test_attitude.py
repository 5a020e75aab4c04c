"""The network that tells how a picture was held: what is fitted, and the command."""

import numpy as np
import pytest
import torch
from efficientnet_samples import classifier_weights

from omnisyn_cli.cli.main import main
from omnisyn_cli.networks.attitude import AttitudeConfig, AttitudeNetwork
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.runtime.session import open_session, run_network


def test_the_sum_of_features_is_that_of_bands_and_wraps_around_the_seam():
    network = AttitudeNetwork(AttitudeConfig()).eval()
    image = torch.rand(1, 3, 128, 256)
    with torch.no_grad():
        features = network.features(image)
        turned = network.features(image.roll(64, dims=-1))
    assert features.shape == (1, 4 * 192)
    torch.testing.assert_close(features, turned)
