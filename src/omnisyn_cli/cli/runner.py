"""What `interpolate`, `export` and `view` do with a job: plan it, say the plan, carry it out, say what was done."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, TypeVar

from omnisyn_cli.cli.progress import Stages, leftover_notes, memory_notes, say_when_compiling, shown_stages
from omnisyn_cli.cli.terminal import print_json, say

if TYPE_CHECKING:
    from omnisyn_cli.interpolation.job import TourJob
    from omnisyn_cli.interpolation.plan import TourPlan
    from omnisyn_cli.interpolation.summary import TourSummary

J = TypeVar("J", bound="TourJob")
P = TypeVar("P", bound="TourPlan")
S = TypeVar("S", bound="TourSummary")


def run_job(
    job: J, plan_of: Callable[[J], P], function: str, report: Callable[[S], None], *, as_json: bool, dry_run: bool,
    quiet: bool, expected: Callable[[P], Mapping[str, Any]] = lambda plan: {},
    frames: Callable[[P], int] = lambda plan: 0, is_report_possible: bool = True,
) -> S | None:  # fmt: skip
    """Plan a job by ``plan_of``, print the plan and stop, or carry it out, and print by ``report`` what was done.

    ``function`` has the module and name of what carries it out, which is called with the plan and what counts its
    ``frames``. ``expected`` is what else is said of the plan. The report is possible if panoramas are still there when
    the command has ended.
    """
    from pkgutil import resolve_name

    from omnisyn_cli.interpolation.job import OUTPUTS, POSES_FROM_PICTURES
    from omnisyn_cli.interpolation.planning.prior import with_prior_cost
    from omnisyn_cli.io.outputs import TEMPORARY_PREFIX, claimed

    with nullcontext() if dry_run else claimed(job.output), shown_stages(is_quiet=quiet) as stages:
        places = [place for name in OUTPUTS if (place := getattr(job, name, None)) is not None]
        places += [folder for folder in (job.images[0].parent,) if folder.name.startswith(TEMPORARY_PREFIX)]
        _say_notes(stages, leftover_notes(*places))  # before the output is refused
        if job.refine or job.poses == POSES_FROM_PICTURES:
            stages.show("poses")
        plan = with_prior_cost(plan_of(job), is_measured=dry_run)
        _say_notes(stages, plan.notes)
        values = {**plan.describe(), **expected(plan)}
        _say_notes(stages, memory_notes(values["memory_mib"] * 2**20))
        if dry_run:
            if as_json or not quiet:
                _print_plan(values, plan.in_words(values), as_json=as_json)
            return None
        from omnisyn_cli.compute.jit import while_compiling
        from omnisyn_cli.compute.stopwatch import while_timing
        from omnisyn_cli.interpolation.configs import check_device

        count = frames(plan)
        _say_notes(stages, check_device(plan.config, makes_frames=bool(count)))
        stages.log(plan.in_words(values))
        stages.expect(reading=len(plan.entries), depth=len(plan.pairs), **({"frames": count} if count else {}))
        is_unsaid = quiet or stages.has_bars  # which say it themselves
        with say_when_compiling(is_quiet=is_unsaid), while_compiling(stages.compile):
            run: Callable[[P, Callable[[int], None]], S] = resolve_name(f"omnisyn_cli.interpolation.{function}")
            from omnisyn_cli.interpolation.kernel_warm_up import compiling_beside

            with while_timing(stages.time), compiling_beside(job.threads):
                summary = run(plan, lambda done: stages.show("frames", done) if count and done > 1 else None)
    if not quiet:
        for warning in summary.warnings():
            say(f"warning: {warning}", err=True)
    if as_json:
        print_json(summary.describe())
    elif not quiet:
        report(summary)
        for line in summary.lines(is_report_possible=is_report_possible):
            say(line)
    return summary


def _say_notes(stages: Stages, notes: Iterable[str]) -> None:
    for note in notes:
        stages.note(f"note: {note}")


def _print_plan(values: dict[str, Any], sentence: str, *, as_json: bool) -> None:
    """Print a plan as JSON; or a sentence, and a line for each value that says something new."""
    if as_json:
        print_json(values)
        return
    say(sentence)
    for key, value in values.items():
        shown = ", ".join(map(str, value)) if isinstance(value, list) else value
        shown = ("no", "yes")[value] if isinstance(value, bool) else shown
        if key not in ("notes", "expected_words", "expected_range", "depth_prior_words") and shown not in ("", None):
            say(f"{key.replace('_', ' '):>18}: {shown}")
