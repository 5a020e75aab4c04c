"""A scene as the evaluation sees it, whatever layout it has on disk: posed panoramas in walking order."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import read_inverse_depth


class NoScaleError(PoseError):
    """The poses of a scene are known up to an unknown scale only, so it cannot be used; nothing is broken."""


@dataclass(frozen=True)
class SceneFrame:
    """One panorama of a scene; its files are not read yet.

    Attributes:
        name: what the data set calls it.
        image: its picture.
        pose: camera-to-world in the axes of :mod:`omnisyn_cli.geometry.sphere`, metres.
        depth: its depth file, or None.
        mask: its mask, or None.
        read_depth: takes the depth file to inverse Euclidean distances in 1/metre, 0 where there is nothing.
        has_holes: no depth means that a scan has a hole there, not that it is infinitely far to anything.
    """

    name: str
    image: Path
    pose: Pose
    depth: Path | None = None
    mask: Path | None = None
    read_depth: Callable[[Path], Float[np.ndarray, "height width"]] = read_inverse_depth
    has_holes: bool = False

    @property
    def files(self) -> tuple[Path, ...]:
        """Everything that is read of it."""
        return tuple(path for path in (self.image, self.depth, self.mask) if path is not None)


@dataclass(frozen=True)
class Scene:
    """Panoramas in walking order."""

    name: str
    frames: tuple[SceneFrame, ...]


@dataclass(frozen=True)
class SceneSource:
    """Where a scene can be had from.

    Attributes:
        name: of the scene, unique in its data set.
        frames: reads the poses; raises an :class:`~omnisyn_cli.errors.InputError` where they are damaged.
    """

    name: str
    frames: Callable[[], Iterable[SceneFrame]]

    def read(self) -> Scene:
        """The scene; errors are those of ``frames``."""
        return Scene(self.name, tuple(self.frames()))


def scene_folders(folder: Path, pattern: str) -> list[tuple[str, Path]]:
    """Name and path of the folder itself if it has a file of this pattern, else of those in it that have, by name."""
    if any(folder.glob(pattern)):
        return [(folder.resolve().name, folder)]
    return [(path.name, path) for path in sorted(folder.glob("*/")) if any(path.glob(pattern))]
