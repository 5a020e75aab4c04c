"""The training loop: constant rate after a warm-up, an average of the weights, a short cool-down.

How long a run may last is rarely known, so the rate stays constant and the exponential average (EMA) is the model; when
time is up, :attr:`TrainConfig.cooldown_steps` more steps take the rate to zero along a cosine. Everything is counted in
steps: a run that is paused, killed or continued goes the same way, bit for bit on one machine.
"""

import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from omnisyn_cli.compute.threads import at_most
from omnisyn_cli.errors import InputError, TrainingError
from omnisyn_cli.io import write_image
from omnisyn_cli.io.json_lines import append_line
from omnisyn_cli.io.outputs import make_folder
from omnisyn_cli.training.checkpoint import compact, load_checkpoint, of_this_version, save_checkpoint
from omnisyn_cli.training.data import Augmentation, check_height, list_scene_files
from omnisyn_cli.training.exported import load_state
from omnisyn_cli.training.pictures import contact_sheet
from omnisyn_cli.training.precision import Precision
from omnisyn_cli.training.task import HELD_OUT_LOSS, TrainConfig, on_device
from omnisyn_cli.training.tasks import TASKS, NetworkConfig, parts_of, task_named, task_of

__all__ = ["TrainConfig", "part_of", "train"]

CHECKPOINT = "checkpoint.pt"
"""Name of the checkpoint that a run goes on from."""

BEST_CHECKPOINT = "best.pt"
"""Name of the compact checkpoint with the least loss of what networks are judged by."""

COLLAPSE_LOSS_RATIO = 1.25
"""Ratio of the loss to the least so far from which on the run does not recover."""

PROCESSOR = Precision(torch.device("cpu"))
"""The processor in single precision."""


class Trainer:
    """Network, average, optimiser and step: what a checkpoint holds."""

    def __init__(self, network: NetworkConfig, config: TrainConfig, precision: Precision = PROCESSOR) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.precision = precision
        self.kind = task_of(network)
        self.task = TASKS[self.kind]
        self.network = self.task.build(network).to(precision.device)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=config.rate, weight_decay=config.weight_decay, betas=(0.9, 0.99)
        )
        self.average = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self.scores: dict[str, float] = {}
        self.ahead = ThreadPoolExecutor(1, thread_name_prefix="draw")
        self.drawn: tuple[int, Future[Any]] | None = None
        self.best = math.inf
        self.step = 0
        self.cooldown_start: int | None = None

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        return {
            "kind": self.kind,
            "network": self.network.config.as_dict(),
            "training": asdict(self.config),
            "step": self.step,
            "cooldown_start": self.cooldown_start,
            "scores": self.scores,
            "best": self.best,
            "weights": self.network.state_dict(),
            "average": self.average,
            "optimizer": self.optimizer.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint, whole or compact; the rates come from this trainer's own configuration."""
        self.network.load_state_dict(state.get("weights", state["average"]))
        own = self.network.state_dict()
        self.average = {name: value.to(own[name], copy=True) for name, value in state["average"].items()}
        if "optimizer" in state:
            self.optimizer.load_state_dict(state["optimizer"])
        self.step = state["step"]
        self.cooldown_start = state.get("cooldown_start")
        self.scores = dict(state.get("scores", {}))
        if all(state["training"].get(name) == now for name, now in self._judged_by().items()):
            self.best = state.get("best", math.inf)

    def _judged_by(self) -> dict[str, Any]:
        """What held-out losses depend on besides the weights, as a checkpoint has it."""
        return {name: asdict(self.config)[name] for name in ("validation_pool", "size", "validation_pairs")}

    def begin_with(self, weights: Mapping[str, torch.Tensor]) -> None:
        """Before the first step: some of the weights, by name, instead of random ones.

        Raises ValueError: the network has no weights of these names.
        """
        unknown = self.network.load_state_dict(weights, strict=False).unexpected_keys
        if unknown:
            raise ValueError(f"expected weights that the network has, got {', '.join(unknown)}")
        self.average = {name: value.detach().clone() for name, value in self.network.state_dict().items()}

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
        for group in self.optimizer.param_groups:
            group.update(lr=self.rate() * group.get("scale", 1.0), weight_decay=config.weight_decay)
        batch = on_device(self._batch(pool), self.precision.device)
        with self.precision.autocast():
            loss = self.task.loss(self.task.answer_of(self.network, batch), batch)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), config.clip)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.step += 1
        self._follow()
        return float(loss.detach())

    def _batch(self, pool: list[Path]) -> Any:
        """The batch of this step; that of the next one is begun, so that it is there when it is wanted."""
        if self.drawn is None or self.drawn[0] != self.step:
            self.drawn = self._begin_batch(self.step, pool)
        batch = self.drawn[1].result()
        self.drawn = self._begin_batch(self.step + 1, pool)
        return batch

    def _begin_batch(self, step: int, pool: list[Path]) -> tuple[int, Future[Any]]:
        return step, self.ahead.submit(self._draw, step, pool)

    def _draw(self, step: int, pool: list[Path]) -> Any:
        """On one thread: the others learn meanwhile."""
        rng = np.random.default_rng([self.config.seed, step])
        with at_most(1):
            return self.task.draw(pool, rng, self.config, self.network, Augmentation())

    @torch.no_grad()
    def _follow(self) -> None:
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        for name, value in self.network.state_dict().items():
            self.average[name].lerp_(value, 1.0 - decay)

    def surpasses(self, loss: float) -> bool:
        """Whether the loss of what networks are judged by is the least so far, which is remembered then.

        Raises TrainingError: it is far above the least: the run has collapsed, and would not recover.
        """
        if not loss <= COLLAPSE_LOSS_RATIO * self.best:
            raise TrainingError(
                f"expected a held-out loss near {self.best:.4g}, the least so far, got {loss:.4g} at step {self.step}: "
                f"the run has collapsed; put {BEST_CHECKPOINT} in the place of {CHECKPOINT} and go on with a "
                f"lower --rate"
            )
        is_best = loss < self.best
        self.best = min(loss, self.best)
        return is_best

    def averaged_network(self) -> Any:
        """The network with averaged weights, for use."""
        network = self.task.build(self.network.config)
        network.load_state_dict(self.average)
        return network.to(self.precision.device).eval()


def load_network(path: Path) -> tuple[Any, dict[str, Any]]:
    """The averaged network of a checkpoint or of an exported file, and the checkpoint; its ``"kind"`` says what it is.

    Raises InputError: no file, or no checkpoint of a known kind and of this version.
    """
    state = load_state(path)
    task = task_named(state.get("kind"), path)
    with of_this_version(path):
        network = task.build(task.config.from_dict(state["network"]))
        network.load_state_dict(state["average"])
    return network.eval(), state


def part_of(path: Path, kinds: tuple[str, ...]) -> Any:
    """The averaged network of one of these kinds in a checkpoint, joint or not.

    Raises InputError: no checkpoint of this version, or it has none.
    """
    held = parts_of(load_network(path)[0])
    found = [part for kind, part in held.items() if kind in kinds]
    if not found:
        expected, got = " or ".join(kinds), " and ".join(held)
        raise InputError(f"expected a {expected} network in {path}, got {got}; name another checkpoint")
    return found[0]


def train(
    network: NetworkConfig,
    config: TrainConfig,
    folder: Path,
    *,
    minutes: float = math.inf,
    steps: int | None = None,
    report: Callable[[dict[str, Any]], None] = lambda row: None,
    precision: Precision = PROCESSOR,
    weights: Mapping[str, torch.Tensor] | None = None,
    on_start: Callable[[Trainer], None] = lambda trainer: None,
) -> Trainer:
    """Train until the time or the steps are over or a cool-down has ended; goes on where ``folder`` was left.

    Writes into ``folder``: ``checkpoint.pt`` (to resume), ``best.pt`` (compact, of the least loss of what the network
    is judged by), ``log.jsonl`` (one object per validation) and, for networks whose answers can be looked at,
    ``pictures/NNNNNNNN.png`` by step.

    Args:
        network: of a fresh run; a run that goes on keeps its own.
        config: of this stage.
        folder: of the run.
        minutes: of wall clock, at most.
        steps: total number of steps to reach, at most.
        report: called with each row of the log.
        precision: where and how to compute; a checkpoint can go on with another one.
        weights: that a fresh run begins with, by name; the others are random.
        on_start: called once, before the first step, when everything has been found right.

    Raises TrainingError: the run has collapsed; ``checkpoint.pt`` is of an earlier step.
    """
    path = folder / CHECKPOINT
    trainer = open_trainer(network, config, path, precision, weights)
    started, losses = time.monotonic(), list[float]()
    pool = _checked_pools(trainer, config)
    on_start(trainer)
    make_folder(folder, "a network that is trained")
    while not trainer.is_finished() and (steps is None or trainer.step < steps):
        losses.append(trainer.advance(pool))
        out_of_time = time.monotonic() - started > 60.0 * minutes
        if trainer.step % config.validate_every == 0:
            row, pictures = _log_row(trainer, losses, time.monotonic() - started)
            append_line(folder / "log.jsonl", row)
            if pictures:
                make_folder(folder / "pictures", "pictures")
                write_image(folder / "pictures" / f"{trainer.step:08d}.png", contact_sheet(pictures))
            report(row)
            if trainer.surpasses(trainer.scores.get(HELD_OUT_LOSS, math.nan)):
                save_checkpoint(folder / BEST_CHECKPOINT, compact(trainer.state()))
            losses, pool = [], list_scene_files(Path(config.pool), trainer.task.pool)
        if trainer.step % config.save_every == 0 or out_of_time:
            save_checkpoint(path, trainer.state())
        if out_of_time:
            break
    save_checkpoint(path, trainer.state())
    return trainer


def _checked_pools(trainer: Trainer, config: TrainConfig) -> list[Path]:
    """The scenes to learn from; those to be judged by are found wrong now, not after hundreds of steps."""
    pool, judged = (
        list_scene_files(Path(folder), trainer.task.pool) for folder in (config.pool, config.validation_pool)
    )
    if trainer.task.pool == "fusion-pool":
        multiple = trainer.network.config.size_multiple
        check_height(pool, 2 * multiple)  # a window half as wide is seen
        check_height(judged, multiple)
    next(trainer.task.validation(trainer.network, config))
    return pool


def open_trainer(
    network: NetworkConfig,
    config: TrainConfig,
    path: Path,
    precision: Precision = PROCESSOR,
    weights: Mapping[str, torch.Tensor] | None = None,
) -> Trainer:
    """A fresh trainer, with ``weights`` if there are any, or the one of the checkpoint at ``path``.

    A cool-down asked for begins at its step.

    Raises InputError: the checkpoint is of another version, or of another kind than ``network``, whose data and rate
        would not suit it.
    """
    if not path.exists():
        trainer = Trainer(network, config, precision)
        trainer.begin_with(weights or {})
    else:
        state = load_checkpoint(path)
        task, kind = task_named(state.get("kind"), path), task_of(network)
        if state["kind"] != kind:
            raise InputError(f"expected a {kind} network in {path}, got a {state['kind']} network; name another folder")
        with of_this_version(path):
            trainer = Trainer(task.config.from_dict(state["network"]), config, precision)
            trainer.restore(state)
    if config.cooldown_steps == 0:
        trainer.cooldown_start = None
    elif trainer.cooldown_start is None:
        trainer.cooldown_start = trainer.step
    return trainer


def _log_row(trainer: Trainer, losses: list[float], seconds: float) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A row of the log, and pictures where the network has some."""
    network, task = trainer.averaged_network(), trainer.task
    scores = task.validate(network, trainer.config)
    trainer.scores = {key: round(value, 5) for key, value in scores.items() if math.isfinite(value)}
    row = {"step": trainer.step, "seconds": round(seconds, 1), "rate": trainer.rate()}
    finite = [loss for loss in losses if math.isfinite(loss)]  # the others taught nothing
    if finite:
        row["loss"] = float(np.mean(finite))
    return row | trainer.scores, task.show(network, trainer.config)
