"""Small networks on planes, awake: with weights that say something, as those of trained ones do."""

import torch

from omnisyn_cli.networks import completion
from omnisyn_cli.networks.fusion import FusionConfig, build_fusion

FUSION = FusionConfig("tiny", channels=52, widths=(8, 12, 16), fine=6)
PAINTING = FusionConfig("tiny paper", channels=8, widths=(8, 12, 16, 24), is_direct=True)
COMPLETION = completion.CompletionConfig("tiny", channels=19, widths=(8, 12, 16), fine=6, heads=2, attention_layers=1)


def awake(config):
    builds = {completion.CompletionConfig: completion.CompletionNetwork, FusionConfig: build_fusion}
    torch.manual_seed(0)
    network = builds[type(config)](config).eval()
    for layer in network.modules():
        if isinstance(layer, completion.SphereAttention):
            for last in (layer.proj, layer.mlp[2], layer.position_bias):
                torch.nn.init.normal_(last.weight, std=0.3)
    torch.nn.init.normal_(network.head.weight, std=0.3)
    return network


def random_channels(count=19, height=32, width=64, seed=0):
    """Of evidence; matching is sure in a tenth of the pixels, and another tenth is sky."""
    given = torch.rand((1, count, height, width), generator=torch.Generator().manual_seed(seed))
    for plane in (completion.CONSISTENT_CHANNEL, completion.SKY_CHANNEL):
        given[:, plane] = (given[:, plane] > 0.9).float()
    return given


def predict(network, given):
    with torch.no_grad():
        answer = network(given)
    return {"colour": answer} if isinstance(answer, torch.Tensor) else vars(answer)


def losses_of(network, loss_of, steps=30):
    """Losses while a network learns from one example."""
    optimizer, losses = torch.optim.Adam(network.parameters(), lr=3e-3), []
    for _ in range(steps):
        loss = loss_of()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    return losses
