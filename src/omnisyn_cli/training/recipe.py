"""Recipes: a whole training in one file, read from TOML.

:mod:`omnisyn_cli.training.recipe_run` does what they say.
"""

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.documents import read_text
from omnisyn_cli.training.tasks import TASKS
from omnisyn_cli.training.walks import WalkConfig

KIND = "guided"
"""Of the networks that recipes train, see :data:`omnisyn_cli.training.tasks.TASKS`."""

EARLY_STEPS = 3
"""Steps until the next of the early scenes."""


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
        early_walks: that come soon, one every :data:`EARLY_STEPS` steps, as few scenes are soon known by heart.
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


def read_recipe(path: Path) -> Recipe:
    """A recipe from a TOML file; its keys are the attributes of :class:`Recipe`, with ``[[stages]]``.

    Raises:
        InputError: no such file, no TOML, or unknown, missing or impossible values.
    """
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
