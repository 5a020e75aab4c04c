"""Files of one place: copies, exposure brackets, pictures turned on the spot. One rotation explains all matches."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import rotation_angle
from omnisyn_cli.poses.registration.features import MAX_FEATURES, match_features
from omnisyn_cli.poses.registration.robust import best_rotation, rotation_residual
from omnisyn_cli.poses.registration.scan import LIKENESS_FEATURES, Scan

# Matches of the strongest features, and the share of them without parallax, from which on all features are compared:
# 0.65 or more in copies and exposure brackets of ±3 EV, at most 0.18 in pairs of real tours a step apart.
MIN_MATCHES, MIN_SCREENING_SHARE = 20, 0.4
MIN_SHARE = 0.9  # the same of all features, which have 0.93 or more in them
MIN_TURN = math.radians(1.0)  # radians by which a second picture of a place has to be turned to show anything new


def without_repeats(images: Sequence[Path], scans: Sequence[Scan]) -> tuple[list[Path], list[Scan], list[str]]:
    """One image and its scan of every place, in order, and what there is to say about the others.

    Pictures that were only turned on the spot stay if there is no other place. PoseError: all are of one place.
    """
    places = group_by_place(scans)
    if len(places) == 1:
        turns = [rotation_between(scans[0], scan) for scan in scans]
        if not any(turn is not None and float(rotation_angle(turn)) > MIN_TURN for turn in turns):
            raise PoseError(
                f"{', '.join(map(str, images))}: expected pictures from two places, got one place (copies, or an "
                "exposure bracket); add one from another place, or mask what moves with the camera (--nadir)"
            )
        return list(images), list(scans), []
    notes = [
        f"{' and '.join(images[k].name for k in place)} were taken from one place; only {images[place[0]].name} is used"
        for place in places
        if len(place) > 1
    ]
    return [images[place[0]] for place in places], [scans[place[0]] for place in places], notes


def group_by_place(scans: Sequence[Scan]) -> list[list[int]]:
    """The numbers of the panoramas of each place."""
    places: list[list[int]] = []
    for index, scan in enumerate(scans):
        known = (place for place in places if rotation_between(scans[place[0]], scan) is not None)
        if (place := next(known, None)) is None:
            places.append(place := [])
        place.append(index)
    return places


def rotation_between(first: Scan, second: Scan) -> Float[np.ndarray, "3 3"] | None:
    """First-from-second rotation, if it explains the matches: then there is no parallax."""
    for count, least in ((LIKENESS_FEATURES, MIN_SCREENING_SHARE), (MAX_FEATURES, MIN_SHARE)):
        matches = match_features(*(scan.features.strongest(count) for scan in (first, second)))
        if len(matches) < MIN_MATCHES:
            return None
        rotation = best_rotation(matches)
        if np.mean(rotation_residual(rotation, matches) < matches.tolerance) < least:
            return None
    return rotation
