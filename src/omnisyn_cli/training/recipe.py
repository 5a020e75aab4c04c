"""A whole training from one file: which scenes are made, which stages follow each other, how it is judged.

Scenes are made between the steps: a few before the first one, then one every so many steps, until there are enough. So
training begins at once, and which scenes a step may draw from depends on its number alone. A run that is killed goes on
bit for bit. On another machine, where its scenes are not, it makes new ones, with seeds that it has not seen.
"""

import csv
import math
import time
import tomllib
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
from omnisyn_cli.training.checkpoint import compact, load_checkpoint, of_this_version, save_checkpoint
from omnisyn_cli.training.data import Augmentation
from omnisyn_cli.training.loop import BEST, CHECKPOINT, PROCESSOR, Trainer
from omnisyn_cli.training.precision import Precision
from omnisyn_cli.training.task import TrainConfig
from omnisyn_cli.training.tasks import TASKS
from omnisyn_cli.training.walks import MESH, MeshSource, WalkConfig, make_walk, save_walk

__all__ = ["Recipe", "Stage", "read_recipe", "train_recipe"]

POOL, VALIDATION_POOL, LOG, CURVE, LATEST = (
    "walks", "validation-walks", "log.jsonl", "curve.csv", "latest.pt",
)  # fmt: skip
"""Names in the folder of a run."""

EARLY = 3
"""Steps until the next of the early scenes."""

VALIDATION_SEED = 1_000_000
"""Of the first scene to be judged by; scenes to learn from have smaller ones."""

VALIDATION_KINDS = (MESH, "home", MESH, "street", MESH, "room", MESH, "yard", MESH, "jumble", MESH)
"""Kinds of scenes to be judged by, in turn."""

SHOWN = 5
"""Pairs that a picture of the run shows."""

KIND = "guided"
"""Of the networks that recipes train, see :data:`omnisyn_cli.training.tasks.TASKS`."""


@dataclass(frozen=True)
class Stage:
    """Some steps of one size.

    Attributes:
        height: rows of the images, twice as many columns.
        batch: pairs per step.
        steps: of this stage.
        rate: learning rate at its beginning.
        final_rate: at its end; between both along a cosine.
        guided: share of the pairs that are shown with what matching would say.
    """

    height: int
    batch: int
    steps: int
    rate: float
    final_rate: float
    guided: float = 0.0


@dataclass(frozen=True)
class Recipe:
    """What a training consists of.

    Attributes:
        variant: of the network.
        stages: one after the other.
        kinds: of scenes in turn, see :class:`~omnisyn_cli.training.walks.WalkConfig`.
        height: rows of the scenes that are made.
        views: of each.
        first_walks: scenes that are made before the first step.
        early_walks: that come soon, one every :data:`EARLY` steps, as few scenes are soon known by heart.
        steps_per_walk: steps until one more is made, from the beginning.
        most_walks: scenes of a pool at most; from then on the oldest are left out as new ones come.
        validation_walks: scenes to be judged by, meshes held out and the other kinds in turn.
        validation_pairs: pairs of those.
        validate_every: steps.
        save_every: steps.
        warmup_steps: over which the rate rises from zero, at the beginning and after a restart without an optimiser.
        encoder_rate: learning rate of the pretrained encoder, as a share of that of the rest.
        ema: decay of the average of weights.
        seed: of the weights, the batches and the scenes.
    """

    variant: str
    stages: tuple[Stage, ...]
    kinds: tuple[str, ...] = WalkConfig.kinds
    height: int = 256
    views: int = 4
    first_walks: int = 24
    early_walks: int = 120
    steps_per_walk: int = 10
    most_walks: int = 4000
    validation_walks: int = 22
    validation_pairs: int = 44
    validate_every: int = 500
    save_every: int = 100
    warmup_steps: int = 200
    encoder_rate: float = 0.15
    ema: float = 0.999
    seed: int = 0

    def stage_at(self, step: int) -> tuple[int, int]:
        """Index of the stage that a step belongs to, and the number of the step in it; past the end for none."""
        for index, stage in enumerate(self.stages):
            if step < stage.steps:
                return index, step
            step -= stage.steps
        return len(self.stages), 0

    def rate_at(self, step: int) -> float:
        """Learning rate of a step, without any warm-up."""
        index, done = self.stage_at(step)
        if index == len(self.stages):
            return self.stages[-1].final_rate
        stage = self.stages[index]
        share = 0.5 * (1.0 + math.cos(math.pi * done / stage.steps))
        return stage.final_rate + (stage.rate - stage.final_rate) * share


@dataclass
class WalkPool:
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
        count = recipe.first_walks + min(done // EARLY, recipe.early_walks) + done // recipe.steps_per_walk
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
        self.pool = WalkPool(folder / POOL, make, recipe)
        self.warm_from = 0
        self.curve: list[dict[str, float]] = []

    def _stage_config(self, index: int) -> TrainConfig:
        recipe, stage = self.recipe, self.recipe.stages[min(index, len(self.recipe.stages) - 1)]
        return TrainConfig(
            pool=str(self.folder / POOL),
            validation_pool=str(self.folder / VALIDATION_POOL),
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


def read_recipe(path: Path) -> Recipe:
    """A recipe from a TOML file; its keys are the attributes of :class:`Recipe`, with ``[[stages]]``.

    Raises:
        InputError: no such file, no TOML, or unknown, missing or impossible values.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
        stages = tuple(Stage(**stage) for stage in values.pop("stages", []))
        lists = {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
        recipe = Recipe(stages=stages, **(values | lists))
    except FileNotFoundError:
        raise InputError(f"expected a recipe at {path}, found no file") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, TypeError) as error:
        raise InputError(f"expected a recipe in {path}, got '{error!s:.160}'") from error
    _check(recipe, path)
    return recipe


def _check(recipe: Recipe, path: Path) -> None:
    variants = TASKS[KIND].variants
    if recipe.variant not in variants:
        raise InputError(f"expected a variant of {', '.join(variants)} in {path}, got {recipe.variant!r}")
    multiple = variants[recipe.variant].size_multiple
    sizes = [stage.height for stage in recipe.stages]
    if not sizes or any(recipe.height % size or size % multiple for size in sizes):
        raise InputError(
            f"expected stages whose heights are multiples of {multiple} and fractions of {recipe.height} in {path}, "
            f"got {', '.join(map(str, sizes)) or 'none'}"
        )
    whole = ("views", "first_walks", "steps_per_walk", "most_walks", "validation_walks", "validation_pairs")
    every = ("validate_every", "save_every", "warmup_steps")
    small = [name for name in (*whole, *every) if getattr(recipe, name) < 1]
    small += [name for stage in recipe.stages for name in ("batch", "steps") if getattr(stage, name) < 1]
    if small or recipe.views < 2:
        raise InputError(f"expected at least 1 for {', '.join(small) or 'views'} (views: 2) in {path}")


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
        recipe: from :func:`read_recipe`.
        folder: of the run.
        textures: photographs of materials.
        meshes: to walk through.
        encoder: weights of the classifier that the encoder of a fresh run begins with; None for random ones.
        begin_with: a checkpoint, compact or not, that a fresh run goes on from.
        minutes: of wall clock, at most.
        report: called with each row of the curve.
        precision: where and how to compute.
        on_start: called once before the first step.

    Raises:
        InputError: textures, meshes or a checkpoint are not what they should be.
        TrainingError: the run has collapsed.
    """
    size = (recipe.height, 2 * recipe.height)
    walks = WalkConfig(
        size, recipe.views, recipe.kinds, textures=None if textures is None else str(textures), meshes=meshes
    )
    judged = replace(walks, kinds=VALIDATION_KINDS, is_held_out=True)
    if MESH not in recipe.kinds:
        judged = replace(judged, kinds=tuple(kind for kind in VALIDATION_KINDS if kind != MESH))
    walks.check()
    judged.check()
    make_folder(folder, "a network that is trained")
    for number in range(recipe.validation_walks):
        path = folder / VALIDATION_POOL / f"{number:08d}.npz"
        if not path.exists():
            save_walk(path, make_walk(VALIDATION_SEED + number, judged))
    trainer = RecipeTrainer(recipe, folder, lambda path, seed: save_walk(path, make_walk(seed, walks)), precision)
    _begin(trainer, folder, encoder, begin_with)
    on_start(trainer)
    _run(trainer, folder, minutes, report)
    return trainer


def _begin(trainer: RecipeTrainer, folder: Path, encoder: Mapping[str, Tensor] | None, begin_with: Path | None) -> None:
    """Go on from the run's own checkpoint, from another one, or from the encoder's weights."""
    own = folder / CHECKPOINT
    path = own if own.exists() else begin_with
    if path is not None:
        state = load_checkpoint(path)
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
        save_checkpoint(folder / BEST, trainer.compact())
    save_checkpoint(folder / LATEST, trainer.compact())


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
