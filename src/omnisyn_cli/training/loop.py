"""The training loop: constant rate after a warm-up, an average of the weights, a short cool-down.

How long a run may last is rarely known, so the rate stays constant and the exponential average (EMA) is the model.
Everything is counted in steps: a run that is paused, killed or continued goes the same way, bit for bit on one machine.
"""

import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from omnisyn_cli.compute.threads import at_most
from omnisyn_cli.errors import InputError, TrainingError
from omnisyn_cli.io import write_image
from omnisyn_cli.io.documents import append_line
from omnisyn_cli.io.outputs import make_folder
from omnisyn_cli.training.checkpoint import compact, load_state, of_this_version, save_checkpoint
from omnisyn_cli.training.data import Augmentation, check_height, list_scene_files
from omnisyn_cli.training.pictures import contact_sheet
from omnisyn_cli.training.tasks import HELD_OUT_LOSS, TASKS, NetworkConfig, TrainConfig, on_device, task_of

# Files of a run: what it goes on from; compact, the one that was judged best; a row for each validation.
CHECKPOINT, BEST_CHECKPOINT, LOG = "checkpoint.pt", "best.pt", "log.jsonl"
COLLAPSE_LOSS_RATIO = 1.25  # Ratio of the loss to the least so far from which on the run does not recover
# Questions to :mod:`torch.cpu`, not all of which every version of torch knows: whether there are instructions that
# multiply in bfloat16. Without them torch imitates it, three times slower than single precision.
BF16_INSTRUCTIONS = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")


@dataclass(frozen=True)
class Precision:
    """A device and its arithmetic."""

    device: torch.device  # that weights, batches and averages are on
    is_half: bool = False  # whether convolutions and products are computed in bfloat16; weights and losses never are

    def __str__(self) -> str:
        """As said to users."""
        return f"{self.device}, {'bfloat16' if self.is_half else 'single precision'}"

    def autocast(self) -> AbstractContextManager[object]:
        """To compute a loss in."""
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.is_half)


def choose_precision(device: str = "auto") -> Precision:
    """``auto``: CUDA, else bfloat16 if the processor has it. InputError: CUDA without a GPU."""
    has_cuda = torch.cuda.is_available()
    if device == "cuda" and not has_cuda:
        raise InputError("expected a CUDA GPU and a torch that can use it, got none; use --device cpu")
    if device != "cpu" and has_cuda:
        return Precision(torch.device("cuda"), is_half=torch.cuda.is_bf16_supported())
    multiplies = device == "auto" and any(getattr(torch.cpu, question, bool)() for question in BF16_INSTRUCTIONS)
    return Precision(torch.device("cpu"), is_half=multiplies)


PROCESSOR = Precision(torch.device("cpu"))  # The processor in single precision


class Trainer:
    """Network, average, optimiser and step: what a checkpoint holds."""

    judged_by = HELD_OUT_LOSS  # name of the figure that is least where the network is best

    def __init__(self, network: NetworkConfig, config: TrainConfig, precision: Precision = PROCESSOR) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.precision = precision
        self.kind = task_of(network)
        self.task = TASKS[self.kind]
        self.network = self.task.build(network).to(precision.device)
        self.optimizer = torch.optim.AdamW(
            self.parameter_groups(), lr=config.rate, weight_decay=config.weight_decay, betas=(0.9, 0.99)
        )
        self.average = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self.scores: dict[str, float] = {}
        self.pool = list[Path]()  # scenes to learn from
        self.ahead = ThreadPoolExecutor(1, thread_name_prefix="draw")
        self.drawn: dict[int, Future[Any]] = {}  # batches that were begun, by their steps
        self.best = math.inf
        self.step = 0
        self.cooldown_start: int | None = None

    def parameter_groups(self) -> list[dict[str, Any]]:
        """What the optimiser changes; the rate of a group is multiplied by its ``scale``."""
        return [{"params": list(self.network.parameters())}]

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        return {
            "kind": self.kind, "network": self.network.config.as_dict(), "training": asdict(self.config),
            "step": self.step, "cooldown_start": self.cooldown_start, "scores": self.scores, "best": self.best,
            "weights": self.network.state_dict(), "average": self.average, "optimizer": self.optimizer.state_dict(),
        }  # fmt: skip

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
        now = asdict(self.config)  # held-out losses can be compared if nothing has changed but the weights
        if all(state["training"].get(name) == now[name] for name in ("validation_pool", "size", "validation_pairs")):
            self.best = state.get("best", math.inf)

    def begin_with(self, weights: Mapping[str, torch.Tensor]) -> None:
        """Before the first step: some of the weights, by name, instead of random ones; ValueError: unknown names."""
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

    def config_at(self, step: int) -> TrainConfig:
        """The stage that a step belongs to: this one."""
        return self.config

    def scenes_at(self, step: int) -> list[Path]:
        """The files that a step draws from."""
        return self.pool

    def advance(self) -> float:
        """One step; returns the loss. The batch depends on the seed and the step alone."""
        config = self.config_at(self.step)
        if config != self.config:
            self.config, self.best = config, math.inf
        for group in self.optimizer.param_groups:
            group.update(lr=self.rate() * group.get("scale", 1.0), weight_decay=config.weight_decay)
        batch = on_device(self._batch(), self.precision.device)
        with self.precision.autocast():
            loss = self.task.loss(self.task.answer_of(self.network, batch), batch)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), config.clip)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.step += 1
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, value in self.network.state_dict().items():
                self.average[name].lerp_(value, 1.0 - decay)
        return float(loss.detach())

    def _batch(self) -> Any:
        """The batch of this step; that of the next one is begun, so that it is there when it is wanted."""
        for step in (self.step, self.step + 1):
            if step not in self.drawn:
                self.drawn[step] = self.ahead.submit(self._draw, step, self.scenes_at(step))
        return self.drawn.pop(self.step).result()

    def _draw(self, step: int, pool: list[Path]) -> Any:
        """On one thread: the others learn meanwhile."""
        rng = np.random.default_rng([self.config.seed, step])
        with at_most(1):
            return self.task.draw(pool, rng, self.config_at(step), self.network, Augmentation())

    def surpasses(self, loss: float) -> bool:
        """Whether a loss is the least so far, which is kept; TrainingError: far above it, the run has collapsed."""
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

    def about(self) -> dict[str, float]:
        """What a row of the log says besides figures."""
        return {}

    @torch.no_grad()
    def sheet(self, network: Any) -> np.ndarray | None:
        """What the averaged network answers to the first of what it is judged by, RGB in [0, 1]; None: nobody looks."""
        if self.task.pictures is None:
            return None
        batch = next(self.task.validation(network, self.config))
        return contact_sheet(self.task.pictures(self.task.answer_of(network, batch), batch))

    def end_validation(self, folder: Path, row: dict[str, Any]) -> None:
        """When a row of the log has been written: scenes that were made meanwhile are learned from as well."""
        self.pool = list_scene_files(Path(self.config.pool), self.task.pool)


def train(
    network: NetworkConfig, config: TrainConfig, folder: Path, *, minutes: float = math.inf, steps: int | None = None,
    report: Callable[[dict[str, Any]], None] = lambda row: None, precision: Precision = PROCESSOR,
    weights: Mapping[str, torch.Tensor] | None = None, on_start: Callable[[Trainer], None] = lambda trainer: None,
) -> Trainer:  # fmt: skip
    """Train until the time or the steps are over or a cool-down has ended; goes on where ``folder`` was left.

    Writes into ``folder``: ``checkpoint.pt`` (to resume), ``best.pt`` (compact, of the least loss of what the network
    is judged by), ``log.jsonl`` (one object per validation) and, for networks whose answers can be looked at,
    ``pictures/NNNNNNNN.png`` by step.

    ``network`` and ``weights`` (by name, the others are random) are those of a fresh run. ``minutes`` of wall clock and
    ``steps`` in total are limits. ``report`` is called with each row of the log, ``on_start`` once all was found right.
    TrainingError: the run has collapsed; ``checkpoint.pt`` is of an earlier step.
    """
    trainer = open_trainer(network, config, folder / CHECKPOINT, precision, weights)
    trainer.pool = _checked_pools(trainer, config)
    on_start(trainer)
    make_folder(folder, "a network that is trained")
    run(trainer, folder, minutes, steps, report)
    return trainer


def run(
    trainer: Trainer, folder: Path, minutes: float, steps: int | None, report: Callable[[dict[str, Any]], None]
) -> None:
    """The loop of :func:`train`, of any trainer."""
    started, losses, is_over = time.monotonic(), list[float](), False
    while not (is_over or trainer.is_finished() or (steps is not None and trainer.step >= steps)):
        losses.append(trainer.advance())
        seconds = time.monotonic() - started
        is_over = seconds > 60.0 * minutes
        if trainer.step % trainer.config.validate_every == 0 or trainer.is_finished():
            _judge(trainer, folder, losses, seconds, report)
            losses.clear()
        if trainer.step % trainer.config.save_every == 0:
            save_checkpoint(folder / CHECKPOINT, trainer.state())
    save_checkpoint(folder / CHECKPOINT, trainer.state())


def _judge(
    trainer: Trainer, folder: Path, losses: list[float], seconds: float, report: Callable[[dict[str, Any]], None]
) -> None:
    """Write a row of the log, pictures where the network has some, and the best weights."""
    network, task = trainer.averaged_network(), trainer.task
    scores = task.validate(network, trainer.config)
    trainer.scores = {key: round(value, 5) for key, value in scores.items() if math.isfinite(value)}
    row = {"step": trainer.step, **trainer.about(), "seconds": round(seconds, 1), "rate": trainer.rate()}
    finite = [loss for loss in losses if math.isfinite(loss)]  # the others taught nothing
    if finite:
        row["loss"] = float(np.mean(finite))
    row |= trainer.scores
    append_line(folder / LOG, row)
    sheet = trainer.sheet(network)
    if sheet is not None:
        make_folder(folder / "pictures", "pictures")
        write_image(folder / "pictures" / f"{trainer.step:08d}.png", sheet)
    report(row)
    is_best = trainer.surpasses(trainer.scores.get(trainer.judged_by, math.nan))
    trainer.end_validation(folder, row)
    if is_best:
        save_checkpoint(folder / BEST_CHECKPOINT, compact(trainer.state()))


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
    network: NetworkConfig, config: TrainConfig, path: Path, precision: Precision = PROCESSOR,
    weights: Mapping[str, torch.Tensor] | None = None,
) -> Trainer:  # fmt: skip
    """A fresh trainer, or that of a checkpoint; a cool-down begins there. InputError: another version or kind."""
    if not path.exists():
        trainer = Trainer(network, config, precision)
        trainer.begin_with(weights or {})
    else:
        kind = task_of(network)
        state = state_of(path, kind)
        with of_this_version(path):
            trainer = Trainer(TASKS[kind].config.from_dict(state["network"]), config, precision)
            trainer.restore(state)
    if config.cooldown_steps == 0:
        trainer.cooldown_start = None
    elif trainer.cooldown_start is None:
        trainer.cooldown_start = trainer.step
    return trainer


def state_of(path: Path, kind: str) -> dict[str, Any]:
    """A checkpoint, or one made of an exported file; InputError: it is of another kind of network."""
    state = load_state(path)
    if state["kind"] != kind:
        raise InputError(f"expected a {kind} network in {path}, got a {state['kind']} network; name another one")
    return state
