"""A scene as the evaluation sees it, whatever layout it has on disk: posed panoramas in walking order; its pairs."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import read_inverse_depth
from omnisyn_cli.io.documents import read_text
from omnisyn_cli.io.outputs import real_path


class NoScaleError(PoseError):
    """The poses of a scene are known up to an unknown scale only, so it cannot be used; nothing is broken."""


@dataclass(frozen=True)
class SceneFrame:
    """One panorama of a scene; its files are not read yet."""

    name: str  # what the data set calls it
    image: Path  # its picture
    pose: Pose  # camera-to-world in the axes of :mod:`omnisyn_cli.geometry.sphere`, metres
    depth: Path | None = None  # its depth file, or None
    mask: Path | None = None  # its mask, or None
    # takes the depth file to inverse Euclidean distances in 1/metre, 0 where there is nothing
    read_depth: Callable[[Path], Float[np.ndarray, "height width"]] = read_inverse_depth
    has_holes: bool = False  # no depth means that a scan has a hole there, not that it is infinitely far to anything

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
    """Where a scene can be had from."""

    name: str  # of the scene, unique in its data set
    # reads the poses; raises an :class:`~omnisyn_cli.errors.InputError` where they are damaged
    frames: Callable[[], Iterable[SceneFrame]]

    def read(self) -> Scene:
        """The scene; errors are those of ``frames``."""
        return Scene(self.name, tuple(self.frames()))


def scene_folders(folder: Path, pattern: str) -> list[tuple[str, Path]]:
    """Name and path of the folder itself if it has a file of this pattern, else of those in it that have, by name."""
    if any(folder.glob(pattern)):
        return [(real_path(folder).name, folder)]
    return [(path.name, path) for path in sorted(folder.glob("*/")) if any(path.glob(pattern))]


@dataclass(frozen=True)
class Pair:
    """Two frames of a scene and what lies strictly between them, in walking order."""

    scene: str  # its name
    # the inputs
    first: SceneFrame
    second: SceneFrame
    between: tuple[SceneFrame, ...]  # the truth
    # inputs of the pairs that end and begin where this one begins and ends, if it is part of a tour
    before: SceneFrame | None = None
    after: SceneFrame | None = None


AROUND_PAIRS = "around"  # each frame is left out once, and its neighbours are the inputs

# Takes a scene to its pairs; raises InputError where a frame that was asked for is not there.
PairChooser = Callable[[Scene], list[Pair]]


def choose_pairs(text: str | None) -> PairChooser:
    """What ``--pairs`` means: which frames of a scene are inputs; those between are the truth.

    By default the first and the last. ``0:4,1:3`` names others by index; ``every:4`` takes 0 and 4, 4 and 8 and so on;
    ``around`` the neighbours of each frame but the ends. Otherwise the text names a file with one pair a line: scene,
    first and second frame (names or indices) between white space, ``#`` begins a comment; scenes without a line are not
    evaluated. InputError: neither a list of pairs nor a readable file of them.
    """
    if text is None:
        return lambda scene: [_pair(scene, 0, len(scene.frames) - 1)] if len(scene.frames) > 1 else []
    if Path(text).is_file():
        return _from_file(Path(text))
    plain = "".join(text.split())
    if plain == AROUND_PAIRS:
        return lambda scene: [_pair(scene, at - 1, at + 1) for at in range(1, len(scene.frames) - 1)]
    if match := re.fullmatch(r"every:0*([1-9]\d*)", plain):
        step = int(match[1])
        return lambda scene: [_pair(scene, at, at + step) for at in range(0, len(scene.frames) - step, step)]
    if not re.fullmatch(r"\d+:\d+(,\d+:\d+)*", plain):
        raise InputError(
            f"expected pairs such as 0:4,1:3, or every:4, or the name of a file with pairs, got {text!r}; correct it"
        )
    wanted = list(dict.fromkeys((int(first), int(second)) for first, second in re.findall(r"(\d+):(\d+)", plain)))
    return lambda scene: [_pair(scene, first, second) for first, second in wanted]


def in_tours(pairs: Sequence[Pair]) -> list[Pair]:
    """The pairs of a scene, each with the panoramas before and after it: those of the pairs that it shares one with."""
    before = {pair.second.name: pair.first for pair in pairs[::-1]}
    after = {pair.first.name: pair.second for pair in pairs[::-1]}
    return [replace(pair, before=before.get(pair.first.name), after=after.get(pair.second.name)) for pair in pairs]


def _from_file(path: Path) -> PairChooser:
    wanted: dict[tuple[str, ...], None] = {}
    for number, line in enumerate(read_text(path, "a text file with pairs", error=InputError).splitlines(), start=1):
        words = line.partition("#")[0].split()
        if len(words) == 3:
            wanted[tuple(words)] = None
        elif words:
            raise InputError(
                f"{path}: expected scene, first and second frame in line {number}, got {line!r}; correct it"
            )

    return lambda scene: [
        _pair(scene, _number(first, scene), _number(second, scene))
        for name, first, second in wanted
        if name == scene.name
    ]


def _number(word: str, scene: Scene) -> int:
    names = [frame.name for frame in scene.frames]
    if word in names:
        return names.index(word)
    if word.isdecimal():
        return int(word)
    raise InputError(f"expected a frame of {scene.name} ({', '.join(names[:4])}, …), got {word!r}; correct the pairs")


def _pair(scene: Scene, first: int, second: int) -> Pair:
    last = len(scene.frames) - 1
    if not 0 <= first < second <= last:
        raise InputError(f"expected two frames in ascending order between 0 and {last}, got {first}:{second}")
    frames = scene.frames
    return Pair(scene.name, frames[first], frames[second], frames[first + 1 : second])
