"""What is read from a panorama to register it: features, straight lines, and the zenith that they tell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import UP, normalize
from omnisyn_cli.poses.registration.features import (
    Features,
    LevelledFeatures,
    Matches,
    band_table,
    find_grey_features,
    find_levelled_features,
    fine_grey_of,
    grey_of,
    match_features,
    match_levelled_features,
)
from omnisyn_cli.poses.registration.gravity import Lines, Vertical, face_table, find_lines, find_vertical
from omnisyn_cli.poses.registration.least_squares import refine_pose
from omnisyn_cli.poses.registration.robust import (
    Estimate,
    Verticals,
    estimate_from_subset,
    estimate_relative_pose,
    inlier_threshold,
    log_false_alarms,
    support_mask,
)
from omnisyn_cli.stereo.dense_agreement import dense_agreement
from omnisyn_cli.types import View

ENOUGH_INLIERS, ENOUGH_SHARE = 60, 0.25
"""Agreeing matches, and their share, from which on no more are looked for. With fewer a pose is often off by a degree,
with a smaller share it may be that of repeated things."""


MIN_RIVAL_SHARE, MIN_AGREEMENT_RATIO = 0.1, 1.2
"""Share of its matches that a direction to the other side needs to be tried, and how much better pictures have to agree
with it: a true direction is ahead of its opposite by at least 1.5 (:mod:`omnisyn_cli.stereo.dense_agreement`)."""

MAX_RIVAL_LOG_FALSE_ALARMS = -20.0
"""How unlikely such a direction has to be by chance. (In a real corridor of equal doors pictures agreed 2.8 times
better with a wrong direction, whose logarithm was −9.)"""

RIVAL_SAMPLES, RIVAL_CANDIDATES = 400, 8
"""Directions to the other side that two matches each propose, and how many of the best are counted exactly."""

LIKENESS_FEATURES = 600
"""Of each panorama, for :func:`likeness`: a hundredth of the time that all of them take."""

SMALL_ROWS = 256
"""Rows of the picture in colour that floors are looked for in."""


MIN_SEAM_STEP, MIN_SEAM_RATIO = 0.06, 4.0
"""Mean difference of the first and last column, in sRGB values and in means of neighbouring columns, above which they
do not meet if no neighbours differ more. (Of 445 panoramas none is above, of parts of them two thirds.)"""

POLAR_SHARE = 0.1
"""Of the rows, at either pole, that the test of the seam leaves out: all their pixels are close together."""


@dataclass(frozen=True)
class Scan:
    """One panorama as registration sees it."""

    fine_grey: UInt8[np.ndarray, "height width"]  # luma for :attr:`levelled`
    small: Float[np.ndarray, "rows cols 3"]  # the picture in colour at :data:`SMALL_ROWS`
    usable: Bool[np.ndarray, "all_rows all_cols"] | None  # where it may be used; None is everywhere
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
        polar = round(POLAR_SHARE * SMALL_ROWS)
        picture = self.small[polar : SMALL_ROWS - polar]
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

    @cached_property
    def levelled(self) -> LevelledFeatures:
        """Features of walls and floor; found when they are first asked for."""
        return find_levelled_features(self.fine_grey, self.vertical.up, self.usable, self.threads)


def scan_panorama(
    image: Float[np.ndarray, "height width 3"],
    usable: Bool[np.ndarray, "height width"] | None = None,
    threads: int | None = None,
) -> Scan:
    """Look for features and lines in a panorama, RGB in [0, 1]."""
    grey = grey_of(image)
    small = cv2.resize(np.asarray(image, np.float32), (2 * SMALL_ROWS, SMALL_ROWS), interpolation=cv2.INTER_AREA)
    return Scan(
        fine_grey_of(image), small, usable, find_grey_features(grey, usable, threads), find_lines(grey, usable), threads
    )


def forget_tables() -> None:
    """Free what scanning keeps for further panoramas of the same size."""
    band_table.cache_clear()
    face_table.cache_clear()


def likeness(first: Scan, second: Scan) -> int:
    """How many of the strongest features match: quickly found, and enough to rank pairs by."""
    return len(match_features(*(scan.features.strongest(LIKENESS_FEATURES) for scan in (first, second))))


def register_pair(first: Scan, second: Scan, *, is_thorough: bool = True) -> tuple[Estimate | None, Matches]:
    """The relative pose of two panoramas, and the matches that it was found from.

    Where few matches agree, walls and floors are compared as well, if the search is thorough.
    """
    verticals = Verticals(first.zenith, second.zenith, first.vertical.is_certain and second.vertical.is_certain)
    matches = match_features(first.features, second.features)
    estimate = estimate_relative_pose(matches, verticals=verticals)
    is_enough = estimate is not None and estimate.inliers.sum() >= max(ENOUGH_INLIERS, ENOUGH_SHARE * len(matches))
    if is_enough or not is_thorough:
        kept = estimate if is_enough else None
        return _with_right_direction(first, second, kept, matches, verticals), matches
    known = [] if estimate is None or estimate.have_same_position else [estimate.first_from_second]
    matches += match_levelled_features(first.levelled, second.levelled)
    estimate = estimate_relative_pose(matches, known, verticals)
    return _with_right_direction(first, second, estimate, matches, verticals), matches


def _with_right_direction(
    first: Scan, second: Scan, estimate: Estimate | None, matches: Matches, verticals: Verticals | None
) -> Estimate | None:
    """The estimate; that of a direction to the other side where the pictures agree better with it, or None without one.

    Repeated things can be matched to their neighbours, which are displaced the other way.
    """
    if estimate is None or estimate.have_same_position:
        return estimate
    pose, others = estimate.first_from_second, matches.select(~estimate.inliers)  # far ones agree with both
    rival, support = _best_rival(pose, others)
    if support < MIN_RIVAL_SHARE * int(estimate.inliers.sum()):
        return estimate
    rival = refine_pose(rival, others, inlier_threshold(matches))
    if log_false_alarms(rival, matches, verticals) > MAX_RIVAL_LOG_FALSE_ALARMS:
        return estimate
    agreement = [dense_agreement(first.view, second.view, each) for each in (pose, rival)]
    if agreement[1] < MIN_AGREEMENT_RATIO * agreement[0]:
        return estimate
    other = estimate_from_subset(matches, ~estimate.inliers, [rival], verticals)
    return None if other is None or other.have_same_position else other


def _best_rival(pose: Pose, others: Matches) -> tuple[Pose, int]:
    """The pose of the same rotation and a direction to the other side that most of other matches agree with."""
    scale = inlier_threshold(others)
    normals = np.cross(others.first, others.second @ pose.rotation.T)
    pairs = np.random.default_rng(0).integers(max(len(normals), 1), size=(RIVAL_SAMPLES if len(normals) else 0, 2))
    ways = np.cross(normals[pairs[:, 0]], normals[pairs[:, 1]])
    ways = ways[np.linalg.norm(ways, axis=1) > scale**2]
    ways = np.where((ways @ pose.position > 0.0)[:, None], -ways, ways)
    ways = np.concatenate([-pose.position[None], np.asarray(normalize(ways))])
    residual = np.abs(normals @ ways.T) / np.sqrt((1.0 - (others.first @ ways.T) ** 2).clip(scale**2))
    best = np.argsort(-(residual < scale).sum(axis=0), kind="stable")[:RIVAL_CANDIDATES]
    rivals = [Pose(pose.rotation, ways[k]) for k in sorted({0, *best.tolist()})]
    support = [int(support_mask(rival, others, scale).sum()) for rival in rivals]
    return rivals[int(np.argmax(support))], max(support)
