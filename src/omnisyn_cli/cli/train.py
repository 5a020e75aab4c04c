"""``omnisyn train``: making the networks. Everything goes on where it was left."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.lazy import PlainGroup
from omnisyn_cli.cli.options import all_of
from omnisyn_cli.cli.parameters import FilePath, FiniteRange, WholeRange
from omnisyn_cli.cli.terminal import say
from omnisyn_cli.cli.train_pools import convert, fusion_pool, matched_scenes, pool
from omnisyn_cli.cli.train_recipe import recipe

FOLDER = FilePath(file_okay=False)
"""A click type: any path that is no file."""

DEVICES = ("auto", "cpu", "cuda")
"""Those of :mod:`omnisyn_cli.training.precision`, written out because ``--help`` should not load them."""

SYNSIN_EMA, SYNSIN_WARMUP = 0.99, 50
"""Decay of its average of weights, and steps until its rate is whole: a baseline that nobody trains for long."""


@click.group(cls=PlainGroup)
def train() -> None:
    """Train the networks on generated scenes."""


for command in (convert, matched_scenes, fusion_pool, pool, recipe):
    train.add_command(command)


def _stage_options(pool: str, batch: int, rate: float) -> Callable[..., Any]:
    """What every training command takes."""
    warm, half = "Learning rate after the warm-up.", "auto uses bfloat16 if the machine has it."
    learn, judge = f"Scenes to learn from, made by `omnisyn train {pool}`.", "Scenes for validation, from other seeds."
    at_least_0, at_least_1 = WholeRange(0), WholeRange(1)
    shown: dict[str, Any] = {"show_default": True}
    return all_of(
        click.argument("folder", type=FOLDER),
        click.option("--pool", required=True, type=FOLDER, help=learn),
        click.option("--validation-pool", required=True, type=FOLDER, help=judge),
        click.option(
            "--begin-with", type=FilePath(dir_okay=False), help="Start a new run from this checkpoint or .onnx file."
        ),
        click.option("--batch", default=batch, type=at_least_1, help="Pairs per step.", **shown),
        click.option("--rate", default=rate, type=FiniteRange(0), help=warm, **shown),
        click.option(
            "--cooldown-steps",
            default=0,
            type=at_least_0,
            help="Lower the rate to 0 over this many steps, then end.",
            **shown,
        ),
        click.option("--minutes", type=FiniteRange(0), help="Stop after this time. [default: never]"),
        click.option("--steps", default=None, type=at_least_1, help="Stop at this step. [default: never]"),
        click.option("--seed", default=0, type=at_least_0, help="Seed of weights and batches.", **shown),
        click.option("--threads", default=0, type=at_least_0, help="Processor threads. [default: all]"),
        click.option("--device", default="auto", type=click.Choice(DEVICES), help=half, **shown),
    )


def _variant_option(default: str, what: str = "Network of a new run.") -> Callable[..., Any]:
    return click.option("--variant", default=default, show_default=True, help=what)


def _height_option(default: int, least: int, more: str = ".") -> Callable[..., Any]:
    text = f"Rows of the training images{more}"
    return click.option("--height", default=default, show_default=True, type=WholeRange(least), help=text)


@train.command()
@_stage_options("pool", batch=4, rate=1e-4)
@_variant_option("paper-narrow", "Network of a new run: paper, paper-square or paper-narrow.")
@_height_option(256, 64)
def depth(**options: Any) -> None:
    """Train a depth network in FOLDER, or continue the run there."""
    _train_variant("depth", **options)


@train.command()
@_stage_options("evidence", batch=4, rate=8e-4)
@_variant_option("balanced")
@_height_option(128, 64, ": those of the pool, or half of them.")
def completion(**options: Any) -> None:
    """Train the network that completes matched depth in FOLDER, or continue the run there.

    The pools hold what matching says of generated scenes.
    """
    _train_variant("completion", **options)


@train.command()
@_stage_options("fusion-pool", batch=4, rate=1e-3)
@_variant_option("residual", "Network of a new run: residual, paper or paper-narrow.")
def fusion(**options: Any) -> None:
    """Train the network that fuses two renderings in FOLDER, or continue the run there."""
    _train_variant("fusion", **options)


@train.command()
@_stage_options("pool", batch=1, rate=1e-4)
@click.option(
    "--depth",
    default="paper-narrow",
    show_default=True,
    help="Depth network of a new run: a variant of train depth, or a checkpoint.",
)
@click.option(
    "--fusion",
    default="paper-narrow",
    show_default=True,
    help="Fusion network of a new run: paper, paper-narrow or a checkpoint of one of them.",
)
@_height_option(256, 64)
def joint(depth: str, fusion: str, **options: Any) -> None:
    """Train depth and fusion together in FOLDER, through the renderer, or continue the run there.

    Scenes of the pool need three views: the outer two are the pair, and the fused picture is compared with the inner
    one. `omnisyn export-onnx` writes both networks. Each can start another run.
    """
    from omnisyn_cli.training.joint import JointConfig

    depth_config, depth_weights = _beginning(depth, "depth")
    fusion_config, fusion_weights = _beginning(fusion, "fusion")
    if not fusion_config.is_direct:
        raise click.BadParameter(
            f"expected a network that paints, as paper or paper-narrow, got {fusion!r}", param_hint="--fusion"
        )
    _train(JointConfig(depth_config, fusion_config), "joint", weights={**depth_weights, **fusion_weights}, **options)


@train.command()
@_stage_options("pool", batch=2, rate=6e-4)
@_variant_option("small", "Networks of a new run.")
@_height_option(128, 32, "; it learns faster with half of them first.")
def synsin(**options: Any) -> None:
    """Train the baseline SynSin in FOLDER, or continue the run there.

    Depth network, encoder and decoder learn together, from one panorama and from two in turn.
    """
    _train_variant("synsin", ema=SYNSIN_EMA, warmup_steps=SYNSIN_WARMUP, **options)


def _train_variant(role: str, variant: str, **options: Any) -> None:
    """Train the network of that name."""
    known = _variants(role)
    if variant not in known:
        raise click.BadParameter(f"expected one of {', '.join(known)}, got {variant!r}", param_hint="--variant")
    _train(known[variant], variant, **options)


def _variants(role: str) -> dict[str, Any]:
    """The networks for a role by name."""
    from omnisyn_cli.training.tasks import TASKS, kinds_for

    return {name: network for kind in kinds_for(role) for name, network in TASKS[kind].variants.items()}


def _beginning(chosen: str, role: str) -> tuple[Any, dict[str, Any]]:
    """The configuration of a variant or of a checkpoint, and its weights as the joint network names them."""
    from omnisyn_cli.training.checkpoint import part_of
    from omnisyn_cli.training.tasks import kinds_for

    known = _variants(role)
    if chosen in known:
        return known[chosen], {}
    if not Path(chosen).is_file():
        raise click.BadParameter(
            f"expected a checkpoint or one of {', '.join(known)}, got {chosen!r}", param_hint=f"--{role}"
        )
    part = part_of(Path(chosen), kinds_for(role))
    return part.config, {f"{role}.{key}": value for key, value in part.state_dict().items()}


def _train(
    network: Any, name: str, folder: Path, threads: int, minutes: float | None, steps: int | None, device: str,
    begin_with: Path | None, height: int | None = None, weights: Mapping[str, Any] | None = None, **options: Any,
) -> None:  # fmt: skip
    import torch

    from omnisyn_cli.training.checkpoint import part_of
    from omnisyn_cli.training.loop import train as run
    from omnisyn_cli.training.precision import choose_precision
    from omnisyn_cli.training.task import TrainConfig
    from omnisyn_cli.training.tasks import task_of

    if begin_with is not None:
        part = part_of(begin_with, (task_of(network),))
        network, weights = part.config, part.state_dict()
    if height is not None:
        options["size"] = _size(network, name, height)
    if threads:
        torch.set_num_threads(threads)
    precision = choose_precision(device)
    folders: dict[str, Any] = {name: str(options.pop(name)) for name in ("pool", "validation_pool")}
    config = TrainConfig(**folders, **options)

    def say_where(trainer: Any) -> None:
        """And when there will be news: the first hundreds of steps take minutes."""
        every, device = trainer.config.validate_every, trainer.precision
        say(f"{folder}: from step {trainer.step} on {device}, with a line every {every} steps", err=True)

    run(
        network, config, folder, minutes=math.inf if minutes is None else minutes, steps=steps, report=_show,
        precision=precision, weights=weights, on_start=say_where,
    )  # fmt: skip


def _size(network: Any, name: str, height: int) -> tuple[int, int]:
    """Of the training images, as wide for their height as those that the network is exported for."""
    if height % network.size_multiple:
        raise click.BadParameter(
            f"expected a multiple of {network.size_multiple} for the {name} network, got {height}",
            param_hint="--height",
        )
    own_height, own_width = getattr(network, "size", (1, 2))
    return height, height * own_width // own_height


@train.command("compact")
@click.argument("checkpoint", type=FilePath(dir_okay=False))
@click.option("-o", "--output", required=True, type=FilePath(dir_okay=False), help="File to write.")
@click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
def compact_checkpoint(checkpoint: Path, output: Path, overwrite: bool) -> None:
    """Keep only the averaged weights of CHECKPOINT, in half precision.

    The result is an eighth of the size. Export it, or copy it to a new folder as checkpoint.pt to continue training.
    """
    from omnisyn_cli.io import check_output
    from omnisyn_cli.io.outputs import check_kept
    from omnisyn_cli.training.checkpoint import compact, load_checkpoint, save_checkpoint

    check_output(output, overwrite)
    check_kept([output], [checkpoint])
    save_checkpoint(output, compact(load_checkpoint(checkpoint)))


def _show(row: dict[str, Any]) -> None:
    say("  ".join(f"{key} {value:.6g}" for key, value in row.items()))
