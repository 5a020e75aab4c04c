"""``omnisyn train``: making the networks. Everything goes on where it was left."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.scenes import KINDS

__all__ = ["train"]

FOLDER = click.Path(path_type=Path, file_okay=False)


@click.group()
def train() -> None:
    """Train the networks on scenes that the program makes itself."""


@train.command()
@click.argument("folder", type=FOLDER)
@click.option("--scenes", default=1000, show_default=True, type=click.IntRange(1), help="How many scenes.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of the first scene.")
@click.option("--height", default=256, show_default=True, type=click.IntRange(64), help="Rows of every view.")
@click.option("--views", default=3, show_default=True, type=click.IntRange(2, 9), help="Views per scene, on a line.")
@click.option(
    "--kind", "kinds", type=click.Choice(KINDS), multiple=True, help="May be given several times.  [default: all]"
)
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), help="Processes, at low priority.")
def pool(folder: Path, scenes: int, seed: int, height: int, views: int, kinds: tuple[str, ...], workers: int) -> None:
    """Render procedural scenes into FOLDER; those that are there already stay."""
    from functools import partial

    from omnisyn_cli.training.pool import PoolConfig, fill_pool, render_to_pool

    options: dict[str, Any] = {"kinds": kinds} if kinds else {}
    make = partial(render_to_pool, config=PoolConfig(size=(height, 2 * height), views=views, **options))
    for path in fill_pool(folder, range(seed, seed + scenes), make, workers=workers):
        click.echo(path)


@train.command()
@click.argument("folder", type=FOLDER)
@click.option("--scenes", default=500, show_default=True, type=click.IntRange(1), help="How many scenes.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of the first scene.")
@click.option("--height", default=256, show_default=True, type=click.IntRange(64), help="Rows of every view.")
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), help="Processes, at low priority.")
def evidence(folder: Path, scenes: int, seed: int, height: int, workers: int) -> None:
    """Render scenes into FOLDER and match them, for `train refine`; those that are there already stay."""
    from functools import partial

    from omnisyn_cli.training.evidence import EvidenceConfig, make_evidence
    from omnisyn_cli.training.pool import fill_pool

    make = partial(make_evidence, config=EvidenceConfig(size=(height, 2 * height)))
    for path in fill_pool(folder, range(seed, seed + scenes), make, workers=workers):
        click.echo(path)


def _stage_options(pool: str, batch: int, rate: float) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """What every training command takes."""
    learn, judge = f"Scenes to learn from, made by `omnisyn train {pool}`.", "Scenes to be judged by: other seeds."
    at_least_0, at_least_1 = click.IntRange(0), click.IntRange(1)
    shown: dict[str, Any] = {"show_default": True}
    options = [
        click.argument("folder", type=FOLDER),
        click.option("--pool", required=True, type=FOLDER, help=learn),
        click.option("--validation-pool", required=True, type=FOLDER, help=judge),
        click.option("--batch", default=batch, type=at_least_1, help="Pairs per step.", **shown),
        click.option("--rate", default=rate, type=float, help="Learning rate after the warm-up.", **shown),
        click.option("--cooldown-steps", default=0, type=at_least_0, help="Take the rate to 0, end.", **shown),
        click.option("--minutes", default=float("inf"), type=float, help="Stop after this time. [default: never]"),
        click.option("--steps", default=None, type=at_least_1, help="Stop at this step. [default: never]"),
        click.option("--seed", default=0, type=at_least_0, help="Of the weights and the batches.", **shown),
        click.option("--threads", default=0, type=at_least_0, help="Of the processor. [default: all]"),
    ]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@train.command()
@_stage_options("pool", batch=4, rate=6e-4)
@click.option("--variant", default="fast", show_default=True, help="Network of a fresh run.")
@click.option("--height", default=256, show_default=True, type=click.IntRange(64), help="Rows of the training images.")
def depth(variant: str, height: int, **options: Any) -> None:
    """Train the depth network in FOLDER; a run that is there goes on, whether it was stopped or killed."""
    from omnisyn_cli.networks.depth import VARIANTS

    _check_variant(variant, VARIANTS)
    multiple = VARIANTS[variant].size_multiple
    if height % multiple:
        raise click.BadParameter(
            f"expected a multiple of {multiple} for the {variant} network, got {height}", param_hint="--height"
        )
    _train(VARIANTS[variant], size=(height, 2 * height), **options)


@train.command()
@_stage_options("evidence", batch=2, rate=8e-4)
@click.option("--variant", default="balanced", show_default=True, help="Network of a fresh run.")
def refine(variant: str, **options: Any) -> None:
    """Train the network that refines matching in FOLDER; a run that is there goes on."""
    from omnisyn_cli.networks.refine import REFINE_VARIANTS

    _check_variant(variant, REFINE_VARIANTS)
    _train(REFINE_VARIANTS[variant], **options)


def _check_variant(variant: str, known: Mapping[str, Any]) -> None:
    if variant not in known:
        raise click.BadParameter(f"expected one of {', '.join(known)}, got {variant!r}", param_hint="--variant")


def _train(network: Any, folder: Path, threads: int, minutes: float, steps: int | None, **options: Any) -> None:
    import torch

    from omnisyn_cli.training.loop import TrainConfig
    from omnisyn_cli.training.loop import train as run

    if threads:
        torch.set_num_threads(threads)
    folders: dict[str, Any] = {name: str(options.pop(name)) for name in ("pool", "validation_pool")}
    run(network, TrainConfig(**folders, **options), folder, minutes=minutes, steps=steps, report=_show)


@train.command("compact")
@click.argument("checkpoint", type=click.Path(path_type=Path, dir_okay=False))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False), help="File to write.")
def compact_checkpoint(checkpoint: Path, output: Path) -> None:
    """Keep only the averaged weights of CHECKPOINT, in half precision.

    The result is an eighth of the size. It can be exported, and put into a new folder as checkpoint.pt to train on.
    """
    from omnisyn_cli.io import check_output
    from omnisyn_cli.training.checkpoint import compact, load_checkpoint, save_checkpoint

    check_output(output)
    save_checkpoint(output, compact(load_checkpoint(checkpoint)))


def _show(row: dict[str, Any]) -> None:
    click.echo("  ".join(f"{key} {value:.6g}" for key, value in row.items()))
