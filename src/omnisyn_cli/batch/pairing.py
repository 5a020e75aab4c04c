"""Manifests from tours and trajectories: which panoramas are neighbours, and which jobs share work."""

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.batch.schema import check_options
from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import SAME_POSITION_METRES
from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES
from omnisyn_cli.io import check_output
from omnisyn_cli.io.outputs import relative_name, write_parts
from omnisyn_cli.poses.file import POSES_NAME, read_poses


@dataclass(frozen=True)
class TourOptions:
    """Which pairs are interpolated."""

    max_baseline: float = 10.0  # metres; panoramas farther apart are no neighbours
    neighbours: int = 2  # each panorama is paired with so many of the nearest
    both_directions: bool = True  # a job for the way there and one for the way back
    # pairs in a group, whose jobs one worker does one after another; more share more panoramas, fewer spread better
    # over workers
    share: int = 8
    options: Mapping[str, Any] = field(default_factory=dict)  # of every job, as in a manifest


def plan_tours(source: Path, options: TourOptions) -> list[dict[str, Any]]:
    """Lines of a manifest, one per job, for a pose file, a folder with ``poses.json``, or a folder of such folders.

    File names are relative or absolute as ``source`` is. InputError: no pose file, or a damaged one; no near panoramas;
    unknown options.
    """
    check_options(options.options)
    lines = [line for file in _pose_files(source) for line in _tour(file, source, options)]
    if not lines:
        raise InputError(
            f"{source}: expected two panoramas at most {options.max_baseline:g} m apart, got none; "
            "allow more (--max-baseline)"
        )
    taken: set[str] = set()
    for line in lines:
        name, number = line["id"], 2
        while line["id"] in taken:
            line["id"], number = f"{name}-{number}", number + 1
        taken.add(line["id"])
    return lines


def write_manifest(path: Path, lines: Iterable[Mapping[str, Any]], *, overwrite: bool = False) -> None:
    """Write JSONL, files relative to it. OutputPathError: it exists and may not be replaced; WriteError: no space."""
    check_output(path, overwrite)
    text = "".join(json.dumps(_relative(line, path.parent), ensure_ascii=False) + "\n" for line in lines)
    write_parts(path, [text.encode()])


def neighbours(positions: Float[np.ndarray, "count 3"], count: int, farthest: float) -> list[tuple[int, int]]:
    """Pairs ``(a, b)``, a < b, in which one is among the ``count`` nearest of the other, at most ``farthest`` apart.

    None at one place. Positions are looked up in cubes of side ``farthest``: time grows with how many lie near.
    """
    cubes: dict[tuple[int, ...], list[int]] = defaultdict(list)
    cells = np.floor(positions / farthest).astype(np.int64)
    for index, cell in enumerate(cells):
        cubes[tuple(cell)].append(index)
    around = np.array(list(product((-1, 0, 1), repeat=3)))
    pairs = set()
    for index, cell in enumerate(cells):
        near = np.array([other for shift in around for other in cubes.get(tuple(cell + shift), ())])
        distance = np.linalg.norm(positions[near] - positions[index], axis=1)
        is_neighbour = (distance > SAME_POSITION_METRES) & (distance <= farthest)
        for other in near[is_neighbour][np.argsort(distance[is_neighbour], kind="stable")][:count]:
            pairs.add((min(index, int(other)), max(index, int(other))))
    return sorted(pairs)


def group_pairs(pairs: Sequence[tuple[int, int]], share: int) -> list[list[tuple[int, int]]]:
    """Pairs in groups of at most ``share``; in each, a pair follows one that it shares a panorama with if it can."""
    open_pairs: dict[int, set[int]] = defaultdict(set)
    for a, b in pairs:
        open_pairs[a].add(b)
        open_pairs[b].add(a)
    groups: list[list[tuple[int, int]]] = []
    for start in sorted(open_pairs, key=lambda place: (len(open_pairs[place]) != 1, place)):  # dead ends first
        walk = list(_depth_first_pairs(start, open_pairs))
        groups.extend(walk[begin : begin + share] for begin in range(0, len(walk), share))
    return groups


def _depth_first_pairs(start: int, open_pairs: dict[int, set[int]]) -> Iterator[tuple[int, int]]:
    """Pairs from a place on, each used once; from a place with none left back to the last one that has some."""
    stack = [start]
    while stack:
        here = stack[-1]
        if not open_pairs[here]:
            stack.pop()
            continue
        there = min(open_pairs[here])
        open_pairs[here].discard(there)
        open_pairs[there].discard(here)
        yield here, there
        stack.append(there)


def _pose_files(source: Path) -> list[Path]:
    if not source.is_dir():
        return [source]
    here = source / POSES_NAME
    if here.is_file():
        return [here]
    below = sorted(folder / POSES_NAME for folder in source.iterdir() if (folder / POSES_NAME).is_file())
    if not below:
        raise InputError(
            f"{source}: expected {POSES_NAME} in the folder or in folders inside it, got none; "
            "estimate poses first (omnisyn poses estimate)"
        )
    return below


def _tour(file: Path, source: Path, options: TourOptions) -> Iterator[dict[str, Any]]:
    poses = read_poses(file, allow_outside=options.options.get("allow_outside") is True)
    names = list(poses.panoramas)
    positions = np.array([entry.pose.position for entry in poses.panoramas.values()]).reshape(-1, 3)
    scene = "" if file.parent == source or file == source else f"{_safe_name(file.parent.name)}-"
    for number, group in enumerate(
        group_pairs(neighbours(positions, options.neighbours, options.max_baseline), options.share)
    ):
        for a, b in group:
            for first, second in ((a, b), (b, a))[: 1 + options.both_directions]:
                pair = [names[first], names[second]]
                yield {
                    "id": scene + "-".join(_safe_name(Path(name).stem) for name in pair),
                    "inputs": [file.parent / name for name in pair], "poses": file, "group": f"{scene}walk-{number}",
                    **options.options,
                }  # fmt: skip


def _safe_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "_", name).lstrip(".-") or "_"


def _relative(line: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    poses = line["poses"] if line["poses"] == str(POSES_FROM_PICTURES) else relative_name(line["poses"], folder)
    return {**line, "inputs": [relative_name(path, folder) for path in line["inputs"]], "poses": poses}
