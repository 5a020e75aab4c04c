"""Which way is up in a panorama: where the vertical edges of buildings, doors and posts meet.

Straight lines of the world are great circles of the sphere. Those of vertical lines all pass through the zenith, so the
normals of their planes are horizontal. Cameras are taken to be held upright within :data:`MAX_TILT`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from omnisyn_cli.geometry.pose import rotation_taking
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import UP, normalize

MAX_TILT = math.radians(35.0)
"""Of a camera; lines that meet farther from its own zenith are not taken for vertical ones."""

FACE_SHARE, FACE_TANGENT = 0.625, 1.1
"""Side of the six tangent images that lines are looked for in, over the rows of the panorama, and tangent of half their
angle. They overlap a little, so that no line is lost at an edge. In larger ones the columns of pixels become lines."""

MIN_LINE_ANGLE = math.radians(2.0)
"""Radians that a line segment has to span."""

MAX_LINES = 800
"""The longest ones are searched; each is compared with every hypothesis."""

HYPOTHESES = 3000
"""Pairs of lines that are tried, long ones more often."""

VOTE_WIDTH, FIT_WIDTH = math.radians(1.5), math.radians(0.4)
"""Radians off the zenith within which a line speaks for it, in the search and in the end."""

FIT_ROUNDS = 15
"""Rounds of reweighted least squares; the width shrinks by a fifth in each."""

RIVAL_ANGLE = math.radians(6.0)
"""Radians from the best direction beyond which another one is a rival."""

MAX_RIVAL_SHARE = 0.8
"""Votes of the strongest rival over those of the best, up to which it is certain. Of 180 generated panoramas all ten
that were wrong by more than 1° had 0.86 or more."""

MIN_LINES = 8
"""Lines that have to agree at least."""

CAMERA_FROM_FACE = tuple(
    rotation_taking(np.array([0.0, 0.0, -1.0]), np.array(axis, float))
    for axis in ((0, 0, -1), (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
)
"""Rotations of the six tangent images, which look along −z of their own."""

Lines = Float[np.ndarray, "n 3"]
"""Normals of the planes of line segments, as long as the angle in radians that the segment spans."""


@dataclass(frozen=True)
class Vertical:
    """The zenith as lines tell it."""

    up: Float[np.ndarray, " 3"]  # unit vector in the frame of the lines
    std: float  # its standard deviation, radians
    is_certain: bool  # enough lines agree, and no other direction has nearly as many


def find_lines(grey: UInt8[np.ndarray, "height width"], usable: Bool[np.ndarray, "rows cols"] | None = None) -> Lines:
    """Line segments of a panorama whose middles lie where it is usable; None is everywhere.

    Source: Grompone von Gioi et al., LSD: a fast line segment detector with a false detection control, PAMI 2010.
    """
    detector = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD)
    found, middles = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for face, rotation in enumerate(CAMERA_FROM_FACE):
        table = face_table((grey.shape[0], grey.shape[1]), face)
        side = len(table.row)
        segments = detector.detect(table.bilinear(grey))[0]
        if segments is not None:
            ends = ((segments.reshape(-1, 2, 2) + 0.5) / side * 2.0 - 1.0) * FACE_TANGENT
            directions = np.stack([ends[..., 0], -ends[..., 1], -np.ones(ends.shape[:2])], axis=-1)
            directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
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
    plane = np.stack([x, y, -np.ones_like(x)], axis=-1)
    plane /= np.linalg.norm(plane, axis=-1, keepdims=True)
    return RemapTable.for_directions(plane @ CAMERA_FROM_FACE[face].T, size)


def find_vertical(lines: Lines, near: Float[np.ndarray, " 3"] = UP) -> Vertical:
    """The direction within :data:`MAX_TILT` of ``near`` that most line segments point at, by their lengths.

    ``near`` itself, and not certain, where there are too few.
    """
    length = np.linalg.norm(lines, axis=1)
    longest = np.argsort(-length, kind="stable")
    chosen = longest[np.abs(lines[longest] @ near) < math.sin(MAX_TILT) * length[longest]][:MAX_LINES]
    length, normal = length[chosen], lines[chosen] / length[chosen, None]
    if len(normal) < MIN_LINES:
        return Vertical(near, math.inf, is_certain=False)
    pairs = np.random.default_rng(0).choice(len(normal), (2, HYPOTHESES), p=length / length.sum())
    crossing = np.cross(normal[pairs[0]], normal[pairs[1]])
    sine = np.linalg.norm(crossing, axis=1)
    crossing = (crossing / np.maximum(sine, 1e-9)[:, None])[sine > math.sin(RIVAL_ANGLE)]
    crossing *= np.where(crossing @ near < 0, -1.0, 1.0)[:, None]
    hypotheses = np.concatenate([crossing[crossing @ near > math.cos(MAX_TILT)], near[None]])
    off = np.einsum("ni,hi->nh", normal, hypotheses) / math.sin(VOTE_WIDTH)
    votes = np.einsum("nh,n->h", np.maximum(1.0 - off**2, 0.0), length)
    best = hypotheses[int(np.argmax(votes))]
    rival = votes[hypotheses @ best < math.cos(RIVAL_ANGLE)].max(initial=0.0)
    up, std = _fitted(best, normal, length)
    count = int((np.abs(normal @ up) < FIT_WIDTH).sum())
    return Vertical(up, std, bool(rival <= MAX_RIVAL_SHARE * votes.max() and count >= MIN_LINES))


def _fitted(up: np.ndarray, normal: np.ndarray, length: np.ndarray) -> tuple[Float[np.ndarray, " 3"], float]:
    """The zenith by least squares, with the weights of Geman and McClure, and its standard deviation."""
    width = math.sin(VOTE_WIDTH)
    for _ in range(FIT_ROUNDS):
        robust = 1.0 / (1.0 + (normal @ up / width) ** 2) ** 2
        axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", length * robust, normal, normal))[1]
        up = axes[:, 0] * math.copysign(1.0, float(axes[:, 0] @ up))
        width = max(0.8 * width, math.sin(FIT_WIDTH))
    noise = math.sqrt(float(np.sum(robust * (normal @ up) ** 2) / np.sum(robust)))
    information = np.einsum("n,ni,nj->ij", robust, normal, normal)
    return up, noise / math.sqrt(max(float(np.linalg.eigvalsh(information)[1]), 1e-12))
