"""Recipes: a whole training in one file. Scenes are made, stage follows stage, everything can be cut off and goes on.

Scenes are made between the steps: a few before the first one, then one every so many steps, until there are enough. So
training begins at once, and which scenes a step may draw from depends on its number alone. A run that is killed goes on
bit for bit. On another machine, where its scenes are not, it makes new ones, with seeds that it has not seen.
"""

import csv
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.documents import read_text
from omnisyn_cli.io.outputs import make_folder, write_errors
from omnisyn_cli.networks.efficientnet import from_classifier
from omnisyn_cli.training.checkpoint import compact, of_this_version, save_checkpoint
from omnisyn_cli.training.data import save_samples
from omnisyn_cli.training.loop import CHECKPOINT, PROCESSOR, Precision, Trainer, run, state_of
from omnisyn_cli.training.scene_makers import scene_path
from omnisyn_cli.training.tasks import TASKS, TrainConfig
from omnisyn_cli.training.walks import MESH, MeshSource, WalkConfig, make_walk

KIND = "guided"  # Of the networks that recipes train, see :data:`omnisyn_cli.training.tasks.TASKS`
SCENE_FOLDER, VALIDATION_FOLDER = "walks", "validation-walks"  # Folders of scenes in the folder of a run
CURVE, LATEST_CHECKPOINT = "curve.csv", "latest.pt"  # Files there, besides those of every run
VALIDATION_SEED = 1_000_000  # Of the first scene to be judged by; scenes to learn from have smaller ones
VALIDATION_KINDS = (MESH, "home", MESH, "street", MESH, "room", MESH)  # Kinds of scenes to be judged by, in turn
SHOWN = 5  # Pairs that a picture of the run shows
EARLY_STEPS = 3  # Steps until the next of the early scenes


@dataclass(frozen=True)
class Stage:
    """Some steps of one size."""

    height: int  # rows of the images, twice as many columns
    batch: int  # pairs per step
    steps: int  # of this stage
    rate: float  # learning rate at its beginning
    final_rate: float  # at its end; between both along a cosine


@dataclass(frozen=True)
class Recipe:
    """What a training consists of."""

    variant: str  # of the network
    stages: tuple[Stage, ...]  # one after the other
    kinds: tuple[str, ...] = WalkConfig.kinds  # of scenes in turn, see WalkConfig
    height: int = 256  # rows of the scenes that are made
    views: int = 4  # of each
    first_walks: int = 24  # scenes that are made before the first step
    early_walks: int = 120  # that come soon, one every EARLY_STEPS steps, as few scenes are soon known by heart
    steps_per_walk: int = 10  # steps until one more is made, from the beginning
    most_walks: int = 4000  # scenes of a pool at most; from then on the oldest are left out as new ones come
    validation_walks: int = 22  # scenes to be judged by, meshes held out and the other kinds in turn
    validation_pairs: int = 44  # pairs of those
    validate_every: int = 500  # steps
    save_every: int = 100  # steps
    warmup_steps: int = 200  # over which the rate rises from zero, at the beginning and after a start without optimiser
    encoder_rate: float = 0.15  # learning rate of the pretrained encoder, as a share of that of the rest
    ema: float = 0.999  # decay of the average of weights
    seed: int = 0  # of the weights, the batches and the scenes

    def stage_at(self, step: int) -> tuple[int, int]:
        """Index of the stage that a step belongs to, and the number of the step in it; past the end for none."""
        for index, stage in enumerate(self.stages):
            if step < stage.steps:
                return index, step
            step -= stage.steps
        return len(self.stages), 0

    def walks_after(self, steps: int) -> range:
        """The scenes that may be drawn from so many steps after the first one was made, by their order."""
        count = self.first_walks + min(steps // EARLY_STEPS, self.early_walks) + steps // self.steps_per_walk
        return range(max(0, count - self.most_walks), count)

    def rate_at(self, step: int) -> float:
        """Learning rate of a step, without any warm-up."""
        index, done = self.stage_at(step)
        if index == len(self.stages):
            return self.stages[-1].final_rate
        stage = self.stages[index]
        share = 0.5 * (1.0 + math.cos(math.pi * done / stage.steps))
        return stage.final_rate + (stage.rate - stage.final_rate) * share


def read_recipe(path: Path) -> Recipe:
    """A recipe from TOML: attributes of :class:`Recipe`, with ``[[stages]]``; InputError: no file, or wrong values."""
    try:
        values = tomllib.loads(read_text(path, "a recipe", error=InputError))
        stages = tuple(Stage(**stage) for stage in values.pop("stages", []))
        lists = {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
        recipe = Recipe(stages=stages, **(values | lists))
        _check(recipe, path)
    except (ValueError, TypeError, ArithmeticError, RecursionError) as error:  # of TOML, and of values of other kinds
        raise InputError(f"expected a recipe in {path}, got '{error!s:.160}'") from error
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


class RecipeTrainer(Trainer):
    """A trainer whose rate, size and batch follow a recipe, and which makes its scenes in the folder of the run."""

    judged_by = "error"

    def __init__(self, recipe: Recipe, folder: Path, walks: WalkConfig, precision: Precision = PROCESSOR) -> None:
        self.recipe = recipe
        self.folder = folder
        self.walks = walks
        self.first_seed = self.begun = self.warm_from = 0
        self.known = set[int]()
        self.curve: list[dict[str, float]] = []
        super().__init__(TASKS[KIND].variants[recipe.variant], self.config_at(0), precision)

    def parameter_groups(self) -> list[dict[str, Any]]:
        """The pretrained encoder has a rate of its own."""
        encoder = list(self.network.encoder.parameters())
        slow = {id(parameter) for parameter in encoder}
        rest = [parameter for parameter in self.network.parameters() if id(parameter) not in slow]
        return [{"params": rest, "scale": 1.0}, {"params": encoder, "scale": self.recipe.encoder_rate}]

    def config_at(self, step: int) -> TrainConfig:
        """The stage that a step belongs to; past the end the last one."""
        recipe, last = self.recipe, len(self.recipe.stages) - 1
        stage = recipe.stages[min(recipe.stage_at(step)[0], last)]
        pool, judged = (str(self.folder / name) for name in (SCENE_FOLDER, VALIDATION_FOLDER))
        shared = ("warmup_steps", "ema", "seed", "validate_every", "save_every", "validation_pairs")
        values: dict[str, Any] = {name: getattr(recipe, name) for name in shared}
        return TrainConfig(pool, judged, (stage.height, 2 * stage.height), stage.batch, stage.rate, **values)

    def rate(self) -> float:
        """Learning rate of the next step."""
        return self.recipe.rate_at(self.step) * min(1.0, (self.step - self.warm_from + 1) / self.recipe.warmup_steps)

    def is_finished(self) -> bool:
        """Whether all stages are over."""
        return self.recipe.stage_at(self.step)[0] == len(self.recipe.stages)

    def seeds_at(self, step: int) -> range:
        """Of the scenes that a step may draw from."""
        walks = self.recipe.walks_after(step - self.begun)
        return range(self.first_seed + walks.start, self.first_seed + walks.stop)

    def scenes_at(self, step: int) -> list[Path]:
        """The files that a step draws from; those that are not there yet are made."""
        paths = {seed: scene_path(self.folder / SCENE_FOLDER, seed) for seed in self.seeds_at(step)}
        for seed in paths.keys() - self.known:
            make_missing_walk(paths[seed], seed, self.walks)
            self.known.add(seed)
        return list(paths.values())

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        pool = {"first_seed": self.first_seed, "begun": self.begun}
        return super().state() | {"pool": pool, "warm_from": self.warm_from, "curve": self.curve}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint, whole or compact: with its scenes, or with new ones where they are not here."""
        self.config = self.config_at(state["step"])
        super().restore(state)
        self.warm_from = state.get("warm_from", 0) if "optimizer" in state else self.step
        self.curve = [dict(row) for row in state.get("curve", [])]
        pool = state.get("pool", {"first_seed": 0, "begun": 0})
        self.first_seed, self.begun = pool["first_seed"], pool["begun"]
        seeds = self.seeds_at(self.step)
        if not all(scene_path(self.folder / SCENE_FOLDER, seed).exists() for seed in seeds):
            self.first_seed, self.begun = seeds.stop, self.step

    def about(self) -> dict[str, float]:
        """The stage, and the number of scenes so far."""
        stage = min(self.recipe.stage_at(self.step)[0] + 1, len(self.recipe.stages))
        return {"stage": stage, "walks": self.seeds_at(self.step).stop}

    @torch.no_grad()
    def sheet(self, network: Any) -> Float32[np.ndarray, "rows cols 3"]:
        """Some of the pairs to be judged by, a row for each."""
        rows, apart = [], max(1, self.config.validation_pairs // SHOWN)
        for index, batch in enumerate(self.task.validation(network, self.config)):
            if index % apart == 0 and self.task.pictures is not None:
                shown = self.task.pictures(self.task.answer_of(network, batch), batch)
                rows.append(np.concatenate(list(shown.values()), axis=1))
        return np.concatenate(rows)

    def end_validation(self, folder: Path, row: dict[str, Any]) -> None:
        """Write the table of all validations, and the latest weights."""
        self.curve.append(row)
        names = list(dict.fromkeys(name for each in self.curve for name in each))
        with write_errors(folder / CURVE), (folder / CURVE).open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            writer.writerows(self.curve)
        save_checkpoint(folder / LATEST_CHECKPOINT, compact(self.state()))


def train_recipe(
    recipe: Recipe, folder: Path, *, textures: Path | None = None, meshes: MeshSource | None = None,
    encoder: Mapping[str, Tensor] | None = None, begin_with: Path | None = None, minutes: float = math.inf,
    report: Callable[[dict[str, float]], None] = lambda row: None, precision: Precision = PROCESSOR,
    on_start: Callable[[RecipeTrainer], None] = lambda trainer: None,
) -> RecipeTrainer:  # fmt: skip
    """Train by a recipe until it is done or the time is over; goes on where ``folder`` was left.

    Writes ``checkpoint.pt`` (to resume), ``best.pt`` and ``latest.pt`` (compact: of the least error, of the last
    validation), ``log.jsonl`` and ``curve.csv`` (a row per validation), ``pictures/NNNNNNNN.png``, and the scenes. A
    fresh run begins with a checkpoint or exported network, else with a classifier's weights in its encoder, or random
    ones. The last four arguments are those of :func:`omnisyn_cli.training.loop.train`. InputError: unusable textures,
    meshes or checkpoint; TrainingError: it has collapsed.
    """
    photos, size = None if textures is None else str(textures), (recipe.height, 2 * recipe.height)
    walks = WalkConfig(size, recipe.kinds, textures=photos, views=recipe.views, meshes=meshes)
    judged_kinds = tuple(kind for kind in VALIDATION_KINDS if kind != MESH or MESH in recipe.kinds)
    judged = replace(walks, kinds=judged_kinds, is_held_out=True)
    walks.check()
    judged.check()
    make_folder(folder, "a network that is trained")
    for number in range(recipe.validation_walks):
        make_missing_walk(scene_path(folder / VALIDATION_FOLDER, number), VALIDATION_SEED + number, judged)
    trainer, own = RecipeTrainer(recipe, folder, walks, precision), folder / CHECKPOINT
    path = own if own.exists() else begin_with
    if path is not None:
        state = state_of(path, KIND)
        with of_this_version(path):
            trainer.restore(state)
    elif encoder is not None:
        trainer.network.encoder.load_state_dict(from_classifier(encoder))
        trainer.begin_with({})
    on_start(trainer)
    run(trainer, folder, minutes, None, report)
    return trainer


def make_missing_walk(path: Path, seed: int, config: WalkConfig) -> None:
    """Write the walk of a seed unless it is there."""
    if not path.exists():
        save_samples(path, [make_walk(seed, config)])
