"""``omnisyn models`` and ``export-onnx``: networks as a table, those of users added, and a checkpoint as one."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.help import PlainGroup
from omnisyn_cli.cli.parameters import FILE, FOLDER, FilePath
from omnisyn_cli.cli.terminal import print_json, say
from omnisyn_cli.errors import InputError
from omnisyn_cli.pipeline.depth_sources import DEPTH_SOURCES

if TYPE_CHECKING:
    from omnisyn_cli.runtime.models import ModelEntry

HEADER = ("name", "role", "size", "parameters", "hours", "purpose")  # columns of the table of networks


class ListingGroup(PlainGroup):
    """A group that lists networks unless another of its commands is named."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """What click makes of the words, with the name of a command before them."""
        return super().parse_args(
            ctx, args if args and args[0] in {*self.commands, "-h", "--help"} else ["list", *args]
        )


@click.group(cls=ListingGroup)
def models() -> None:
    """List the bundled networks and yours; keep depth networks of yours under a name.

    \b
    omnisyn models
    omnisyn models add network.onnx --name mine --kind perspective,depth
    omnisyn interpolate a.jpg b.jpg --poses auto --depth-prior mine
    """  # noqa: D301 - click's \b is a backspace


@models.command("list")
@click.argument("folder", required=False, type=FilePath())
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def list_models(folder: Path | None, as_json: bool) -> None:
    """List the networks in FOLDER (default: the bundled ones and yours) and check their files. `list` may be left out.

    The last lines list the networks for `interpolate`. Hours are training time, mostly on one processor core.
    --json also prints the training data, licences, hashes and held-out figures.
    """
    from dataclasses import asdict

    from omnisyn_cli.runtime.models import added_models_folder, find_model, read_manifest

    if folder is not None and not os.path.isdir(folder):  # noqa: PTH112 - which raises nothing, whatever the name
        raise InputError(f"{folder}: expected a folder of models, got none; check the name")
    entries = []
    for place in (None, added_models_folder()) if folder is None else (folder,):
        for name, entry in read_manifest(place).items():
            find_model(name, place)
            entries.append(entry)
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    if not entries:
        say("no models; make some with `omnisyn train` and `omnisyn export-onnx`")
        return
    rows = [HEADER, *map(_row, entries)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:  # the width of a terminal crops nothing
        say("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    for choice in _choices(entries, folder):
        say(f"for interpolate: {choice}")


@models.command()
@click.argument("path", metavar="FILE.onnx", type=FilePath())
@click.option("--name", required=True, help="Its name for --depth-prior.")
@click.option("--kind", "words", metavar="WORDS", default="", show_default=False, help="As of --depth-prior-kind.")
@click.option("--overwrite", is_flag=True, help="Replace your network of the same name.")
def add(path: Path, **options: Any) -> None:
    """Keep a copy of your depth network, for --depth-prior NAME, in your folder for data.

    It is asked once before, so that what --depth-prior would refuse is refused now. Where it is used, a file that has
    changed since is refused. See docs/depth-prior.md.
    """
    from omnisyn_cli.interpolation.added_models import add_model

    say(f"for interpolate: --depth-prior {add_model(path, **options).name}")


@models.command()
@click.argument("name")
def remove(name: str) -> None:
    """Remove a network that you have added; your own file stays."""
    from omnisyn_cli.interpolation.added_models import remove_model

    remove_model(name)


def _choices(entries: Iterable[ModelEntry], folder: Path | None) -> Iterator[str]:
    """How networks are chosen, by their names or paths, with the source of depth that each belongs to."""
    from omnisyn_cli.runtime.models import ADDED_ROLE

    sources = {source.role: source.name for source in DEPTH_SOURCES.values() if source.role}
    for entry in entries:
        if entry.role in sources:
            yield f"--depth {sources[entry.role]} --model {entry.name if folder is None else folder / entry.file}"
        if entry.role == ADDED_ROLE:
            yield f"--depth-prior {entry.name}"


def _row(entry: ModelEntry) -> tuple[str, ...]:
    (height, width), count = entry.size, entry.parameters
    counted = f"{count / 1e6:.1f} million" if count >= 1e5 else f"{count:,}"
    hours = f"{entry.hours:g}" if entry.hours else "-"
    return entry.name, entry.role, f"{width}x{height}", counted, hours, entry.purpose


@click.command("export-onnx")
@click.argument("checkpoint", type=FILE)
@click.option("-o", "--output", type=FOLDER, help="Folder of models.  [default: that of the checkpoint]")
@click.option("--name", help="Name for `--model`, or its first part for several networks.  [default: KIND-VARIANT]")
@click.option("--pairs", "pool", type=FOLDER, help="Also compare on the pairs of this pool.")
@click.option("--training", default="", show_default=False, help="Training data and duration, for the manifest.")
@click.option("--licence", default="Apache-2.0", help="Licence of the weights.")
@click.option("--overwrite", is_flag=True, help="Replace models of the same names.")
def export_onnx(checkpoint: Path, output: Path | None, **options: Any) -> None:
    """Write the averaged network of CHECKPOINT as ONNX, check it against torch, and add it to the manifest.

    Jointly trained networks get a file each; SynSin gets three (depth, encoder, decoder). Their names are --name and
    the role.

    The command refuses if ONNX Runtime and torch differ by more than 1e-4 of the largest value.
    """
    from omnisyn_cli.training.checkpoint import publish

    output = output or checkpoint.parent
    for entry, difference in publish(checkpoint, output, **options):
        say(
            f"{output / entry.file}: {entry.parameters} parameters, ONNX Runtime differs from torch by {difference:.1e}"
        )
