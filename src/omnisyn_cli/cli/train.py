"""``omnisyn train``: making the networks. Everything goes on where it was left."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli import train_pools
from omnisyn_cli.cli.help import PlainGroup
from omnisyn_cli.cli.options import all_of, defaulted, whole_option
from omnisyn_cli.cli.parameters import FILE, FOLDER, FiniteRange, WholeRange
from omnisyn_cli.cli.train_pools import MINUTES, run_options

# Decay of its average of weights, and steps until its rate is whole: a baseline that nobody trains for long.
SYNSIN_EMA, SYNSIN_WARMUP = 0.99, 50


@click.group(cls=PlainGroup)
def train() -> None:
    """Train the networks on generated scenes."""


for command in train_pools.COMMANDS:
    train.add_command(command)


def _stage_options(pool: str, batch: int, rate: float) -> Callable[..., Any]:
    """What every training command takes."""
    learn, judge = f"Scenes to learn from, made by `omnisyn train {pool}`.", "Scenes for validation, from other seeds."
    warm, begin = "Learning rate after the warm-up.", "Start a new run from this checkpoint or .onnx file."
    return all_of(
        click.argument("folder", type=FOLDER),
        click.option("--pool", required=True, type=FOLDER, help=learn),
        click.option("--validation-pool", required=True, type=FOLDER, help=judge),
        click.option("--begin-with", type=FILE, help=begin),
        whole_option("--batch", batch, 1, "Pairs per step."),
        defaulted("--rate", rate, warm, type=FiniteRange(0)),
        whole_option("--cooldown-steps", 0, 0, "Lower the rate to 0 over this many steps, then end."),
        MINUTES,
        click.option("--steps", type=WholeRange(1), help="Stop at this step. [default: never]"),
        whole_option("--seed", 0, 0, "Seed of weights and batches."),
        *train_pools.MACHINE,
    )


@train.command()
@_stage_options("pool", batch=4, rate=1e-4)
@defaulted("--variant", "paper-narrow", "Network of a new run: paper, paper-square or paper-narrow.")
@whole_option("--height", 256, 64, "Rows of the training images.")
def depth(**options: Any) -> None:
    """Train a depth network in FOLDER, or continue the run there."""
    _train_variant("depth", **options)


@train.command()
@_stage_options("pool", batch=2, rate=6e-4)
@whole_option("--height", 512, 64, "Rows of the training images: twice those of descriptors.")
@train_pools.ENCODER
def descriptors(encoder: Path | None, **options: Any) -> None:
    """Train the network whose descriptors matching compares in FOLDER, or continue the run there."""
    from omnisyn_cli.networks.descriptors import DESCRIPTOR_VARIANTS, DescriptorNetwork
    from omnisyn_cli.networks.efficientnet import from_classifier

    network, weights = DESCRIPTOR_VARIANTS["lite0"], train_pools.encoder_weights(encoder)
    own = DescriptorNetwork(network).state_dict()
    known = {f"encoder.{name}": value for name, value in from_classifier(weights).items()} if weights else {}
    _train(network, "lite0", weights={name: value for name, value in known.items() if name in own}, **options)


@train.command()
@_stage_options("evidence", batch=4, rate=8e-4)
@defaulted("--variant", "balanced", "Network of a new run.")
@whole_option("--height", 128, 64, "Rows of the training images: those of the pool, or half of them.")
def completion(**options: Any) -> None:
    """Train the network that completes matched depth in FOLDER, or continue the run there.

    The pools hold what matching says of generated scenes.
    """
    _train_variant("completion", **options)


@train.command()
@_stage_options("fusion-pool", batch=4, rate=1e-3)
@defaulted("--variant", "residual", "Network of a new run: residual, paper or paper-narrow.")
def fusion(**options: Any) -> None:
    """Train the network that fuses two renderings in FOLDER, or continue the run there."""
    _train_variant("fusion", **options)


@train.command()
@_stage_options("pool", batch=2, rate=6e-4)
@defaulted("--variant", "small", "Networks of a new run.")
@whole_option("--height", 128, 32, "Rows of the training images; it learns faster with half of them first.")
def synsin(**options: Any) -> None:
    """Train the baseline SynSin in FOLDER, or continue the run there.

    Depth network, encoder and decoder learn together, from one panorama and from two in turn.
    """
    _train_variant("synsin", ema=SYNSIN_EMA, warmup_steps=SYNSIN_WARMUP, **options)


@train.command()
@_stage_options("pool", batch=1, rate=1e-4)
@defaulted("--depth", "paper-narrow", "Depth network of a new run: a variant of train depth, or a checkpoint.")
@defaulted(
    "--fusion", "paper-narrow", "Fusion network of a new run: paper, paper-narrow or a checkpoint of one of them."
)
@whole_option("--height", 256, 64, "Rows of the training images.")
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
    network: Any, name: str, folder: Path, minutes: float | None, steps: int | None, threads: int | None, device: str,
    begin_with: Path | None, pool: Path, validation_pool: Path, height: int | None = None,
    weights: Mapping[str, Any] | None = None, **options: Any,
) -> None:  # fmt: skip
    from omnisyn_cli.training.checkpoint import part_of
    from omnisyn_cli.training.loop import train as run
    from omnisyn_cli.training.tasks import TrainConfig, task_of

    if begin_with is not None:
        part = part_of(begin_with, (task_of(network),))
        network, weights = part.config, part.state_dict()
    if height is not None:
        if height % network.size_multiple:
            raise click.BadParameter(
                f"expected a multiple of {network.size_multiple} for the {name} network, got {height}",
                param_hint="--height",
            )
        own_height, own_width = getattr(network, "size", (1, 2))  # as wide as those that it is exported for
        options["size"] = (height, height * own_width // own_height)
    config = TrainConfig(str(pool), str(validation_pool), **options)
    run(network, config, folder, steps=steps, weights=weights, **run_options(folder, minutes, threads, device))


@train.command("compact")
@click.argument("checkpoint", type=FILE)
@click.option("-o", "--output", required=True, type=FILE, help="File to write.")
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


train.commands = dict(sorted(train.commands.items()))  # as they are listed
