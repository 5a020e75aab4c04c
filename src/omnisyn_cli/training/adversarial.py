"""What tells true pictures from made ones while a generator learns: a discriminator, its losses, those it teaches by.

Source: Wiles et al., SynSin, section 3.4; Lim and Ye, Geometric GAN (2017) for the hinge; Wang et al., pix2pixHD (CVPR
2018), section 3.2, for patches at several scales, here on the sphere and with spectral norms instead of instance norms.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import spectral_norm

from omnisyn_cli.networks.layers import WrappedConv
from omnisyn_cli.networks.paper_layers import row_channel

WATCH_STEPS, RAMP_STEPS = 400, 200
"""Steps in which the discriminator learns alone, and over which its weight then rises from 0 to 1."""

ADVERSARIAL_WEIGHT = 0.01
"""Weight of the adversarial loss beside an absolute error of colours in [0, 1]."""

FEATURE_WEIGHT = 10.0
"""Weight of feature matching (pix2pixHD's), times :data:`ADVERSARIAL_WEIGHT`."""

DISCRIMINATOR_RATE_SCALE = 0.5
"""Learning rate of the discriminator in units of that of the generator."""

ADAM_BETAS = (0.5, 0.99)
"""Of the discriminator: less momentum than usual, as in most GANs."""

LEAK, RGB_CHANNELS = 0.2, 3
"""Slope of the LeakyReLU below zero, pix2pixHD's; channels of a panorama."""

Answers = Sequence[Sequence[Tensor]]
"""Of a discriminator: for each scale the features of its layers and last its verdicts."""


class PatchDiscriminator(nn.Module):
    """Panoramas in, for each scale the features of every layer and last the verdicts on patches (positive: true).

    Args:
        widths: channels of the layers, each half as high and wide as the one before.
        scales: how often it is asked, each time about a picture of half the size.
    """

    def __init__(self, widths: tuple[int, ...] = (24, 48, 96), scales: int = 2) -> None:
        super().__init__()
        self.scales = nn.ModuleList(_scale(widths) for _ in range(scales))

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> list[list[Tensor]]:
        """Look at pictures whose height and width can be halved often enough."""
        answers = []
        for layers in self.scales:
            x, seen = torch.cat([image - 0.5, row_channel(image)], dim=1), []
            for layer in layers:  # type: ignore[attr-defined]
                x = layer(x)
                seen.append(x)
                x = functional.leaky_relu(x, LEAK)
            answers.append(seen)
            image = functional.avg_pool2d(image, 2)
        return answers


def _scale(widths: tuple[int, ...]) -> nn.ModuleList:
    halving = [WrappedConv(a, b, (2, 2)) for a, b in itertools.pairwise((RGB_CHANNELS + 1, *widths))]
    return nn.ModuleList(spectral_norm(layer) for layer in (*halving, WrappedConv(widths[-1], 1)))


class Discriminator:
    """A discriminator with its optimiser.

    Args:
        network: that tells what is made from what is true.
        weight_decay: of AdamW.

    Attributes:
        begun: step of the run that it was fresh at.
    """

    def __init__(self, network: nn.Module, weight_decay: float) -> None:
        self.network, self.begun, self._weight_decay = network, 0, weight_decay
        self.optimizer = torch.optim.AdamW(network.parameters(), weight_decay=weight_decay, betas=ADAM_BETAS)

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        return {"weights": self.network.state_dict(), "optimizer": self.optimizer.state_dict(), "begun": self.begun}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint; from one that says no more than where it begins, afresh."""
        self.begun = state.get("begun", 0)
        if "weights" in state:
            self.network.load_state_dict(state["weights"])
            self.optimizer.load_state_dict(state["optimizer"])

    def learn(self, loss: Float[Tensor, ""], rate: float, clip: float) -> None:
        """One step; ``rate`` is the generator's."""
        for group in self.optimizer.param_groups:
            group.update(lr=DISCRIMINATOR_RATE_SCALE * rate, weight_decay=self._weight_decay)
        self.optimizer.zero_grad(set_to_none=True)  # what the generator's loss left here as well
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), clip)
        if torch.isfinite(norm):
            self.optimizer.step()


def adversarial_weight(step: int) -> float:
    """How much the discriminator counts after so many steps of its own: nothing at first, then more and more."""
    return ADVERSARIAL_WEIGHT * min(1.0, max(0.0, (step - WATCH_STEPS) / RAMP_STEPS))


def discriminator_loss(made: Answers, true: Answers) -> Tensor:
    """Hinge: true patches should be called more than 1, made ones less than −1."""
    terms = [
        (1.0 - real[-1].float()).clamp(min=0.0).mean() + (1.0 + fake[-1].float()).clamp(min=0.0).mean()
        for fake, real in zip(made, true, strict=True)
    ]
    return torch.stack(terms).mean()


def adversarial_loss(made: Answers) -> Tensor:
    """How little what is made is taken for true; negative where it is."""
    return -torch.stack([scale[-1].float().mean() for scale in made]).mean()


def feature_loss(made: Answers, true: Answers) -> Tensor:
    """Mean absolute difference of all features but the verdicts; gradients go to what is made only."""
    terms = [
        (fake.float() - real.detach().float()).abs().mean()
        for scale, other in zip(made, true, strict=True)
        for fake, real in zip(scale[:-1], other[:-1], strict=True)
    ]
    return FEATURE_WEIGHT * torch.stack(terms).mean()
