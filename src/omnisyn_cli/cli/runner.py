"""What `interpolate`, `export` and `view` do with a plan: say it, carry it out, say what was done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from omnisyn_cli.cli.options import print_json, print_plan
from omnisyn_cli.cli.progress import counted_bar, say_when_compiling
from omnisyn_cli.cli.terminal import say

if TYPE_CHECKING:
    from omnisyn_cli.interpolation.plan import TourPlan
    from omnisyn_cli.interpolation.summary import TourSummary

P = TypeVar("P", bound="TourPlan")
S = TypeVar("S", bound="TourSummary")


def run_plan(
    plan: P,
    load: Callable[[], Callable[[P, Callable[[int], None] | None], S]],
    steps: int,
    unit: Callable[[int], str | None],
    report: Callable[[S], None],
    *,
    as_json: bool,
    dry_run: bool,
    quiet: bool,
    expected: Callable[[], Mapping[str, Any]] = dict,
    listen: Callable[[str], None] = lambda note: None,
) -> S | None:
    """Print a plan and stop, or carry it out.

    Args:
        plan: what was planned.
        load: imports what carries it out, which is called with the plan and what counts its steps.
        steps: of the progress bar.
        unit: what is counted, given how much is done; None while depth is being found.
        report: prints for people what was done.
        as_json: whether JSON is printed instead.
        dry_run: whether nothing is to be made.
        quiet: whether nothing but errors is printed.
        expected: what else is said of the plan.
        listen: is told about kernels that are compiled.
    """
    if not quiet:
        for note in plan.notes:
            say(f"note: {note}", err=True)
    if dry_run:
        print_plan({**plan.describe(), **expected()}, as_json=as_json)
        return None
    from omnisyn_cli.interpolation.recipes import check_device

    check_device(plan.recipe)
    click.get_current_context().with_resource(say_when_compiling(is_quiet=quiet, listen=listen))
    run = load()
    with counted_bar("depth", steps, unit, is_quiet=quiet) as on_step:
        summary = run(plan, on_step)
    if not quiet:
        for warning in summary.warnings():
            say(f"warning: {warning}", err=True)
    if as_json:
        print_json(summary.describe())
    elif not quiet:
        report(summary)
    return summary
