"""Options that several commands have, and how they say and print what there is."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import click

from omnisyn_cli.cli.parameters import FilePath, FiniteRange, WholeRange
from omnisyn_cli.synthesis.recipe import DEVICES

__all__ = [
    "all_of",
    "device_option",
    "json_option",
    "masks_option",
    "nadir_option",
    "outside_option",
    "print_json",
    "quiet_option",
    "report_option",
    "threads_option",
]


def all_of(*options: Callable[..., Any]) -> Callable[..., Any]:
    """Several options as one decorator, in the order in which they are listed."""
    return lambda command: reduce(lambda decorated, option: option(decorated), reversed(options), command)


def device_option(what: str) -> Callable[[Any], Any]:
    """Where networks, or what is said, run."""
    return click.option("--device", type=click.Choice(DEVICES), default="auto", show_default=True, help=what)


def json_option(what: str) -> Callable[[Any], Any]:
    """Whether what is said is printed as JSON."""
    return click.option("--json", "as_json", is_flag=True, help=f"Print {what} as JSON on stdout.")


def report_option(what: str) -> Callable[[Any], Any]:
    """The folder of a run that can be gone on with."""
    return click.option(
        "--report", metavar="DIR", type=FilePath(),
        help=f"Keep {what} here; a run that was interrupted goes on from them.",
    )  # fmt: skip


threads_option = click.option(
    "--threads", type=WholeRange(1), help="At most this many threads.  [default: one per core]"
)

quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")

outside_option = click.option(
    "--allow-outside", is_flag=True, help="Accept depth and masks outside of the pose file's folder."
)

masks_option = click.option(
    "--mask", "masks", metavar="FILE", multiple=True, type=FilePath(),
    help="Image that is black where a panorama must not be used; once for each panorama, in their order.",
)  # fmt: skip

nadir_option = click.option(
    "--nadir", metavar="DEGREES", type=FiniteRange(0, 90, max_open=True), default=0.0,
    help="Do not use what is this close to straight down in the panoramas: tripod, roof of a car.",
)  # fmt: skip


def print_json(values: Any) -> None:
    """Print plain values on stdout."""
    import json

    click.echo(json.dumps(values, indent=2, ensure_ascii=False, allow_nan=False))
