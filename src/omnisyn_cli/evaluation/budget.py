"""Which preset fits into a number of seconds on this machine, from figures that were measured on another one.

Only presets of the scale from fast to accurate are chosen: what is there to compare with is neither.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.pareto import Figures, Workload, expected_seconds, nearest_figures, quality, read_table
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.interpolation.plan import InterpolationPlan, with_preset
from omnisyn_cli.render.renderer import MeshRenderer
from omnisyn_cli.runtime.threads import available_threads
from omnisyn_cli.synthesis.presets import SCALE

__all__ = ["apply_budget"]


@dataclass(frozen=True)
class Choice:
    """A preset for a job.

    Attributes:
        preset: its name.
        expected: seconds that the job is expected to take with each preset that was measured.
        budget: seconds that it may take.
    """

    preset: str
    expected: dict[str, float]
    budget: float

    @property
    def fits(self) -> bool:
        """Whether the job is expected to be done in time."""
        return self.expected[self.preset] <= self.budget

    def __str__(self) -> str:
        own = f"{self.expected[self.preset]:.1f} s"
        if not self.fits:
            return (
                f"even the fastest preset, {self.preset}, is expected to take {own}, more than the budget of "
                f"{self.budget:g} s; it is taken (fewer frames or a smaller --size help)"
            )
        others = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in self.expected.items() if name != self.preset)
        rest = f" ({others})" if others else ""
        return f"preset {self.preset} for a budget of {self.budget:g} s: expected to take {own}{rest}"


def shipped_table() -> tuple[Figures, ...]:
    """The figures that came with the program.

    Raises:
        InputError: they are missing or damaged.
    """
    return read_table(Path(str(files("omnisyn_cli"))) / "evaluation" / "pareto.json")


def apply_budget(plan: InterpolationPlan, budget: float) -> InterpolationPlan:
    """The plan with the most accurate preset that is expected to be done in time, and a note that says so.

    Args:
        plan: of the job; its preset only says what is drawn, and how.
        budget: seconds that the whole run may take.

    Raises:
        InputError: the job asks for something that was not measured, or no preset was.
    """
    _check_measured(plan)
    work = Workload(
        len(plan.entries), len(plan.path), plan.size, max(plan.source_sizes),
        calibrate(plan.job.threads), plan.recipe.depth.kind != "file",
    )  # fmt: skip
    choice = choose_preset(shipped_table(), work, plan.job.threads or available_threads(), budget)
    if plan.recipe.depth.kind == "file":
        return replace(plan, notes=(*plan.notes, _without_choice(choice)))
    chosen = with_preset(plan, choice.preset)
    return replace(chosen, notes=(*chosen.notes, str(choice)))


def _check_measured(plan: InterpolationPlan) -> None:
    """Presets were measured as they are, on the processor; depth from files takes no time."""
    job = plan.job
    asked = {
        "renderer": (plan.recipe.renderer, ("mesh",)),
        "depth": (job.depth, ("auto", "file", "refined")),
        "model": (job.model, (None,)),
        "fusion": (job.fusion, ("auto",)),
        "device": ("cuda" if plan.recipe.is_on_gpu else "cpu", ("cpu",)),
    }
    for name, (given, measured) in asked.items():
        if given not in measured:
            usual = f"the {name} {measured[0]!r}" if measured[0] else f"no {name}"
            raise InputError(
                f"expected {usual} with a budget, got {given!r}, whose times were not measured; leave one of them out"
            )


def _without_choice(choice: Choice) -> str:
    seconds = min(choice.expected.values())
    verdict = "within" if seconds <= choice.budget else "more than"
    return (
        f"depth comes from files, so presets make no difference: expected to take {seconds:.1f} s, {verdict} the "
        f"budget of {choice.budget:g} s"
    )


def choose_preset(table: Sequence[Figures], work: Workload, threads: int, budget: float) -> Choice:
    """The most accurate preset that fits into ``budget`` seconds, or the fastest where none does.

    Raises:
        InputError: no preset of this version was measured.
    """
    measured = {
        name: figures
        for name, preset in SCALE.items()
        if (figures := nearest_figures(table, name, preset.recipe.depth.rows, work.size, threads)) is not None
    }
    if not measured:
        raise InputError(f"expected figures of {', '.join(SCALE)} in the table, got none; run omnisyn bench --store")
    expected = {name: expected_seconds(figures, work) for name, figures in measured.items()}
    fitting = [name for name, seconds in expected.items() if seconds <= budget]
    best = (
        max(fitting, key=lambda name: quality(measured[name])) if fitting else min(expected, key=expected.__getitem__)
    )
    return Choice(best, expected, budget)


SECONDS = 0.8
"""How long steps are repeated; with the last one that is below two seconds on any machine worth using."""

SIZE = (256, 512)
"""Of the surfaces and of the picture."""

BASELINE = 1.0


def calibrate(threads: int | None = None, seconds: float = SECONDS) -> float:
    """Seconds of one step: the median over as many as fit into ``seconds``, three at least.

    Args:
        threads: at most this many; None is one per core.
        seconds: how long to go on.
    """
    step = _step(threads)
    step()
    begin = time.perf_counter()
    marks = [begin]
    while len(marks) < 4 or marks[-1] - begin < seconds:
        step()
        marks.append(time.perf_counter())
    return statistics.median(after - before for before, after in pairwise(marks))


def _step(threads: int | None) -> Callable[[], None]:
    """The work: a ball of a room with a bump, seen from both ends of a way."""
    directions = pixel_directions(*SIZE)
    inverse_depth = np.asarray(0.3 + 0.2 * (directions[..., 1] < 0) + 0.3 * (directions[..., 0] > 0.8), np.float32)
    image = np.asarray(0.5 + 0.5 * np.sin(40 * directions), np.float32)
    renderers = [MeshRenderer(image, None, inverse_depth, None, SIZE, None, threads) for _ in range(2)]
    fuser = GeometricFuser(SIZE, threads=threads)
    poses = [Pose(np.eye(3), np.array([0.0, 0.0, side * BASELINE / 2])) for side in (-1, 1)]

    def work() -> None:
        first, second = (render(pose) for render, pose in zip(renderers, poses, strict=True))
        fuser(first, second, 0.5)

    return work
