"""Which way is up in a single panorama: the zenith as straight lines tell it, and how the camera was held.

Straight lines of the world are great circles of the sphere. Those of vertical lines all pass through the zenith, so the
normals of their planes are horizontal. They tell the axis to a fraction of a degree, but not its end, and in rooms
other edges are as straight. Cameras are taken to be held upright within :data:`MAX_TILT`.

A network (:mod:`omnisyn_cli.networks.attitude`) tells which of six ways to hold the picture is likeliest.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import rotation_taking
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import rotated_image, sample_nearest
from omnisyn_cli.geometry.sphere import UP, normalize
from omnisyn_cli.poses.registration.features import Grey, Picture, Usable, grey_of
from omnisyn_cli.runtime.session import open_model, run_network

SMALL_SIZE = (256, 512)  # Of the picture in colour that floors are looked for in
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


# Axes of the camera near which the vertical is looked for: its own, to the right and ahead.
AXES = (UP, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
MIN_LOG_ODDS = 1.0  # against upright, from which on a picture is called otherwise
# Standard deviation up to which a zenith is certain: 2.5 of them are 1°.
MAX_STD = math.radians(0.4)
MIN_USABLE_SHARE = 0.75  # of the pixels; parts of the sphere lack the poles

# What to do about attitudes that are not upright.
REMEDIES = {
    "upside down": "if so, rotate the picture by 180°",
    "rolled by 90°": "if so, turn it upright (ffmpeg -vf v360=e:e:roll=90, or -90)",
}


@dataclass(frozen=True)
class Gravity:
    """How a camera was held."""

    vertical: Vertical  # the zenith in the camera's frame, by vertical edges
    attitude: str  # "upright", or a key of :data:`REMEDIES`

    @property
    def tilt(self) -> float:
        """Radians between the zenith and the camera's own."""
        return math.acos(max(-1.0, min(1.0, float(self.vertical.up @ UP))))


def gravity_of_picture(image: Picture, usable: Usable = None) -> Gravity:
    """:func:`gravity_of` of a panorama."""
    return gravity_of(resize_area(image, SMALL_SIZE), find_lines(grey_of(image), usable), usable)


def gravity_of(small: Picture, lines: Lines, usable: Usable = None) -> Gravity:
    """How the camera of a small picture with these lines was held: upright unless there is evidence against it."""
    found = [find_vertical(lines, axis) for axis in AXES]
    verticals = [replace(each, is_certain=each.is_certain and each.std <= MAX_STD) for each in found]
    if usable is not None and usable.mean() < MIN_USABLE_SHARE:
        return Gravity(verticals[0], "upright")
    ways = [replace(each, up=sign * each.up) for each in verticals for sign in (1.0, -1.0)]
    log_odds = [_log_odds(small, way.up) for way in ways]
    best = int(np.argmax(log_odds))
    if best == 0 or log_odds[best] - log_odds[0] < MIN_LOG_ODDS:
        return Gravity(ways[0], "upright")
    return Gravity(replace(ways[best], is_certain=False), "upside down" if best == 1 else "rolled by 90°")


def _log_odds(small: Picture, up: np.ndarray) -> float:
    """Of a picture with this zenith; only differences between zeniths mean something."""
    network = _network()
    image = rotated_image(small, rotation_taking(up, UP), np.eye(3), tuple(network.get_inputs()[0].shape[2:]))
    pixels = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32)
    return float(run_network(network, {"image": pixels}, [(1, 1, 1, 1)])[0].item())


@lru_cache(maxsize=1)
def _network() -> Any:
    return open_model("attitude", device="cpu", threads=1)
