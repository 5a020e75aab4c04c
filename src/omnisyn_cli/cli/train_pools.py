"""``omnisyn train pool``, ``convert``, ``evidence``, ``fusion-pool``: what networks learn from."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.evaluate import LAYOUTS
from omnisyn_cli.cli.options import all_of
from omnisyn_cli.cli.parameters import FilePath, WholeRange
from omnisyn_cli.cli.scenes import KINDS, TEXTURES
from omnisyn_cli.cli.terminal import say
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS

FOLDER = FilePath(file_okay=False)
"""A click type: any path that is no file."""

POOL_MULTIPLE = 64
"""Of the height of matched scenes and of renderings: twice what the networks need that learn from parts of them."""


def _height_option(of: str, height: int = 256) -> Callable[..., Any]:
    return click.option("--height", default=height, show_default=True, type=WholeRange(64), help=f"Rows of every {of}.")


def _scene_options(count: int, of: str, height: int = 256) -> Callable[..., Any]:
    """What commands take that render scenes."""
    return all_of(
        click.argument("folder", type=FOLDER),
        click.option("--scenes", default=count, show_default=True, type=WholeRange(1), help="Number of scenes."),
        click.option("--seed", default=0, show_default=True, type=WholeRange(0), help="Seed of the first scene."),
        _height_option(of, height),
    )


WORKERS = click.option(
    "--workers", default=1, show_default=True, type=WholeRange(1), help="Number of processes, at low priority."
)
"""An option of all commands that render scenes."""


@click.command()
@_scene_options(1000, "view")
@click.option("--views", default=3, show_default=True, type=WholeRange(2, 9), help="Views per scene, on a line.")
@click.option(
    "--kind", "kinds", type=click.Choice(KINDS), multiple=True, help="Kind of scene; may be repeated.  [default: all]"
)
@WORKERS
@TEXTURES
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
@click.option(
    "--format", "layout", type=click.Choice(LAYOUTS), default="auto", help="Layout of the data, see omnisyn eval."
)
@click.option(
    "--pairs",
    metavar="0:4|every:N|FILE",
    default="every:1",
    show_default=True,
    help="Pairs of frames, see omnisyn eval.",
)
@_height_option("view")
def convert(dataset: Path, folder: Path, layout: str, pairs: str, height: int) -> None:
    """Add the pairs of DATASET, panoramas with poses and depth files, to the pool FOLDER for `train depth`.

    DATASET may also be the walks of a run of `train recipe`. Existing pairs stay. Damaged scenes and pairs without
    depth are named and skipped.
    """
    from omnisyn_cli.errors import InputError
    from omnisyn_cli.evaluation.datasets import choose_pairs, find_scenes
    from omnisyn_cli.evaluation.views import load_pair
    from omnisyn_cli.training.data import list_walks, load_walk, save_samples, walk_views
    from omnisyn_cli.training.scene_makers import pair_path, walk_of_views

    if walks := list_walks(dataset):
        for walk in walks:
            if not (path := folder / walk.name).exists():
                save_samples(path, [walk_of_views(walk_views(load_walk(walk)), (height, 2 * height))])
                say(path)
        return
    choose = choose_pairs(pairs)
    for source in find_scenes(dataset, layout):
        try:
            chosen = choose(source.read())
        except InputError as error:
            say(f"{source.name}: {error}", err=True)
            continue
        for pair in chosen:
            path = pair_path(folder, pair.scene, pair.first.name, pair.second.name)
            if path.exists():
                continue
            try:
                save_samples(path, [walk_of_views(load_pair(pair).views, (height, 2 * height))])
            except InputError as error:
                say(f"{pair.scene} {pair.first.name} {pair.second.name}: {error}", err=True)
            else:
                say(path)


@click.command("evidence")
@_scene_options(500, "view")
@WORKERS
@TEXTURES
def matched_scenes(height: int, **options: Any) -> None:
    """Render and match scenes in FOLDER for `train completion`; existing ones stay."""
    from omnisyn_cli.training.completion import make_feature_scene
    from omnisyn_cli.training.scene_makers import TiltedConfig

    _check_pool_height(height)
    _fill(make_feature_scene, TiltedConfig(size=(height, 2 * height)), **options)


@click.command("fusion-pool")
@_scene_options(200, "picture", height=128)
@click.option(
    "--preset",
    default=DEFAULT_PRESET,
    show_default=True,
    type=click.Choice(list(PRESETS)),
    help="Preset whose depth and renderer are used.",
)
@click.option(
    "--walks",
    type=FOLDER,
    help="Show these walks of a run of `train recipe`, of four times that many rows, instead of new scenes.",
)
@WORKERS
@TEXTURES
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
