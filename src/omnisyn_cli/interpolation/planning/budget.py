"""Which preset shows the best picture within a number of seconds on this machine.

Only presets of the scale from fast to balanced are chosen: what is there to compare with is neither.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.plan import InterpolationPlan, with_preset
from omnisyn_cli.interpolation.planning.duration import Duration, expected_duration, shipped_table
from omnisyn_cli.interpolation.planning.figures import Figures, gain, quality
from omnisyn_cli.pipeline.presets import SCALE


@dataclass(frozen=True)
class Choice:
    """A preset for a job.

    Attributes:
        preset: its name.
        expected: what the job is expected to take with each preset that was measured.
        budget: seconds that it may take.
        more: what the preset that shows the best picture of all gains, and how sure that is, in words; or nothing.
    """

    preset: str
    expected: dict[str, Duration]
    budget: float
    more: str = ""

    @property
    def fits(self) -> bool:
        """Whether the job is expected to be done in time."""
        return self.expected[self.preset].seconds <= self.budget

    def __str__(self) -> str:
        own = self.expected[self.preset]
        if not self.fits:
            return (
                f"even the fastest preset, {self.preset}, is expected to take {own.words}, more than the budget of "
                f"{self.budget:g} s; it is taken (fewer frames or a smaller --size help){self.more}"
            )
        return f"preset {self.preset} for a budget of {self.budget:g} s: expected to take {own.words}{self.more}"


def apply_budget(plan: InterpolationPlan, budget: float) -> InterpolationPlan:
    """The plan with the preset of the best picture that is expected to be done in time, and a note that says so.

    Args:
        plan: of the job; its preset only says what is drawn, and how.
        budget: seconds that the whole run may take.

    Raises InputError: the job asks for something that was not measured, or no preset was.
    """
    _check_measured(plan)
    table = shipped_table()
    if not plan.config.estimates_depth:
        return replace(plan, notes=(*plan.notes, _without_choice(expected_duration(plan, table), budget)))
    choice = choose_preset(plan, table, budget)
    chosen = with_preset(plan, choice.preset)
    return replace(chosen, notes=(*chosen.notes, str(choice)))


def _check_measured(plan: InterpolationPlan) -> None:
    """Pictures were compared with presets as they are; depth from files takes no time."""
    job = plan.job
    asked = {
        "renderer": (plan.config.renderer, ("mesh",)),
        "depth": (job.depth, ("auto", "file", "refined")),
        "model": (job.model, (None,)),
        "depth_prior": (job.depth_prior, (None,)),
        "fusion": (job.fusion, ("auto",)),
    }
    for name, (given, measured) in asked.items():
        if given not in measured:
            default = f"the {name} {measured[0]!r}" if measured[0] else f"no {name}"
            raise InputError(
                f"expected {default} with a budget, got {given!r}, with which presets were not compared; leave one of "
                "them out"
            )


def _without_choice(expected: Duration | None, budget: float) -> str:
    if expected is None:
        raise InputError("expected a renderer and a fusion that were measured with a budget, got others; leave it out")
    verdict = "within" if expected.seconds <= budget else "more than"
    return (
        f"depth comes from files, so presets make no difference: expected to take {expected.words}, {verdict} the "
        f"budget of {budget:g} s"
    )


def choose_preset(plan: InterpolationPlan, table: Sequence[Figures], budget: float) -> Choice:
    """The preset of the best picture that fits into ``budget`` seconds, or the fastest where none does.

    InputError: no preset of this version was measured.
    """
    measured = {name: found for name in SCALE if (found := _scored(table, name)) is not None}
    expected = {
        name: duration
        for name in measured
        if (duration := expected_duration(with_preset(plan, name), table)) is not None
    }
    if not expected:
        raise InputError(f"expected figures of {', '.join(SCALE)} in the table, got none; run omnisyn bench --store")
    fitting = [name for name, duration in expected.items() if duration.seconds <= budget]
    fastest = next(iter(expected))  # by the scale: runs that are remembered may be of one preset, on a busy machine
    chosen = max(fitting, key=lambda name: quality(measured[name]), default=fastest)
    best = max(expected, key=lambda name: quality(measured[name]))
    return Choice(chosen, expected, budget, "" if best == chosen else _more(best, expected, measured, chosen))


def _scored(table: Sequence[Figures], preset: str) -> Figures | None:
    """Figures of a preset in the size with the most pixels that it has scores in."""
    rated = [f for f in table if f.scores and f.config == SCALE[preset].config]
    return max(rated, key=lambda f: math.prod(f.setting.size), default=None)


def _more(best: str, expected: dict[str, Duration], measured: dict[str, Figures], chosen: str) -> str:
    gained, error = gain(measured[best], measured[chosen])
    return (
        f"; {best} would take {expected[best].words} for {gained:+.2f} ± {error:.2f} dB "
        f"(the mean of {len(measured[best].scores)} scenes of omnisyn bench)"
    )
