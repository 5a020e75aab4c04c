"""``omnisyn poses``: where panoramas were taken."""

from __future__ import annotations

import click

from omnisyn_cli.cli.lazy import LazyGroup

__all__ = ["COMMANDS", "poses"]

COMMANDS = {
    "import": ("omnisyn_cli.cli.poses_import", "Make poses.json from what another program, or a camera, wrote."),
    "export": ("omnisyn_cli.cli.poses_export", "Write poses.json as another program wants it."),
    "check": ("omnisyn_cli.cli.poses_check", "Do the poses fit the pictures, and if not, what was done wrong?"),
    "refine": ("omnisyn_cli.cli.poses_check", "Correct rotations and directions of poses that nearly fit."),
    "estimate": ("omnisyn_cli.cli.poses_check", "Find the poses of panoramas in the pictures alone."),
}
"""Module and one-line help of every command, as in :mod:`omnisyn_cli.cli`."""


@click.group(cls=LazyGroup, lazy=COMMANDS)
def poses() -> None:
    """Import, export, check, refine and estimate poses."""
