"""``omnisyn export-onnx``: a checkpoint becomes a model that `interpolate` can use."""

from pathlib import Path

import click

from omnisyn_cli.cli.parameters import FilePath
from omnisyn_cli.cli.terminal import say

FOLDER = FilePath(file_okay=False)
"""A click type: any path that is no file."""


@click.command("export-onnx")
@click.argument("checkpoint", required=False, type=FilePath(dir_okay=False))
@click.option("-o", "--output", type=FOLDER, help="Folder of models.  [default: that of the checkpoint]")
@click.option("--name", help="Name for `--model`, or its first part for several networks.  [default: KIND-VARIANT]")
@click.option("--pairs", "pool", type=FOLDER, help="Also compare on the pairs of this pool.")
@click.option("--training", default="", help="Training data and duration, for the manifest.")
@click.option("--licence", default="Apache-2.0", show_default=True, help="Licence of the weights.")
@click.option("--overwrite", is_flag=True, help="Replace models of the same names.")
def export_onnx(
    checkpoint: Path | None,
    output: Path | None,
    name: str | None,
    pool: Path | None,
    training: str,
    licence: str,
    overwrite: bool,
) -> None:
    """Write the averaged network of CHECKPOINT as ONNX, check it against torch, and add it to the manifest.

    Jointly trained networks get a file each; SynSin gets three (depth, encoder, decoder). Their names are --name and
    the role.

    The command refuses if ONNX Runtime and torch differ by more than 1e-4 of the largest value.

    Without CHECKPOINT it lists the checkpoints here and in the folders below.
    """
    from omnisyn_cli.training.publish import publish

    if checkpoint is None:
        _list_checkpoints(Path())
        return
    output = output or checkpoint.parent
    made = publish(checkpoint, output, name=name, pool=pool, training=training, licence=licence, overwrite=overwrite)
    for entry, difference in made:
        say(
            f"{output / entry.file}: {entry.parameters} parameters, ONNX Runtime differs from torch by {difference:.1e}"
        )


def _list_checkpoints(folder: Path) -> None:
    """What could be exported, and the kinds that there are."""
    from omnisyn_cli.training.checkpoint import checkpoints_below
    from omnisyn_cli.training.tasks import TASKS

    found = list(checkpoints_below(folder))
    say("`omnisyn export-onnx PATH` writes one of these:" if found else "no checkpoints here")
    for checkpoint in found:
        what = " ".join(filter(None, (checkpoint.kind, checkpoint.variant)))
        say(f"    {checkpoint.path}: {what}, {checkpoint.step:,} steps")
    say("`omnisyn train` makes checkpoints of these kinds, in checkpoint.pt of the folder that it is given:")
    for kind, task in TASKS.items():
        say(f"    {kind}: {', '.join(task.variants) or 'of a depth and a fusion network'}")
