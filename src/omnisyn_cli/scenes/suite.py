"""The standard evaluation set: streets and rooms from fixed seeds, each walked 1, 2, 4 and 6 metres.

All baselines of a scene begin at the same first panorama and go the same way, so that figures differ by the distance
and by nothing else. Poses are rounded so far that they are the same numbers on every machine.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.scenes.paths import sample_path
from omnisyn_cli.scenes.room import room
from omnisyn_cli.scenes.scene import Scene
from omnisyn_cli.scenes.street import street

STANDARD_KINDS = ("street", "room")
"""Generators of the standard set; others may come, these stay what they are."""

SUITE_SEEDS = (9_000_001, 9_000_002)
"""Far beyond those that networks are trained with."""

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


def suite_scenes(kinds: Sequence[str] = STANDARD_KINDS, seeds: Sequence[int] = SUITE_SEEDS) -> Iterator[SuiteScene]:
    """All walks, those of a scene from the shortest on."""
    for kind in kinds:
        for seed in seeds:
            longest = longest_path({"street": street, "room": room}[kind](seed), seed)
            for baseline in BASELINES:
                yield SuiteScene(kind, seed, baseline, tuple(_evenly_spaced(longest, baseline)))


def longest_path(scene: Scene, seed: int) -> tuple[Pose, ...]:
    """Both ends of the longest free way that is one of :data:`BASELINES`; none where even the shortest is not free."""
    for baseline in reversed(BASELINES):
        try:
            ends = sample_path(scene, seed, 2, baseline=baseline, vertical=0.0)
        except ValueError:
            continue
        return tuple(Pose(np.round(end.rotation, 12), np.round(end.position, POSITION_DECIMALS)) for end in ends)
    return ()


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
