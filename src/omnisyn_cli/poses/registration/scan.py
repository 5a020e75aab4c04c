"""What is read from a panorama to register it: features, straight lines, and the zenith that they tell.

Straight lines of the world are great circles of the sphere. Those of vertical lines all pass through the zenith, so the
normals of their planes are horizontal. Cameras are taken to be held upright within :data:`MAX_TILT`.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.pose import Pose, rotation_taking
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import UP, normalize
from omnisyn_cli.poses.registration import features, robust
from omnisyn_cli.poses.registration.features import Features, Grey, LevelledFeatures, Matches, Picture, Usable
from omnisyn_cli.poses.registration.least_squares import refine_pose
from omnisyn_cli.poses.registration.robust import Estimate, Verticals
from omnisyn_cli.stereo.disparity import dense_agreement
from omnisyn_cli.types import View

# Of a camera; lines that meet farther from its own zenith are not taken for vertical ones.
MAX_TILT = math.radians(35.0)

# Side of the six tangent images that lines are looked for in, over the rows of the panorama, and tangent of half their
# angle. They overlap a little, so that no line is lost at an edge. In larger ones the columns of pixels become lines.
FACE_SHARE, FACE_TANGENT = 0.625, 1.1
MIN_LINE_ANGLE = math.radians(2.0)  # Radians that a line segment has to span
MAX_LINES = 800  # The longest ones are searched; each is compared with every hypothesis
HYPOTHESES = 3000  # Pairs of lines that are tried, long ones more often

# Radians off the zenith within which a line speaks for it, in the search and in the end.
VOTE_WIDTH, FIT_WIDTH = math.radians(1.5), math.radians(0.4)
FIT_ROUNDS = 15  # Rounds of reweighted least squares; the width shrinks by a fifth in each
RIVAL_ANGLE = math.radians(6.0)  # Radians from the best direction beyond which another one is a rival

# Votes of the strongest rival over those of the best, up to which it is certain. Of 180 generated panoramas all ten
# that were wrong by more than 1° had 0.86 or more.
MAX_RIVAL_SHARE = 0.8
MIN_LINES = 8  # Lines that have to agree at least
HALVES = 32  # Random ones of the lines that are fitted apart. How much they differ tells how well the zenith is known

# Rotations of the six tangent images, which look along −z of their own.
CAMERA_FROM_FACE = tuple(
    rotation_taking(np.array([0.0, 0.0, -1.0]), np.array(axis, float))
    for axis in ((0, 0, -1), (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
)

Lines = Float[np.ndarray, "n 3"]
"""Normals of the planes of line segments, as long as the angle in radians that the segment spans."""


@dataclass(frozen=True)
class Vertical:
    """The zenith as lines tell it."""

    up: Float[np.ndarray, " 3"]  # unit vector in the frame of the lines
    std: float  # its standard deviation, radians
    is_certain: bool  # enough lines agree, and no other direction has nearly as many


def find_lines(grey: Grey, usable: Usable = None) -> Lines:
    """Line segments whose middles are usable. Source: Grompone von Gioi et al., LSD, PAMI 2010."""
    detector = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD)
    found, middles = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for face, rotation in enumerate(CAMERA_FROM_FACE):
        table = face_table((grey.shape[0], grey.shape[1]), face)
        side = len(table.row)
        segments = detector.detect(table.bilinear(grey))[0]
        if segments is not None:
            ends = ((segments.reshape(-1, 2, 2) + 0.5) / side * 2.0 - 1.0) * FACE_TANGENT
            directions = normalize(np.stack([ends[..., 0], -ends[..., 1], -np.ones(ends.shape[:2])], axis=-1))
            found.append(np.cross(directions[:, 0], directions[:, 1]) @ rotation.T)
            middles.append(normalize(directions.sum(axis=1)) @ rotation.T)
    sines = np.concatenate(found)
    length = np.linalg.norm(sines, axis=1, keepdims=True)
    chosen = length[:, 0] > math.sin(MIN_LINE_ANGLE)
    if usable is not None:
        chosen &= np.asarray(sample_nearest(usable.astype(np.float32), np.concatenate(middles)) > 0)
    return np.asarray(sines[chosen] / length[chosen] * np.arcsin(length[chosen].clip(0.0, 1.0)))


@lru_cache(maxsize=len(CAMERA_FROM_FACE))
def face_table(size: tuple[int, int], face: int) -> RemapTable:
    """Where a tangent image is in panoramas of a size; who has read the last one calls ``cache_clear``."""
    side = round(FACE_SHARE * size[0])
    across = ((np.arange(side) + 0.5) / side * 2.0 - 1.0) * FACE_TANGENT
    x, y = np.meshgrid(across, -across)
    plane = normalize(np.stack([x, y, -np.ones_like(x)], axis=-1))
    return RemapTable.for_directions(plane @ CAMERA_FROM_FACE[face].T, size)


def find_vertical(lines: Lines, near: Float[np.ndarray, " 3"] = UP) -> Vertical:
    """The direction within :data:`MAX_TILT` of ``near`` that most segments point at; else ``near``, uncertain."""
    length = np.linalg.norm(lines, axis=1)
    longest = np.argsort(-length, kind="stable")
    chosen = longest[np.abs(lines[longest] @ near) < math.sin(MAX_TILT) * length[longest]][:MAX_LINES]
    length, normal = length[chosen], lines[chosen] / length[chosen, None]
    if len(normal) < MIN_LINES:
        return Vertical(near, math.inf, is_certain=False)
    rng = np.random.default_rng(0)
    pairs = rng.choice(len(normal), (2, HYPOTHESES), p=length / length.sum())
    crossing = np.cross(normal[pairs[0]], normal[pairs[1]])
    sine = np.linalg.norm(crossing, axis=1)
    crossing = (crossing / np.maximum(sine, 1e-9)[:, None])[sine > math.sin(RIVAL_ANGLE)]
    crossing *= np.where(crossing @ near < 0, -1.0, 1.0)[:, None]
    hypotheses = np.concatenate([crossing[crossing @ near > math.cos(MAX_TILT)], near[None]])
    off = np.einsum("ni,hi->nh", normal, hypotheses) / math.sin(VOTE_WIDTH)
    votes = np.einsum("nh,n->h", np.maximum(1.0 - off**2, 0.0), length)
    best = hypotheses[int(np.argmax(votes))]
    rival = votes[hypotheses @ best < math.cos(RIVAL_ANGLE)].max(initial=0.0)
    up = _fitted(best, normal, length)
    halves = rng.random((HALVES, len(normal))) < 0.5
    apart = [_fitted(up, normal[one], length[one]) - _fitted(up, normal[~one], length[~one]) for one in halves]
    std = 0.5 * float(np.sqrt(np.mean(np.sum(np.square(apart), axis=1))))
    count = int((np.abs(normal @ up) < FIT_WIDTH).sum())
    return Vertical(up, std, bool(rival <= MAX_RIVAL_SHARE * votes.max() and count >= MIN_LINES))


def _fitted(up: np.ndarray, normal: np.ndarray, length: np.ndarray) -> Float[np.ndarray, " 3"]:
    """The zenith by least squares, with the weights of Geman and McClure."""
    width = math.sin(VOTE_WIDTH)
    for _ in range(FIT_ROUNDS):
        robust = 1.0 / (1.0 + (normal @ up / width) ** 2) ** 2
        axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", length * robust, normal, normal))[1]
        up = axes[:, 0] * math.copysign(1.0, float(axes[:, 0] @ up))
        width = max(0.8 * width, math.sin(FIT_WIDTH))
    return up


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
SMALL_SIZE = (256, 512)  # Of the picture in colour that floors are looked for in

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
    is_enough = estimate is not None and not estimate.is_planar and estimate.inliers.sum() >= least
    if is_enough:
        return _with_right_direction(first, second, estimate, matches, verticals), matches
    known = [] if estimate is None or estimate.have_same_position else [estimate.first_from_second]
    matches += features.match_levelled_features(first.levelled, second.levelled)
    estimate = robust.estimate_relative_pose(matches, known, verticals)
    return _with_right_direction(first, second, estimate, matches, verticals), matches


def _with_right_direction(
    first: Scan, second: Scan, estimate: Estimate | None, matches: Matches, verticals: Verticals | None
) -> Estimate | None:
    """The estimate; that of its rival where the pictures agree better with it, or None without one.

    Repeated things match their neighbours, which are displaced the other way. A rival that fits as well stays one.
    """
    if estimate is None or estimate.have_same_position:
        return estimate
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
