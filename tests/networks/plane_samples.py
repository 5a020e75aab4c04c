"""Small networks on planes, awake: with weights that say something, as those of trained ones do."""

import torch

from omnisyn_cli.networks.completion import (
    AGREED_PLANE,
    SKY_PLANE,
    CompletionConfig,
    CompletionNetwork,
    SphereAttention,
)
from omnisyn_cli.networks.fusion import FusionConfig, build_fusion

FUSION = FusionConfig("tiny", planes=52, widths=(8, 12, 16), fine=6)
PAINTING = FusionConfig("tiny paper", planes=8, widths=(8, 12, 16, 24), paints=True)
COMPLETION = CompletionConfig("tiny", planes=19, widths=(8, 12, 16), fine=6, heads=2, looks=1)


def awake(config):
    builds = {CompletionConfig: CompletionNetwork, FusionConfig: build_fusion}
    torch.manual_seed(0)
    network = builds[type(config)](config).eval()
    for layer in network.modules():
        if isinstance(layer, SphereAttention):
            for last in (layer.take, layer.think[2], layer.near):
                torch.nn.init.normal_(last.weight, std=0.3)
    torch.nn.init.normal_(network.answer.weight, std=0.3)
    return network


def random_planes(count=19, height=32, width=64, seed=0):
    """Of evidence; matching is sure in a tenth of the pixels, and another tenth is sky."""
    given = torch.rand((1, count, height, width), generator=torch.Generator().manual_seed(seed))
    for plane in (AGREED_PLANE, SKY_PLANE):
        given[:, plane] = (given[:, plane] > 0.9).float()
    return given


def answers(network, given):
    """All that a network says, by name."""
    with torch.no_grad():
        answer = network(given)
    return {"colour": answer} if isinstance(answer, torch.Tensor) else vars(answer)
