"""``omnisyn train pool``, ``convert``, ``evidence`` and ``fusion-pool``: what networks learn from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.evaluate import LAYOUTS
from omnisyn_cli.cli.numbers import WholeRange
from omnisyn_cli.cli.places import FilePath
from omnisyn_cli.cli.scenes import KINDS, TEXTURES

__all__ = ["convert", "evidence", "fusion_pool", "pool"]

FOLDER = FilePath(file_okay=False)

POOL_MULTIPLE = 64
"""Of the height of evidence and of renderings: twice what the networks need that learn from parts of them."""

SEED = click.option("--seed", default=0, show_default=True, type=WholeRange(0), help="Seed of the first scene.")

WORKERS = click.option(
    "--workers", default=1, show_default=True, type=WholeRange(1), help="Processes, at low priority."
)


@click.command()
@click.argument("folder", type=FOLDER)
@click.option("--scenes", default=1000, show_default=True, type=WholeRange(1), help="How many scenes.")
@SEED
@click.option("--height", default=256, show_default=True, type=WholeRange(64), help="Rows of every view.")
@click.option("--views", default=3, show_default=True, type=WholeRange(2, 9), help="Views per scene, on a line.")
@click.option(
    "--kind", "kinds", type=click.Choice(KINDS), multiple=True, help="May be given several times.  [default: all]"
)
@WORKERS
@TEXTURES
def pool(
    folder: Path, scenes: int, seed: int, height: int, views: int, kinds: tuple[str, ...], workers: int,
    textures: Path | None,
) -> None:  # fmt: skip
    """Render procedural scenes into FOLDER; those that are there already stay."""
    from functools import partial

    from omnisyn_cli.training.pool import PoolConfig, render_to_pool

    options: dict[str, Any] = {"kinds": kinds} if kinds else {}
    options["textures"] = _textures(textures)
    make = partial(render_to_pool, config=PoolConfig(size=(height, 2 * height), views=views, **options))
    _fill(folder, range(seed, seed + scenes), make, workers)


@click.command()
@click.argument("dataset", type=FOLDER)
@click.argument("folder", type=FOLDER)
@click.option("--format", "layout", type=click.Choice(LAYOUTS), default="auto", help="Of the data, see omnisyn eval.")
@click.option(
    "--pairs", metavar="0:4|every:N|FILE", default="every:1", show_default=True, help="Of frames, see omnisyn eval."
)
@click.option("--height", default=256, show_default=True, type=WholeRange(64), help="Rows of every view.")
def convert(dataset: Path, folder: Path, layout: str, pairs: str, height: int) -> None:
    """Add the pairs of DATASET, panoramas with poses and depth in files, to the pool FOLDER for `train depth`.

    Those that are there already stay; damaged scenes and pairs without depth are named and left out.
    """
    from omnisyn_cli.errors import InputError
    from omnisyn_cli.evaluation.datasets import choose_pairs, find_scenes
    from omnisyn_cli.evaluation.views import load_pair
    from omnisyn_cli.training.folders import add_pair, pair_path

    choose = choose_pairs(pairs)
    for source in find_scenes(dataset, layout):
        try:
            chosen = choose(source.read())
        except InputError as error:
            click.echo(f"{source.name}: {error}", err=True)
            continue
        for pair in chosen:
            path = pair_path(folder, pair.scene, pair.first.name, pair.second.name)
            if path.exists():
                continue
            try:
                add_pair(path, *load_pair(pair).views, (height, 2 * height))
            except InputError as error:
                click.echo(f"{pair.scene} {pair.first.name} {pair.second.name}: {error}", err=True)
            else:
                click.echo(path)


@click.command()
@click.argument("folder", type=FOLDER)
@click.option("--scenes", default=500, show_default=True, type=WholeRange(1), help="How many scenes.")
@SEED
@click.option("--height", default=256, show_default=True, type=WholeRange(64), help="Rows of every view.")
@WORKERS
@TEXTURES
def evidence(folder: Path, scenes: int, seed: int, height: int, workers: int, textures: Path | None) -> None:
    """Render scenes into FOLDER and match them, for `train refine`; those that are there already stay."""
    from functools import partial

    from omnisyn_cli.training.evidence import EvidenceConfig, make_evidence

    _check_pool_height(height)
    make = partial(make_evidence, config=EvidenceConfig(size=(height, 2 * height), textures=_textures(textures)))
    _fill(folder, range(seed, seed + scenes), make, workers)


@click.command("fusion-pool")
@click.argument("folder", type=FOLDER)
@click.option("--scenes", default=200, show_default=True, type=WholeRange(1), help="How many scenes.")
@SEED
@click.option("--height", default=256, show_default=True, type=WholeRange(64), help="Rows of every picture.")
@WORKERS
@TEXTURES
def fusion_pool(folder: Path, scenes: int, seed: int, height: int, workers: int, textures: Path | None) -> None:
    """Render scenes into FOLDER from estimated depth, for `train fusion`; those that are there already stay."""
    from functools import partial

    from omnisyn_cli.training.fusion import FusionPoolConfig, make_fusion_scene

    _check_pool_height(height)
    config = FusionPoolConfig(size=(height, 2 * height), rows=4 * height, textures=_textures(textures))
    make = partial(make_fusion_scene, config=config)
    _fill(folder, range(seed, seed + scenes), make, workers)


def _check_pool_height(height: int) -> None:
    """Of scenes that are learned from at the size they have."""
    if height % POOL_MULTIPLE:
        raise click.BadParameter(f"expected a multiple of {POOL_MULTIPLE}, got {height}", param_hint="--height")


def _fill(folder: Path, seeds: range, make: Callable[[Path, int], Path | None], workers: int) -> None:
    """Make the scenes that are not there yet, and name them."""
    from omnisyn_cli.training.pool import fill_pool

    for path in fill_pool(folder, seeds, make, workers=workers):
        click.echo(path)


def _textures(folder: Path | None) -> str | None:
    """The folder by its full name, once it is known that there are photographs in it."""
    from omnisyn_cli.io import list_photographs

    if folder is not None:
        list_photographs(folder)
    return None if folder is None else str(folder.resolve())
