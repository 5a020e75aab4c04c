"""The standard evaluation set: streets and rooms from fixed seeds, each walked 1, 2, 4 and 6 metres; and a wide one.

All baselines of a scene begin at the same first panorama and go the same way, so that figures differ by the distance
and by nothing else. The wide set has ten scenes of every kind instead, each walked once and as far as is usual there,
so that figures do not depend on a single seed. Poses are rounded so far that they are the same numbers on every
machine.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.geometry.pose import Pose, distance_between
from omnisyn_cli.scenes.paths import sample_path
from omnisyn_cli.scenes.scene import Scene

__all__ = [
    "FRAMES_PER_WALK",
    "STANDARD_KINDS",
    "SUITE_SEEDS",
    "WIDE_SEEDS",
    "SuiteScene",
    "suite_walks",
    "wide_walk",
]

STANDARD_KINDS = ("street", "room")
"""Generators of the standard set and of the depth table; others may come, these stay what they are."""

SUITE_SEEDS = (9_000_001, 9_000_002)
"""Far beyond those that networks are trained with."""

WIDE_SEEDS = {
    kind: range(9_100_001 + 10 * index, 9_100_011 + 10 * index)
    for index, kind in enumerate((*STANDARD_KINDS, "home", "jumble", "yard"))
}
"""Of the wide set by kind: every scene has a seed of its own."""

BASELINES = (1.0, 2.0, 4.0, 6.0)
"""Metres from the first to the last panorama, ascending."""

FRAMES_PER_WALK = 5
"""Two inputs, and three true frames at equal distances between them."""

POSITION_DECIMALS = 6
"""Decimals of the ends in metres: micrometres, far coarser than the arithmetic of two machines may differ."""


@dataclass(frozen=True)
class SuiteScene:
    """One walk through one scene.

    Attributes:
        kind: a key of :data:`omnisyn_cli.scenes.GENERATORS`.
        seed: of scene and path.
        baseline: metres from the first to the last panorama.
        path: poses of all panoramas in walking order; empty where the scene has no room for this baseline.
    """

    kind: str
    seed: int
    baseline: float
    path: tuple[Pose, ...]

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.kind}-{self.seed}-{self.baseline:g}m"


def suite_walks(kind: str, seed: int, scene: Scene) -> Iterator[SuiteScene]:
    """The walks through a scene, the shortest first; those that it has no room for have an empty path.

    The scene was made with ``kind`` and ``seed``; the seed chooses the way as well.
    """
    longest = suite_path(scene, seed)
    for baseline in BASELINES:
        yield SuiteScene(kind, seed, baseline, tuple(_evenly_spaced(longest, baseline)))


def wide_walk(kind: str, seed: int, scene: Scene) -> SuiteScene:
    """The walk through a scene of the wide set, whose path is empty where there is no room; arguments as above."""
    try:
        first, last = sample_path(scene, seed, 2, vertical=0.0)
    except ValueError:
        return SuiteScene(kind, seed, 0.0, ())
    ends = _rounded(first), _rounded(last)
    length = distance_between(*ends)
    return SuiteScene(kind, seed, round(length, 2), tuple(_evenly_spaced(ends, length)))


def suite_path(scene: Scene, seed: int) -> tuple[Pose, ...]:
    """Both ends of the longest free way that is one of :data:`BASELINES`; none where even the shortest is not free."""
    for baseline in reversed(BASELINES):
        try:
            first, last = sample_path(scene, seed, 2, baseline=baseline, vertical=0.0)
        except ValueError:
            continue
        return _rounded(first), _rounded(last)
    return ()


def _rounded(pose: Pose) -> Pose:
    return Pose(np.round(pose.rotation, 12), np.round(pose.position, POSITION_DECIMALS))


def _evenly_spaced(longest: tuple[Pose, ...], baseline: float) -> Iterator[Pose]:
    """Poses evenly spaced over the first metres of a way; none where it is shorter."""
    if not longest:
        return
    way = longest[1].position - longest[0].position
    length = float(np.linalg.norm(way))
    if baseline > length + 10**-POSITION_DECIMALS:
        return
    for share in np.linspace(0.0, baseline / length, FRAMES_PER_WALK):
        yield Pose(longest[0].rotation, np.round(longest[0].position + share * way, POSITION_DECIMALS))
