"""``omnisyn train``: making the networks. Everything goes on where it was left."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.lazy import PlainGroup
from omnisyn_cli.cli.numbers import FiniteRange, WholeRange
from omnisyn_cli.cli.places import FilePath
from omnisyn_cli.cli.train_pools import convert, evidence, fusion_pool, pool

__all__ = ["train"]

FOLDER = FilePath(file_okay=False)

DEVICES = ("auto", "cpu", "cuda")
"""Those of :mod:`omnisyn_cli.training.precision`, written out because ``--help`` should not load them."""

RATE, PAPER_RATE = 6e-4, 1e-4
"""Learning rates of the depth networks; the second is the authors'."""

SYNSIN_EMA, SYNSIN_WARMUP = 0.99, 50
"""Decay of its average of weights, and steps until its rate is whole: a baseline that nobody trains for long."""


@click.group(cls=PlainGroup)
def train() -> None:
    """Train the networks on scenes that the program makes itself."""


for command in (convert, evidence, fusion_pool, pool):
    train.add_command(command)


def _stage_options(pool: str, batch: int, rate: float | None) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """What every training command takes."""
    by_variant = "" if rate is not None else "  [default: 6e-4, for paper 1e-4]"
    learn, judge = f"Scenes to learn from, made by `omnisyn train {pool}`.", "Scenes to be judged by: other seeds."
    at_least_0, at_least_1 = WholeRange(0), WholeRange(1)
    shown: dict[str, Any] = {"show_default": True}
    options = [
        click.argument("folder", type=FOLDER),
        click.option("--pool", required=True, type=FOLDER, help=learn),
        click.option("--validation-pool", required=True, type=FOLDER, help=judge),
        click.option("--batch", default=batch, type=at_least_1, help="Pairs per step.", **shown),
        click.option(
            "--rate",
            default=rate,
            type=FiniteRange(0),
            help=f"Learning rate after the warm-up.{by_variant}",
            **shown,
        ),
        click.option("--cooldown-steps", default=0, type=at_least_0, help="Take the rate to 0, end.", **shown),
        click.option("--minutes", type=FiniteRange(0), help="Stop after this time. [default: never]"),
        click.option("--steps", default=None, type=at_least_1, help="Stop at this step. [default: never]"),
        click.option("--seed", default=0, type=at_least_0, help="Of the weights and the batches.", **shown),
        click.option("--threads", default=0, type=at_least_0, help="Of the processor. [default: all]"),
        click.option("--device", default="auto", type=click.Choice(DEVICES), help="CUDA means bfloat16.", **shown),
        click.option("--tensorboard", type=FOLDER, help="Write curves and pictures for TensorBoard here as well."),
    ]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@train.command()
@_stage_options("pool", batch=4, rate=None)
@click.option(
    "--variant",
    default="fast",
    show_default=True,
    help="Network of a fresh run: fast, accurate, paper, paper-square, paper-narrow.",
)
@click.option("--height", default=256, show_default=True, type=WholeRange(64), help="Rows of the training images.")
def depth(variant: str, height: int, rate: float | None, **options: Any) -> None:
    """Train a depth network in FOLDER; a run that is there goes on, whether it was stopped or killed."""
    from omnisyn_cli.networks.depth_config import VARIANTS
    from omnisyn_cli.networks.paper import PAPER_VARIANTS

    known: dict[str, Any] = {**VARIANTS, **PAPER_VARIANTS}
    _check_variant(variant, known)
    network = known[variant]
    _check_height(height, network.size_multiple, variant)
    if rate is None:
        rate = PAPER_RATE if variant in PAPER_VARIANTS else RATE
    _train(network, size=(height, height * network.size[1] // network.size[0]), rate=rate, **options)


@train.command()
@_stage_options("evidence", batch=2, rate=8e-4)
@click.option("--variant", default="balanced", show_default=True, help="Network of a fresh run.")
def refine(variant: str, **options: Any) -> None:
    """Train the network that refines matching in FOLDER; a run that is there goes on."""
    from omnisyn_cli.networks.refine import REFINE_VARIANTS

    _check_variant(variant, REFINE_VARIANTS)
    _train(REFINE_VARIANTS[variant], **options)


@train.command()
@_stage_options("fusion-pool", batch=4, rate=1e-3)
@click.option(
    "--variant", default="residual", show_default=True, help="Network of a fresh run: residual, paper, paper-narrow."
)
def fusion(variant: str, **options: Any) -> None:
    """Train the network that joins two renderings in FOLDER; a run that is there goes on."""
    from omnisyn_cli.networks.fusion import FUSION_VARIANTS

    _check_variant(variant, FUSION_VARIANTS)
    _train(FUSION_VARIANTS[variant], **options)


@train.command()
@_stage_options("pool", batch=1, rate=1e-4)
@click.option(
    "--depth", default="fast", show_default=True, help="Of a fresh run: a variant, or a checkpoint to begin with."
)
@click.option("--fusion", default="residual", show_default=True, help="The same for the fusion network.")
@click.option("--height", default=256, show_default=True, type=WholeRange(64), help="Rows of the training images.")
def joint(depth: str, fusion: str, height: int, **options: Any) -> None:
    """Train depth and fusion together in FOLDER, through the rendering between them; a run that is there goes on.

    The pool's scenes need three views: the outer ones are the pair, the inner one is what the fused picture is compared
    with. `omnisyn export-onnx` writes both networks of the checkpoint, and each of them can begin another run.
    """
    from omnisyn_cli.networks.depth_config import VARIANTS
    from omnisyn_cli.networks.fusion import FUSION_VARIANTS
    from omnisyn_cli.networks.joint import JointConfig
    from omnisyn_cli.networks.paper import PAPER_VARIANTS

    depth_config, depth_weights = _beginning(depth, {**VARIANTS, **PAPER_VARIANTS}, ("depth", "paper"), "depth")
    fusion_config, fusion_weights = _beginning(fusion, FUSION_VARIANTS, ("fusion",), "fusion")
    network = JointConfig(depth_config, fusion_config)
    _check_height(height, network.size_multiple, "joint")
    size = (height, height * depth_config.size[1] // depth_config.size[0])
    _train(network, size=size, weights={**depth_weights, **fusion_weights}, **options)


def _beginning(chosen: str, known: Mapping[str, Any], kinds: tuple[str, ...], name: str) -> tuple[Any, dict[str, Any]]:
    """The configuration of a variant or of a checkpoint, and its weights as the joint network names them."""
    from omnisyn_cli.training.checkpoint import of_this_version
    from omnisyn_cli.training.joint import part_of
    from omnisyn_cli.training.tasks import TASKS

    if chosen in known:
        return known[chosen], {}
    if not Path(chosen).is_file():
        raise click.BadParameter(
            f"expected a checkpoint or one of {', '.join(known)}, got {chosen!r}", param_hint=f"--{name}"
        )
    part = part_of(Path(chosen), kinds)
    weights = {f"{name}.{key}": value for key, value in part.average.items()}
    with of_this_version(Path(chosen)):
        return TASKS[part.kind].config.from_dict(part.config), weights


@train.command()
@_stage_options("pool", batch=2, rate=6e-4)
@click.option("--variant", default="small", show_default=True, help="Networks of a fresh run.")
@click.option(
    "--height", default=128, show_default=True, type=WholeRange(32),
    help="Rows of the training images; with half of them first it learns faster.",
)  # fmt: skip
def synsin(variant: str, height: int, **options: Any) -> None:
    """Train SynSin in FOLDER, which frames are compared with; a run that is there goes on.

    Its depth network, its features and its decoder learn together, on pictures made of one panorama and of two in turn,
    by themselves at first and then against a network that tells true pictures from made ones.
    """
    from omnisyn_cli.networks.synsin import SYNSIN_VARIANTS

    _check_variant(variant, SYNSIN_VARIANTS)
    network = SYNSIN_VARIANTS[variant]
    _check_height(height, network.size_multiple, variant)
    _train(network, size=(height, 2 * height), ema=SYNSIN_EMA, warmup_steps=SYNSIN_WARMUP, **options)


def _check_height(height: int, multiple: int, variant: str) -> None:
    if height % multiple:
        raise click.BadParameter(
            f"expected a multiple of {multiple} for the {variant} network, got {height}", param_hint="--height"
        )


def _check_variant(variant: str, known: Mapping[str, Any]) -> None:
    if variant not in known:
        raise click.BadParameter(f"expected one of {', '.join(known)}, got {variant!r}", param_hint="--variant")


def _train(
    network: Any, folder: Path, threads: int, minutes: float | None, steps: int | None, device: str,
    tensorboard: Path | None, weights: Mapping[str, Any] | None = None, **options: Any,
) -> None:  # fmt: skip
    from contextlib import ExitStack, closing

    import torch

    from omnisyn_cli.training.loop import TrainConfig
    from omnisyn_cli.training.loop import train as run
    from omnisyn_cli.training.precision import choose_precision
    from omnisyn_cli.training.tensorboard import Board

    if threads:
        torch.set_num_threads(threads)
    precision = choose_precision(device)
    folders: dict[str, Any] = {name: str(options.pop(name)) for name in ("pool", "validation_pool")}
    config = TrainConfig(**folders, **options)
    with ExitStack() as stack:
        board = stack.enter_context(closing(Board(tensorboard))) if tensorboard else None
        run(
            network, config, folder, minutes=math.inf if minutes is None else minutes, steps=steps, report=_show,
            precision=precision, board=board, weights=weights, on_start=_say_where(folder),
        )  # fmt: skip


def _say_where(folder: Path) -> Callable[[Any], None]:
    """Says where a run begins, and when there will be news: the first hundreds of steps take minutes."""

    def say(trainer: Any) -> None:
        every, device = trainer.config.validate_every, trainer.precision.device
        click.echo(f"{folder}: from step {trainer.step} on {device}, with a line every {every} steps", err=True)

    return say


@train.command("compact")
@click.argument("checkpoint", type=FilePath(dir_okay=False))
@click.option("-o", "--output", required=True, type=FilePath(dir_okay=False), help="File to write.")
@click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
def compact_checkpoint(checkpoint: Path, output: Path, overwrite: bool) -> None:
    """Keep only the averaged weights of CHECKPOINT, in half precision.

    The result is an eighth of the size. It can be exported, and put into a new folder as checkpoint.pt to train on.
    """
    from omnisyn_cli.io import check_output
    from omnisyn_cli.io.paths import check_kept
    from omnisyn_cli.training.checkpoint import compact, load_checkpoint, save_checkpoint

    check_output(output, overwrite)
    check_kept([output], [checkpoint])
    save_checkpoint(output, compact(load_checkpoint(checkpoint)))


def _show(row: dict[str, Any]) -> None:
    click.echo("  ".join(f"{key} {value:.6g}" for key, value in row.items()))
