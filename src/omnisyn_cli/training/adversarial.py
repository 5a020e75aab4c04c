"""A generator and its opponent: hinge losses, matching of features, and what of the opponent a checkpoint holds.

Source: Wiles et al., SynSin, section 3.4; Lim and Ye, Geometric GAN (2017) for the hinge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import Module

__all__ = [
    "Contest",
    "Opponent",
    "adversarial_loss",
    "adversarial_weight",
    "feature_loss",
    "opposing_loss",
]

ALONE, RAMP = 400, 200
"""Steps in which the opponent only watches, and over which its say rises to the whole weight after them."""

WEIGHT = 0.01
"""Of the adversarial loss beside an absolute error of colours in [0, 1]."""

FEATURE_WEIGHT = 10.0
"""Of the matching of features, times :data:`WEIGHT`."""

RATE_SHARE = 0.5
"""Learning rate of the opponent in that of the generator."""

BETAS = (0.5, 0.99)

Answers = Sequence[Sequence[Tensor]]
"""Of an opponent: for each scale the features of its layers and last its verdicts."""


@dataclass(frozen=True)
class Contest:
    """How a network learns against an opponent.

    Attributes:
        build: a fresh opponent.
        losses: of a network, an opponent, a pool, a generator of random numbers, a configuration and the number of
            steps that the opponent has seen: the network's loss, and the opponent's.
    """

    build: Callable[[], Module]
    losses: Callable[..., tuple[Tensor, Tensor]]


class Opponent:
    """A discriminator with its optimiser.

    Args:
        network: that tells what is made from what is true.
        weight_decay: of AdamW.

    Attributes:
        begun: step of the run that it was fresh at.
    """

    def __init__(self, network: Module, weight_decay: float) -> None:
        self.network, self.begun, self._weight_decay = network, 0, weight_decay
        self.optimizer = torch.optim.AdamW(network.parameters(), weight_decay=weight_decay, betas=BETAS)

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        return {
            "weights": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "begun": self.begun,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint; from one that says no more than where it begins, afresh."""
        self.begun = state.get("begun", 0)
        if "weights" in state:
            self.network.load_state_dict(state["weights"])
            self.optimizer.load_state_dict(state["optimizer"])

    def learn(self, loss: Float[Tensor, ""], rate: float, clip: float) -> None:
        """One step; ``rate`` is the generator's."""
        for group in self.optimizer.param_groups:
            group.update(lr=RATE_SHARE * rate, weight_decay=self._weight_decay)
        self.optimizer.zero_grad(set_to_none=True)  # what the generator's loss left here as well
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), clip)
        if torch.isfinite(norm):
            self.optimizer.step()


def adversarial_weight(step: int) -> float:
    """How much the opponent counts after so many steps of its own: nothing at first, then more and more."""
    return WEIGHT * min(1.0, max(0.0, (step - ALONE) / RAMP))


def opposing_loss(made: Answers, true: Answers) -> Tensor:
    """Hinge: true patches should be called more than 1, made ones less than −1."""
    terms = [
        (1.0 - there[-1].float()).clamp(min=0.0).mean() + (1.0 + here[-1].float()).clamp(min=0.0).mean()
        for here, there in zip(made, true, strict=True)
    ]
    return torch.stack(terms).mean()


def adversarial_loss(made: Answers) -> Tensor:
    """How little what is made is taken for true; negative where it is."""
    return -torch.stack([scale[-1].float().mean() for scale in made]).mean()


def feature_loss(made: Answers, true: Answers) -> Tensor:
    """Mean absolute difference of all features but the verdicts; gradients go to what is made only."""
    terms = [
        (here.float() - there.detach().float()).abs().mean()
        for scale, other in zip(made, true, strict=True)
        for here, there in zip(scale[:-1], other[:-1], strict=True)
    ]
    return FEATURE_WEIGHT * torch.stack(terms).mean()
