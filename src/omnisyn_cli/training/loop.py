"""The training loop of the depth network: constant rate after a warm-up, an average of the weights, a short cool-down.

How long a run may last is rarely known, so the rate stays constant and the exponential average (EMA) is the model; when
time is up, :attr:`TrainConfig.cooldown_steps` more steps take the rate to zero along a cosine. Everything is counted in
steps: a run that is paused, killed or continued goes the same way, bit for bit on one machine.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.depth import DepthConfig, DepthNetwork
from omnisyn_cli.training.checkpoint import load_checkpoint, save_checkpoint
from omnisyn_cli.training.data import Augmentation, draw_batch, list_pool
from omnisyn_cli.training.losses import DepthScores, depth_loss, depth_scores

__all__ = ["TrainConfig", "Trainer", "load_network", "train"]

VALIDATION_SEED = 1


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


class Trainer:
    """Network, average, optimiser and step: what a checkpoint holds."""

    def __init__(self, network: DepthConfig, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.network = DepthNetwork(network)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=config.rate, weight_decay=config.weight_decay, betas=(0.9, 0.99)
        )
        self.average = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self.scores: dict[str, float] = {}
        self.step = 0
        self.cooldown_start: int | None = None

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        return {
            "kind": "depth",
            "network": self.network.config.as_dict(),
            "training": asdict(self.config),
            "step": self.step,
            "cooldown_start": self.cooldown_start,
            "scores": self.scores,
            "weights": self.network.state_dict(),
            "average": self.average,
            "optimizer": self.optimizer.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint, whole or compact; the rates come from this trainer's own configuration."""
        self.network.load_state_dict(state.get("weights", state["average"]))
        own = self.network.state_dict()
        self.average = {name: value.to(own[name].dtype, copy=True) for name, value in state["average"].items()}
        if "optimizer" in state:
            self.optimizer.load_state_dict(state["optimizer"])
        self.step = state["step"]
        self.cooldown_start = state.get("cooldown_start")
        self.scores = dict(state.get("scores", {}))

    def rate(self) -> float:
        """Learning rate of the next step."""
        config = self.config
        rate = config.rate * min(1.0, (self.step + 1) / max(config.warmup_steps, 1))
        if self.cooldown_start is None:
            return rate
        share = (self.step - self.cooldown_start) / config.cooldown_steps
        return rate * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0)))

    def is_finished(self) -> bool:
        """Whether a cool-down has come to its end."""
        return self.cooldown_start is not None and self.step >= self.cooldown_start + self.config.cooldown_steps

    def advance(self, pool: list[Path]) -> float:
        """One step; returns the loss. The batch depends on the seed and the step alone."""
        config = self.config
        rng = np.random.default_rng([config.seed, self.step])
        batch = draw_batch(pool, rng, config.batch, config.size, Augmentation(), self.network.config.greatest_root)
        for group in self.optimizer.param_groups:
            group["lr"] = self.rate()
        loss = depth_loss(self.network(batch.first, batch.second), batch.root)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), config.clip)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.step += 1
        self._follow()
        return float(loss.detach())

    @torch.no_grad()
    def _follow(self) -> None:
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        for name, value in self.network.state_dict().items():
            self.average[name].lerp_(value, 1.0 - decay)

    def averaged_network(self) -> DepthNetwork:
        """The network with averaged weights, for use."""
        network = DepthNetwork(self.network.config)
        network.load_state_dict(self.average)
        return network.eval()


def load_network(path: Path) -> tuple[DepthNetwork, dict[str, Any]]:
    """The averaged network of a checkpoint, and the checkpoint.

    Raises:
        InputError: no file, or another kind of checkpoint.
    """
    state = load_checkpoint(path)
    if state.get("kind") != "depth":
        raise InputError(f"expected a checkpoint of a depth network in {path}, got kind {state.get('kind')!r}")
    network = DepthNetwork(DepthConfig.from_dict(state["network"]))
    network.load_state_dict(state["average"])
    return network.eval(), state


@torch.no_grad()
def validate(network: DepthNetwork, config: TrainConfig) -> DepthScores:
    """Scores of fixed pairs without augmentation, the mean over pairs (NaN, as of pairs without sky, left out)."""
    pool = list_pool(Path(config.validation_pool))
    rows = []
    for index in range(config.validation_pairs):
        rng = np.random.default_rng([VALIDATION_SEED, index])
        scene = pool[index % len(pool)]
        batch = draw_batch([scene], rng, 1, config.size, greatest_root=network.config.greatest_root)
        rows.append(list(asdict(depth_scores(network(batch.first, batch.second), batch.root, batch.baseline)).values()))
    return DepthScores(*torch.tensor(rows).nanmean(dim=0).tolist())


def train(
    network: DepthConfig,
    config: TrainConfig,
    folder: Path,
    *,
    minutes: float = math.inf,
    steps: int | None = None,
    report: Callable[[dict[str, Any]], None] = lambda row: None,
) -> Trainer:
    """Train until the time or the steps are over or a cool-down has ended; goes on where ``folder`` was left.

    Writes ``checkpoint.pt`` (to resume) and ``log.jsonl`` (one object per validation) into ``folder``.

    Args:
        network: of a fresh run; a run that goes on keeps its own.
        config: of this stage.
        folder: of the run.
        minutes: of wall clock, at most.
        steps: total number of steps to reach, at most.
        report: called with each row of the log.
    """
    path = folder / "checkpoint.pt"
    trainer = open_trainer(network, config, path)
    started, losses = time.monotonic(), list[float]()
    pool = list_pool(Path(config.pool))
    while not trainer.is_finished() and (steps is None or trainer.step < steps):
        losses.append(trainer.advance(pool))
        out_of_time = time.monotonic() - started > 60.0 * minutes
        if trainer.step % config.validate_every == 0:
            row = _log_row(trainer, losses, time.monotonic() - started)
            _append(folder / "log.jsonl", row)
            report(row)
            losses, pool = [], list_pool(Path(config.pool))
        if trainer.step % config.save_every == 0 or out_of_time:
            save_checkpoint(path, trainer.state())
        if out_of_time:
            break
    save_checkpoint(path, trainer.state())
    return trainer


def open_trainer(network: DepthConfig, config: TrainConfig, path: Path) -> Trainer:
    """A fresh trainer, or the one of the checkpoint at ``path``; a cool-down asked for begins at its step."""
    if not path.exists():
        trainer = Trainer(network, config)
    else:
        state = load_checkpoint(path)
        trainer = Trainer(DepthConfig.from_dict(state["network"]), config)
        trainer.restore(state)
    if config.cooldown_steps == 0:
        trainer.cooldown_start = None
    elif trainer.cooldown_start is None:
        trainer.cooldown_start = trainer.step
    return trainer


def _log_row(trainer: Trainer, losses: list[float], seconds: float) -> dict[str, Any]:
    scores = asdict(validate(trainer.averaged_network(), trainer.config))
    trainer.scores = {key: round(value, 5) for key, value in scores.items() if math.isfinite(value)}
    row = {"step": trainer.step, "seconds": round(seconds, 1), "rate": trainer.rate(), "loss": float(np.mean(losses))}
    return row | trainer.scores


def _append(path: Path, row: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")
