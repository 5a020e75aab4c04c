"""Headings of panoramas that nobody has told: from the pictures of neighbours, or along the track of the positions.

What turns one picture into the next carries a known heading on. Where none is known, the directions of the cameras seen
in the pictures are laid on the track of the positions by one turn about the vertical. Where pictures tell nothing, the
image centre is taken to look along the track.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import ImageError
from omnisyn_cli.geometry.pose import SAME_POSITION_METRES, Pose, rotation_from_heading
from omnisyn_cli.io import read_panorama
from omnisyn_cli.io.documents import listed
from omnisyn_cli.poses.registration.scan import Scan, register_pair, scan_panorama

Rotations = dict[str, Float[np.ndarray, "3 3"]]


def rotations_by_neighbours(
    positions: Mapping[str, Float[np.ndarray, " 3"]], known: Rotations, held: Rotations,
    images: Mapping[str, Path | None],
) -> tuple[Rotations, list[str]]:  # fmt: skip
    """World-from-camera rotations of all that have one, and notes; ``held`` is as if all looked north.

    ``known`` ones stay; positions and rotations are in one local world (x east, y up, −z north).
    """
    scan_of = lru_cache(maxsize=2)(_scan)
    relative = {
        pair: pose
        for pair in pairwise(positions)
        if not set(pair) <= set(known) and (pose := _relative_pose(*(scan_of(images[k]) for k in pair))) is not None
    }
    found = dict(known)
    _carry_on(found, relative)
    carried, errors = [name for name in positions if name in found and name not in known], []
    for name in positions:
        if name not in found and (laid := _laid_on_track({name: held[name]}, relative, positions)) is not None:
            group, error = laid
            found |= group
            carried += list(group)
            errors.append(error)
    left = [name for name in positions if name not in found]
    travel = {name: way for name in left if (way := _along_track(name, positions)) is not None}
    found |= {name: way @ held[name] for name, way in travel.items()}
    notes = []
    if carried:
        fits = f"; they fit the track of the positions within {math.degrees(max(errors)):.0f}°" if errors else ""
        notes.append(f"headings: those of {listed(carried)} come from the pictures{fits}")
    if travel:
        notes.append(
            f"headings: nothing tells those of {listed(list(travel))}, which are taken to look along the track; if "
            "they do not, give a table with headings, or let 'omnisyn poses estimate' find the poses"
        )
    return found, notes


def _scan(path: Path | None) -> Scan | None:
    """What is distinctive in a panorama; None of a picture that is none."""
    if path is None:
        return None
    try:
        panorama = read_panorama(path)
    except ImageError:
        return None
    return scan_panorama(panorama.image, panorama.mask)


def _relative_pose(first: Scan | None, second: Scan | None) -> Pose | None:
    """Rotation and direction of the second camera in the frame of the first, if their pictures tell them."""
    if first is None or second is None:
        return None
    estimate, _ = register_pair(first, second)
    return None if estimate is None else estimate.first_from_second


def _carry_on(rotations: Rotations, relative: Mapping[tuple[str, str], Pose]) -> None:
    """Add the rotations of all that are compared, over any number of others, with one that has a rotation."""
    pairs = list(relative.items())
    for (first, second), pose in (*pairs, *reversed(pairs)):
        if first in rotations and second not in rotations:
            rotations[second] = rotations[first] @ pose.rotation
        elif second in rotations and first not in rotations:
            rotations[first] = rotations[second] @ pose.rotation.T


def _laid_on_track(
    group: Rotations, relative: Mapping[tuple[str, str], Pose], positions: Mapping[str, np.ndarray]
) -> tuple[Rotations, float] | None:
    """A group and all compared with it, turned to fit the track; the largest angle off it. None: nobody has moved."""
    _carry_on(group, relative)
    pairs = [pair for pair in relative if pair[0] in group and pair[1] in group]
    ways = np.array([positions[b] - positions[a] for a, b in pairs]).reshape(-1, 3)[:, [0, 2]]
    seen = np.array([group[pair[0]] @ relative[pair].position for pair in pairs]).reshape(-1, 3)[:, [0, 2]]
    cosine, sine = (ways * seen).sum(), (ways[:, 0] * seen[:, 1] - ways[:, 1] * seen[:, 0]).sum()
    if math.hypot(cosine, sine) <= SAME_POSITION_METRES:
        return None
    turn = math.atan2(sine, cosine)
    across = np.arctan2(ways[:, 0] * seen[:, 1] - ways[:, 1] * seen[:, 0], (ways * seen).sum(axis=1)) - turn
    errors = np.abs((across + math.radians(180.0)) % math.radians(360.0) - math.radians(180.0))
    about_vertical = rotation_from_heading(-turn)
    return {name: about_vertical @ rotation for name, rotation in group.items()}, float(errors.max())


def _along_track(name: str, positions: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """The turn to the way onwards, at the end to that which led there; None where nobody has moved."""
    names = list(positions)
    index = names.index(name)
    for begin, end in (*pairwise(names[index:]), *reversed(list(pairwise(names[: index + 1])))):
        east, _, south = positions[end] - positions[begin]
        if math.hypot(east, south) > SAME_POSITION_METRES:
            return rotation_from_heading(math.atan2(east, -south))
    return None
