"""A training by a recipe: scenes are made, stage follows stage, everything can be cut off and goes on.

Scenes are made between the steps: a few before the first one, then one every so many steps, until there are enough. So
training begins at once, and which scenes a step may draw from depends on its number alone. A run that is killed goes on
bit for bit. On another machine, where its scenes are not, it makes new ones, with seeds that it has not seen.
"""

import csv
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from omnisyn_cli.compute.threads import at_most
from omnisyn_cli.errors import InputError
from omnisyn_cli.io import write_image
from omnisyn_cli.io.json_lines import append_line
from omnisyn_cli.io.outputs import make_folder, write_errors
from omnisyn_cli.training.checkpoint import compact, of_this_version, save_checkpoint
from omnisyn_cli.training.data import Augmentation, save_samples
from omnisyn_cli.training.exported import load_state
from omnisyn_cli.training.loop import BEST_CHECKPOINT, CHECKPOINT, PROCESSOR, Trainer
from omnisyn_cli.training.precision import Precision
from omnisyn_cli.training.recipe import EARLY_STEPS, KIND, Recipe
from omnisyn_cli.training.task import TrainConfig
from omnisyn_cli.training.tasks import TASKS
from omnisyn_cli.training.walks import MESH, MeshSource, WalkConfig, make_walk

SCENE_FOLDER, VALIDATION_FOLDER = "walks", "validation-walks"
"""Folders of scenes in the folder of a run."""

LOG, CURVE, LATEST_CHECKPOINT = "log.jsonl", "curve.csv", "latest.pt"
"""Files there, besides those of every run."""

VALIDATION_SEED = 1_000_000
"""Of the first scene to be judged by; scenes to learn from have smaller ones."""

VALIDATION_KINDS = (MESH, "home", MESH, "street", MESH, "room", MESH)
"""Kinds of scenes to be judged by, in turn."""

SHOWN = 5
"""Pairs that a picture of the run shows."""


@dataclass
class WalkSchedule:
    """Which scenes a step draws from.

    Attributes:
        folder: of the scenes.
        make: writes the scene of a seed.
        first_seed: of the pool on this machine.
        begun: step at which it was begun.
        recipe: how fast it grows.
        known: seeds whose files are there.
    """

    folder: Path
    make: Callable[[Path, int], None]
    recipe: Recipe
    first_seed: int = 0
    begun: int = 0
    known: set[int] = field(default_factory=set)

    def seeds_at(self, step: int) -> range:
        """Of the scenes that a step may draw from."""
        recipe, done = self.recipe, step - self.begun
        count = recipe.first_walks + min(done // EARLY_STEPS, recipe.early_walks) + done // recipe.steps_per_walk
        return range(self.first_seed + max(0, count - recipe.most_walks), self.first_seed + count)

    def at(self, step: int) -> list[Path]:
        """The files for a step; those that are not there yet are made."""
        seeds = self.seeds_at(step)
        for seed in seeds:
            if seed not in self.known:
                if not self.path(seed).exists():
                    self.make(self.path(seed), seed)
                self.known.add(seed)
        return [self.path(seed) for seed in seeds]

    def path(self, seed: int) -> Path:
        """The file of a scene."""
        return self.folder / f"{seed:08d}.npz"

    def restore(self, step: int, state: Mapping[str, int]) -> None:
        """Go on with the scenes of a checkpoint, or with new ones where they are not here."""
        self.first_seed, self.begun = state["first_seed"], state["begun"]
        seeds = self.seeds_at(step)
        if not all(self.path(seed).exists() for seed in seeds):
            self.first_seed, self.begun = seeds.stop, step


class RecipeTrainer(Trainer):
    """A trainer whose rate, size and batch follow a recipe.

    Args:
        recipe: what is done when.
        folder: of the run.
        make: writes the scene of a seed.
        precision: where and how to compute.
    """

    def __init__(
        self, recipe: Recipe, folder: Path, make: Callable[[Path, int], None], precision: Precision = PROCESSOR
    ) -> None:
        self.recipe = recipe
        self.folder = folder
        super().__init__(TASKS[KIND].variants[recipe.variant], self._stage_config(0), precision)
        slow = {id(parameter) for parameter in self.network.encoder_parameters()}
        groups: list[dict[str, Any]] = [
            {"params": [p for p in self.network.parameters() if id(p) not in slow], "scale": 1.0},
            {"params": self.network.encoder_parameters(), "scale": recipe.encoder_rate},
        ]
        self.optimizer = torch.optim.AdamW(
            groups, lr=recipe.stages[0].rate, weight_decay=self.config.weight_decay, betas=(0.9, 0.99)
        )
        self.pool = WalkSchedule(folder / SCENE_FOLDER, make, recipe)
        self.warm_from = 0
        self.curve: list[dict[str, float]] = []

    def _stage_config(self, index: int) -> TrainConfig:
        recipe, stage = self.recipe, self.recipe.stages[min(index, len(self.recipe.stages) - 1)]
        return TrainConfig(
            pool=str(self.folder / SCENE_FOLDER),
            validation_pool=str(self.folder / VALIDATION_FOLDER),
            size=(stage.height, 2 * stage.height),
            batch=stage.batch,
            rate=stage.rate,
            warmup_steps=recipe.warmup_steps,
            ema=recipe.ema,
            seed=recipe.seed,
            validate_every=recipe.validate_every,
            save_every=recipe.save_every,
            validation_pairs=recipe.validation_pairs,
            guided=stage.guided,
        )

    def rate(self) -> float:
        """Learning rate of the next step."""
        return self.recipe.rate_at(self.step) * min(1.0, (self.step - self.warm_from + 1) / self.recipe.warmup_steps)

    def is_finished(self) -> bool:
        """Whether all stages are over."""
        return self.recipe.stage_at(self.step)[0] == len(self.recipe.stages)

    def begin_stage(self) -> None:
        """Take over the size and the batch of the stage that the next step belongs to."""
        config = self._stage_config(self.recipe.stage_at(self.step)[0])
        if config != self.config:
            self.config, self.best = config, math.inf

    def _begin_batch(self, step: int, pool: list[Path]) -> tuple[int, Future[Any]]:
        """Of the scenes that this step may draw from, which are made first where they are missing."""
        return super()._begin_batch(step, self.pool.at(step))

    def _draw(self, step: int, pool: list[Path]) -> Any:
        stage = self._stage_config(self.recipe.stage_at(step)[0])
        with at_most(1):
            rng = np.random.default_rng([self.config.seed, step])
            return self.task.draw(pool, rng, stage, self.network, Augmentation())

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        pool = {"first_seed": self.pool.first_seed, "begun": self.pool.begun}
        return super().state() | {"pool": pool, "warm_from": self.warm_from, "curve": self.curve}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint, whole or compact."""
        self.config = self._stage_config(self.recipe.stage_at(state["step"])[0])
        super().restore(state)
        self.warm_from = state.get("warm_from", 0) if "optimizer" in state else self.step
        self.curve = [dict(row) for row in state.get("curve", [])]
        self.pool.restore(self.step, state.get("pool", {"first_seed": 0, "begun": 0}))

    def judge(self, seconds: float, loss: float) -> dict[str, float]:
        """A row of the curve, of the averaged weights."""
        network = self.averaged_network()
        with self.precision.autocast():
            scores = self.task.validate(network, self.config)
        self.scores = {name: round(value, 5) for name, value in scores.items() if math.isfinite(value)}
        stage = min(self.recipe.stage_at(self.step)[0] + 1, len(self.recipe.stages))
        about = {"step": self.step, "stage": stage, "seconds": round(seconds, 1), "rate": self.rate()}
        walks = {"walks": self.pool.seeds_at(self.step).stop, "loss": round(loss, 5)}
        row: dict[str, float] = about | walks | self.scores
        self.curve.append(row)
        return row

    @torch.no_grad()
    def sheet(self) -> Float32[np.ndarray, "rows cols 3"]:
        """What the averaged network says of some of the pairs to be judged by, a row for each."""
        network, rows = self.averaged_network(), []
        apart = max(1, self.config.validation_pairs // SHOWN)
        for index, batch in enumerate(self.task.validation(network, self.config)):
            if index % apart == 0 and self.task.pictures is not None:
                shown = self.task.pictures(self.task.answer_of(network, batch), batch)
                rows.append(np.concatenate(list(shown.values()), axis=1))
        return np.concatenate(rows)

    def compact(self) -> dict[str, Any]:
        """The state without what a warm restart does not need."""
        state = self.state()
        return compact(state) | {name: state[name] for name in ("pool", "curve")}


def train_recipe(
    recipe: Recipe,
    folder: Path,
    *,
    textures: Path | None = None,
    meshes: MeshSource | None = None,
    encoder: Mapping[str, Tensor] | None = None,
    begin_with: Path | None = None,
    minutes: float = math.inf,
    report: Callable[[dict[str, float]], None] = lambda row: None,
    precision: Precision = PROCESSOR,
    on_start: Callable[[RecipeTrainer], None] = lambda trainer: None,
) -> RecipeTrainer:
    """Train by a recipe until it is done or the time is over; goes on where ``folder`` was left.

    Writes ``checkpoint.pt`` (to resume), ``best.pt`` and ``latest.pt`` (compact: of the least error so far, and of the
    last validation), ``log.jsonl`` and ``curve.csv`` (a row per validation), ``pictures/NNNNNNNN.png``, and the scenes.

    Args:
        recipe: from :func:`omnisyn_cli.training.recipe.read_recipe`.
        folder: of the run.
        textures: photographs of materials.
        meshes: to walk through.
        encoder: weights of the classifier that the encoder of a fresh run begins with; None for random ones.
        begin_with: a checkpoint, compact or not, or an exported network that a fresh run goes on from.
        minutes: of wall clock, at most.
        report: called with each row of the curve.
        precision: where and how to compute.
        on_start: called once before the first step.

    Raises:
        InputError: textures, meshes or a checkpoint are not what they should be.
        TrainingError: the run has collapsed.
    """
    size, photos = (recipe.height, 2 * recipe.height), None if textures is None else str(textures)
    walks = WalkConfig(size, recipe.kinds, textures=photos, views=recipe.views, meshes=meshes)
    judged_kinds = tuple(kind for kind in VALIDATION_KINDS if kind != MESH or MESH in recipe.kinds)
    judged = replace(walks, kinds=judged_kinds, is_held_out=True)
    walks.check()
    judged.check()
    make_folder(folder, "a network that is trained")
    _make_validation_walks(folder / VALIDATION_FOLDER, recipe.validation_walks, judged)
    trainer = RecipeTrainer(recipe, folder, lambda path, seed: save_samples(path, [make_walk(seed, walks)]), precision)
    _begin(trainer, folder, encoder, begin_with)
    on_start(trainer)
    _run(trainer, folder, minutes, report)
    return trainer


def _make_validation_walks(folder: Path, count: int, config: WalkConfig) -> None:
    """Scenes to be judged by, as far as they are not there."""
    for number in range(count):
        path = folder / f"{number:08d}.npz"
        if not path.exists():
            save_samples(path, [make_walk(VALIDATION_SEED + number, config)])


def _begin(trainer: RecipeTrainer, folder: Path, encoder: Mapping[str, Tensor] | None, begin_with: Path | None) -> None:
    """Go on from the run's own checkpoint, from another one, or from the encoder's weights."""
    own = folder / CHECKPOINT
    path = own if own.exists() else begin_with
    if path is not None:
        state = load_state(path)
        if state["kind"] != KIND:
            raise InputError(f"expected a {KIND} network in {path}, got a {state['kind']} network; name another one")
        with of_this_version(path):
            trainer.restore(state)
    elif encoder is not None:
        trainer.network.load_encoder(encoder)
        trainer.begin_with(trainer.network.state_dict())


def _run(trainer: RecipeTrainer, folder: Path, minutes: float, report: Callable[[dict[str, float]], None]) -> None:
    recipe, path = trainer.recipe, folder / CHECKPOINT
    started, losses = time.monotonic(), list[float]()
    while not trainer.is_finished():
        trainer.begin_stage()
        losses.append(trainer.advance([]))
        is_over = time.monotonic() - started > 60.0 * minutes
        if trainer.step % recipe.validate_every == 0 or trainer.is_finished():
            finite = [loss for loss in losses if math.isfinite(loss)]
            row = trainer.judge(time.monotonic() - started, float(np.mean(finite)) if finite else math.nan)
            losses = []
            _keep(trainer, folder, row)
            report(row)
        if trainer.step % recipe.save_every == 0 or is_over or trainer.is_finished():
            save_checkpoint(path, trainer.state())
        if is_over:
            break


def _keep(trainer: RecipeTrainer, folder: Path, row: Mapping[str, float]) -> None:
    """Write the curve, pictures and compact checkpoints of a validation."""
    append_line(folder / LOG, dict(row))
    write_curve(folder / CURVE, trainer.curve)
    make_folder(folder / "pictures", "pictures")
    write_image(folder / "pictures" / f"{trainer.step:08d}.png", trainer.sheet())
    if trainer.surpasses(trainer.scores["error"]):
        save_checkpoint(folder / BEST_CHECKPOINT, trainer.compact())
    save_checkpoint(folder / LATEST_CHECKPOINT, trainer.compact())


def write_curve(path: Path, rows: list[dict[str, float]]) -> None:
    """A table of all validations.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    with write_errors(path), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
