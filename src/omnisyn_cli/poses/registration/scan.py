"""What is read from a panorama to register it, and what two of them tell: their relative pose, or that it is one place.

Copies, exposure brackets and pictures turned on the spot are of one place: one rotation explains all matches.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_angle
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import UP, normalize
from omnisyn_cli.poses.gravity import SMALL_SIZE, Lines, Vertical, face_table, find_lines, find_vertical
from omnisyn_cli.poses.registration import features, robust
from omnisyn_cli.poses.registration.features import Features, Grey, LevelledFeatures, Matches, Picture, Usable
from omnisyn_cli.poses.registration.least_squares import refine_pose
from omnisyn_cli.poses.registration.robust import Estimate, Verticals
from omnisyn_cli.stereo.disparity import dense_agreement
from omnisyn_cli.types import View

# Agreeing matches, and their share, from which on no more are looked for. With fewer a pose is often off by a degree,
# with a smaller share it may be that of repeated things.
ENOUGH_INLIERS, ENOUGH_SHARE = 60, 0.25

# Share of its matches that a direction to the other side needs to be tried, and how much better pictures have to agree
# with it: a true direction is ahead of its opposite by at least 1.5 (:mod:`omnisyn_cli.stereo.disparity`).
MIN_RIVAL_SHARE, MIN_AGREEMENT_RATIO = 0.1, 1.2

# How unlikely such a direction has to be by chance. (In a real corridor of equal doors pictures agreed 2.8 times better
# with a wrong direction.)
MAX_RIVAL_LOG_FALSE_ALARMS = -40.0
# Directions to the other side that two matches each propose, and how many of the best are counted exactly.
RIVAL_SAMPLES, RIVAL_CANDIDATES = 400, 8
LIKENESS_FEATURES = 600  # Of each panorama, for :meth:`Scan.likeness`: a hundredth of the time that all of them take

# Mean difference of the first and last column, in sRGB values and in means of neighbouring columns, above which they do
# not meet if no neighbours differ more. (Of 445 panoramas none is above, of parts of them two thirds.)
MIN_SEAM_STEP, MIN_SEAM_RATIO = 0.06, 4.0
# Of the rows, at either pole, that the test of the seam leaves out: all their pixels are close together.
POLAR_SHARE = 0.1


@dataclass(frozen=True)
class Scan:
    """One panorama as registration sees it."""

    fine_grey: Grey  # luma for :attr:`levelled`
    small: Float[np.ndarray, "rows cols 3"]  # the picture in colour at :data:`SMALL_SIZE`
    usable: Usable
    features: Features  # the strongest features
    lines: Lines  # straight lines
    threads: int | None = None  # at most this many in OpenCV

    @property
    def view(self) -> View:
        """The small picture, upright in its own frame."""
        return View(self.small, Pose.identity(), self.usable)

    @property
    def meets_at_seam(self) -> bool:
        """Whether the last column continues with the first one, as in panoramas; also if not both may be used."""
        if self.usable is not None and not self.usable[:, [0, -1]].any(axis=0).all():
            return True
        polar = round(POLAR_SHARE * len(self.small))
        picture = self.small[polar:-polar]
        seam = float(np.abs(picture[:, 0] - picture[:, -1]).mean())
        steps = np.abs(np.diff(picture, axis=1)).mean(axis=(0, 2))
        return seam < max(MIN_SEAM_STEP, MIN_SEAM_RATIO * float(steps.mean()), float(steps.max()))

    @cached_property
    def vertical(self) -> Vertical:
        """The zenith in the camera's frame."""
        return find_vertical(self.lines)

    @property
    def zenith(self) -> Float[np.ndarray, " 3"]:
        """Its vertical; that of a level camera where lines do not tell it for certain."""
        return self.vertical.up if self.vertical.is_certain else UP

    def likeness(self, other: "Scan") -> int:
        """How many of the strongest features match: quickly found, and enough to rank pairs by."""
        return len(features.match_features(*(each.features.strongest(LIKENESS_FEATURES) for each in (self, other))))

    @cached_property
    def levelled(self) -> LevelledFeatures:
        """Features of walls and floor; found when they are first asked for."""
        return features.find_levelled_features(self.fine_grey, self.vertical.up, self.usable, self.threads)


def scan_panorama(image: Picture, usable: Usable = None, threads: int | None = None) -> Scan:
    """Look for features and lines in a panorama."""
    grey, small = features.grey_of(image), resize_area(image, SMALL_SIZE)
    found, lines = features.find_features(grey, usable, threads), find_lines(grey, usable)
    return Scan(features.fine_grey_of(image), small, usable, found, lines, threads)


def forget_tables() -> None:
    """Free what scanning keeps for further panoramas of the same size."""
    features.band_table.cache_clear()
    face_table.cache_clear()


def register_pair(first: Scan, second: Scan) -> tuple[Estimate | None, Matches]:
    """The relative pose of two panoramas, and its matches: also of walls and floors where few others agree."""
    verticals = Verticals(first.zenith, second.zenith, first.vertical.is_certain and second.vertical.is_certain)
    matches = features.match_features(first.features, second.features)
    estimate = robust.estimate_relative_pose(matches, verticals=verticals) if len(matches) >= ENOUGH_INLIERS else None
    least = max(ENOUGH_INLIERS, ENOUGH_SHARE * len(matches))
    if estimate is None or estimate.is_planar or estimate.inliers.sum() < least:
        known = [] if estimate is None or estimate.have_same_position else [estimate.first_from_second]
        matches += features.match_levelled_features(first.levelled, second.levelled)
        estimate = robust.estimate_relative_pose(matches, known, verticals)
    return _with_right_direction(first, second, estimate, matches, verticals), matches


def _with_right_direction(
    first: Scan, second: Scan, estimate: Estimate | None, matches: Matches, verticals: Verticals | None
) -> Estimate | None:
    """The estimate; that of its rival where the pictures agree better with it, or None without one."""
    if estimate is None or estimate.have_same_position:
        return estimate
    # repeated things match their neighbours, which are displaced the other way; a rival that fits as well stays one
    pose = estimate.first_from_second
    rival = estimate.rival or _opposite_rival(pose, estimate.inliers, matches, verticals)
    if rival is None:
        return estimate
    agreement = [dense_agreement(first.view, second.view, each) for each in (pose, rival)]
    if agreement[0] >= MIN_AGREEMENT_RATIO * agreement[1]:
        return replace(estimate, rival=None)
    if agreement[1] < MIN_AGREEMENT_RATIO * agreement[0]:
        return estimate
    other = robust.estimate_from_subset(matches, ~estimate.inliers, [rival], verticals)
    return None if other is None or other.have_same_position else other


def _opposite_rival(
    pose: Pose, inliers: Bool[np.ndarray, " n"], matches: Matches, verticals: Verticals | None
) -> Pose | None:
    """A pose of a direction to the other side that many other matches agree with; None without one."""
    others = matches.select(~inliers)  # far ones agree with both
    rival, support = _best_rival(pose, others)
    if support < MIN_RIVAL_SHARE * int(inliers.sum()):
        return None
    rival = refine_pose(rival, others, others.tolerance)
    return rival if robust.log_false_alarms(rival, matches, verticals) <= MAX_RIVAL_LOG_FALSE_ALARMS else None


def _best_rival(pose: Pose, others: Matches) -> tuple[Pose, int]:
    """The pose of the same rotation and a direction to the other side that most of other matches agree with."""
    scale = others.tolerance
    normals = np.cross(others.first, others.second @ pose.rotation.T)
    pairs = np.random.default_rng(0).integers(max(len(normals), 1), size=(RIVAL_SAMPLES if len(normals) else 0, 2))
    ways = np.cross(normals[pairs[:, 0]], normals[pairs[:, 1]])
    ways = ways[np.linalg.norm(ways, axis=1) > scale**2]
    ways = np.where((ways @ pose.position > 0.0)[:, None], -ways, ways)
    ways = np.concatenate([-pose.position[None], np.asarray(normalize(ways))])
    residual = np.abs(normals @ ways.T) / np.sqrt((1.0 - (others.first @ ways.T) ** 2).clip(scale**2))
    best = np.argsort(-(residual < scale).sum(axis=0), kind="stable")[:RIVAL_CANDIDATES]
    rivals = [Pose(pose.rotation, ways[k]) for k in sorted({0, *best.tolist()})]
    support = [int(robust.support_mask(rival, others).sum()) for rival in rivals]
    return rivals[int(np.argmax(support))], max(support)


# Matches of the strongest features, and the share of them without parallax, from which on all features are compared:
# 0.65 or more in copies and exposure brackets of ±3 EV, at most 0.18 in pairs of real tours a step apart.
MIN_PLACE_MATCHES, MIN_SCREENING_SHARE = 20, 0.4
MIN_PLACE_SHARE = 0.9  # the same of all features, which have 0.93 or more in them
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
    for count, least in ((LIKENESS_FEATURES, MIN_SCREENING_SHARE), (features.MAX_FEATURES, MIN_PLACE_SHARE)):
        matches = features.match_features(*(scan.features.strongest(count) for scan in (first, second)))
        if len(matches) < MIN_PLACE_MATCHES:
            return None
        rotation = robust.best_rotation(matches)
        if np.mean(robust.rotation_residual(rotation, matches) < matches.tolerance) < least:
            return None
    return rotation
