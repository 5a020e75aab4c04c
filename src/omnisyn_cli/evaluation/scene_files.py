"""Generated scenes on disk, in this program's own layout: single ones, and the standard evaluation set."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from omnisyn_cli import scenes
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.poses.file import POSES_NAME, PosedPanorama, write_poses
from omnisyn_cli.scenes import Scene
from omnisyn_cli.scenes.paths import FRAMES_PER_WALK

# Of the panoramas of every scene of the standard set, and samples per pixel along each axis there.
PANORAMA_NAMES, SUPERSAMPLE = tuple(f"{frame:04d}.png" for frame in range(FRAMES_PER_WALK)), 3


def files_of_scene(names: Collection[str], *, with_depth: bool = True) -> list[str]:
    """Names of the files of a scene: its panoramas, their depth if it is wanted, and poses."""
    return [*names, *(map(depth_name, names) if with_depth else ()), POSES_NAME]


def write_scene(
    folder: Path, scene: Scene, path: Sequence[Pose], names: Sequence[str], size: tuple[int, int], supersample: int,
    threads: int | None = None, *, with_depth: bool = True,
) -> None:  # fmt: skip
    """Write renderings along a path under ``names``, with ``supersample``² samples; see :func:`write_renderings`."""
    render = partial(scenes.render_panorama, scene, size=size, supersample=supersample, threads=threads)
    write_renderings(folder, render, dict(zip(names, path, strict=True)), with_depth=with_depth)


def write_renderings(
    folder: Path, render: Callable[[Pose], tuple[np.ndarray, np.ndarray]], path: Mapping[str, Pose], *,
    with_depth: bool = True,
) -> None:  # fmt: skip
    """Write panoramas that ``render`` makes of a ``path``, their depth (EXR, metres) and poses. WriteError: full."""
    panoramas = {}
    for name, pose in path.items():
        image, depth = render(pose)
        write_image(folder / name, image)
        depth_file = folder / depth_name(name) if with_depth else None
        if depth_file is not None:
            write_depth(depth_file, depth)
        panoramas[name] = PosedPanorama(pose, depth=depth_file)
    write_poses(folder / POSES_NAME, panoramas)


def depth_name(name: str) -> str:
    """File name of the depth of a panorama."""
    return f"{Path(name).stem}_depth.exr"
