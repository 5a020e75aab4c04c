"""What the training loop has to know of a kind of network: what it is shown, how it is taught, how it is judged."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from omnisyn_cli.training.data import Augmentation, list_scene_files

VALIDATION_SEED = 1
"""Of the draws of held-out batches: the same in every run, so that losses can be compared."""

HELD_OUT_LOSS = "held_out_loss"
"""Name among the figures of the loss of what networks are judged by."""


@dataclass(frozen=True)
class TrainConfig:
    """One stage of training; a later stage may change any of it.

    Attributes:
        pool, validation_pool: folders of scenes, see :mod:`omnisyn_cli.training.data`.
        size: of the images, a whole fraction of the pool's.
        batch: pairs per step.
        rate: learning rate after the warm-up.
        warmup_steps: steps over which the rate rises from zero.
        cooldown_steps: 0, or the number of steps over which the rate falls to zero, counted from the first step of this
            call; then training ends.
        weight_decay, clip: of AdamW, and the greatest norm of a gradient.
        ema: decay of the average per step (smaller at the beginning).
        seed: of the weights and of all batches.
        validate_every, save_every: in steps.
        validation_pairs: how many pairs are scored.
        guided: share of the pairs that a depth network is shown with what matching would say.
    """

    pool: str
    validation_pool: str
    size: tuple[int, int] = (256, 512)
    batch: int = 4
    rate: float = 6e-4
    warmup_steps: int = 200
    cooldown_steps: int = 0
    weight_decay: float = 1e-4
    clip: float = 1.0
    ema: float = 0.998
    seed: int = 0
    validate_every: int = 250
    save_every: int = 50
    validation_pairs: int = 32
    guided: float = 0.0


Draw = Callable[[list[Path], np.random.Generator, TrainConfig, Any, Augmentation | None], Any]
"""Of a pool, random numbers, a stage, the network and the variation of colours: a batch, on the processor."""


@dataclass(frozen=True)
class Task:
    """A kind of network.

    Batches are dataclasses of tensors, or lists of them.

    Attributes:
        config: class of its configuration, with ``as_dict`` and ``from_dict``.
        variants: the configurations by name.
        build: a fresh network of a configuration.
        draw: the batch of a step.
        loss: of an answer to a batch, a scalar.
        scores: figures of an answer to a batch.
        inputs: what a network is called with, of itself and a batch.
        answer: of a network to a batch; None calls it with ``inputs``.
        pictures: what is seen of an answer to a batch, RGB in [0, 1] by name; None where nobody looks.
        held_out: a batch to be judged by, of a scene's file, the number of times that it was looked at before, and the
            stage; None draws it without varying colours.
        is_repeated: whether held-out scenes are looked at again if there are fewer than asked for.
        pool: command that makes what it learns from, see :func:`omnisyn_cli.training.data.list_scene_files`.
        role: what it is for; None where that is the kind itself.
    """

    config: type[Any]
    variants: Mapping[str, Any]
    build: Callable[[Any], Any]
    draw: Draw
    loss: Callable[[Any, Any], Tensor]
    scores: Callable[[Any, Any], dict[str, float]]
    inputs: Callable[[Any, Any], tuple[Tensor, ...]] = lambda network, batch: batch.inputs
    answer: Callable[[Any, Any], Any] | None = None
    pictures: Callable[[Any, Any], dict[str, np.ndarray]] | None = None
    held_out: Callable[[Path, int, TrainConfig], Any] | None = None
    is_repeated: bool = True
    pool: str = "pool"
    role: str | None = None

    def answer_of(self, network: Any, batch: Any) -> Any:
        """What a network says to a batch."""
        return network(*self.inputs(network, batch)) if self.answer is None else self.answer(network, batch)

    def validation(self, network: Any, stage: TrainConfig) -> Iterator[Any]:
        """What networks are judged by: always the same, where the weights are."""
        pool = list_scene_files(Path(stage.validation_pool), self.pool)
        pairs = stage.validation_pairs if self.is_repeated else min(stage.validation_pairs, len(pool))
        for index in range(pairs):
            path = pool[index % len(pool)]
            if self.held_out is None:
                rng = np.random.default_rng([VALIDATION_SEED, index])
                batch = self.draw([path], rng, replace(stage, batch=1), network, None)
            else:
                batch = self.held_out(path, index // len(pool), stage)
            yield on_device(batch, next(network.parameters()).device)

    @torch.no_grad()
    def validate(self, network: Any, stage: TrainConfig) -> dict[str, float]:
        """Mean figures, of which NaN, as of pairs without sky, is left out; and the mean loss, which may be NaN."""
        scores, losses = [], []
        for batch in self.validation(network, stage):
            answer = self.answer_of(network, batch)
            scores.append(self.scores(answer, batch))
            losses.append(float(self.loss(answer, batch)))
        rows = torch.tensor([list(score.values()) for score in scores])
        means = dict(zip(scores[0], rows.nanmean(dim=0).tolist(), strict=True))
        return means | {HELD_OUT_LOSS: float(torch.tensor(losses).mean())}

    @torch.no_grad()
    def show(self, network: Any, stage: TrainConfig) -> dict[str, np.ndarray]:
        """Pictures of the first of what networks are judged by; none where nobody looks."""
        if self.pictures is None:
            return {}
        batch = next(self.validation(network, stage))
        return self.pictures(self.answer_of(network, batch), batch)


def on_device(batch: Any, device: torch.device) -> Any:
    """A batch on another device."""
    if isinstance(batch, list):
        return [on_device(sample, device) for sample in batch]
    tensors = {name: value.to(device) for name, value in vars(batch).items() if isinstance(value, Tensor)}
    return replace(batch, **tensors)
