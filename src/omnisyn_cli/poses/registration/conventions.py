"""Convention hypotheses: what commonly goes wrong when poses are written down, each with the correction that undoes it.

A correction takes both camera-to-world poses as they were given to what they were meant to be. Hypotheses are tried
alone and then in pairs, in the order of their stages: numbers are read before transforms are inverted, axes come last.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np

from omnisyn_cli.geometry import pose as geometry
from omnisyn_cli.geometry.pose import Pose

# Stages in which corrections are applied: numbers, then transforms, then axes, then the pair.
NUMBER_STAGE, TRANSFORM_STAGE, AXES_STAGE, PAIR_STAGE = range(4)
# This program's camera axes in those of OpenCV (x right, y down, z forward), and back.
OPENCV_AXES = np.diag([1.0, -1.0, -1.0])

Z_UP_AXES, HALF_TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.diag([-1.0, 1.0, -1.0])

SIGNED_PERMUTATIONS = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]

# Full turns (2π) in 180 radians, rounded up: what an angle in degrees loses when it is read as radians.
MAX_LOST_TURNS = 29
MIN_ANGLE = 1e-9  # Radians; smaller rotations have no axis


@dataclass(frozen=True)
class ConventionHypothesis:
    """A way of writing poses down wrongly."""

    name: str  # short and fixed, for programs
    stage: int  # at which it is undone
    words: str  # what was done, for people; goes on from "it looks as if"
    remedy: str  # what to do about it
    correct: Callable[[Pose, Pose], tuple[Pose, Pose]]  # undoes it
    is_common: bool = True  # listed where several hypotheses explain the same; the others only where nothing else does


def single_hypotheses() -> tuple[ConventionHypothesis, ...]:
    """One thing gone wrong in each, the most common ones first."""
    words = "the axes of the positions are not those of the rotations"
    return (
        *_common(),
        *(_other_camera_axes(matrix) for matrix in SIGNED_PERMUTATIONS if np.linalg.det(matrix) > 0),
        *(_one_half_turn(index, word) for index, word in enumerate(("first", "second"))),
        *(_position_axes("position-axes", _written(m), words, is_common=False) for m in SIGNED_PERMUTATIONS),
    )


def combined_hypotheses() -> Iterator[ConventionHypothesis]:
    """Pairs of common ones that belong to different stages."""
    common = [hypothesis for hypothesis in single_hypotheses() if hypothesis.is_common]
    for first, second in product(common, common):
        if first.stage < second.stage:
            yield ConventionHypothesis(
                f"{first.name}+{second.name}", second.stage,
                f"{first.words}, and {second.words}", f"{first.remedy}; then {second.remedy}",
                lambda a, b, earlier=first.correct, later=second.correct: later(*earlier(a, b)),  # type: ignore[misc]
            )  # fmt: skip


def degree_hypotheses(first: Pose, second: Pose, found: Pose, limit: float) -> Iterator[ConventionHypothesis]:
    """Rotation angles in degrees that were taken for radians: one candidate for each number of lost full turns.

    There are thousands; only those are given whose relative rotation is within ``limit`` radians of ``found``.
    """
    firsts, seconds = _angles_in_degrees(first.rotation), _angles_in_degrees(second.rotation)
    relative = np.swapaxes(firsts, 1, 2)[:, None] @ seconds[None]
    for i, k in np.argwhere(geometry.rotation_angle(found.rotation.T @ relative) <= limit):
        yield ConventionHypothesis(
            "degrees-for-radians", NUMBER_STAGE,
            "rotation angles in degrees were taken for radians",
            "convert angles to radians before making quaternions or matrices of them",
            lambda a, b, r=firsts[i], s=seconds[k]: (Pose(r, a.position), Pose(s, b.position)),  # type: ignore[misc]
        )  # fmt: skip


def heading_angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """Heading (−π to π), pitch and roll in radians; the inverse of :func:`.rotation_from_heading`."""
    heading, pitch, roll = geometry.heading_from_rotation(rotation)
    return math.remainder(heading, math.tau), pitch, roll


def _common() -> tuple[ConventionHypothesis, ...]:
    return (
        _each("roll-reversed", NUMBER_STAGE,
              "a positive roll turns the horizon clockwise instead of counter-clockwise",
              "change the sign of every roll; `omnisyn poses import` does with --roll clockwise",
              _angles(lambda angles: np.multiply((1, 1, -1), angles))),
        _each("world-to-camera", TRANSFORM_STAGE,
              "the poses are world-to-camera transforms, given as camera-to-world ones",
              "invert every transform: rotation Rᵀ, position −Rᵀ·t",
              Pose.inverse),
        _each("opencv-extrinsics", TRANSFORM_STAGE,
              "the poses are world-to-camera transforms with OpenCV's axes as COLMAP writes them",
              "convert them, for example with `omnisyn poses import --format colmap`",
              lambda pose: Pose(pose.rotation.T @ OPENCV_AXES, pose.inverse().position)),
        _each("rotation-transposed", TRANSFORM_STAGE,
              "the rotations are world-to-camera (transposed, or conjugated quaternions), the positions right",
              "transpose every rotation matrix, or negate x, y, z of every quaternion",
              lambda pose: Pose(pose.rotation.T, pose.position)),
        _each("translation-for-position", TRANSFORM_STAGE,
              "the positions are translations t of world-to-camera transforms instead of camera centres",
              "write −R·t with the camera-to-world rotation R as position",
              lambda pose: Pose(pose.rotation, -pose.rotation @ pose.position)),
        ConventionHypothesis(
              "images-swapped", PAIR_STAGE,
              "the two images are swapped: each has the pose of the other",
              "exchange the two names in the pose file",
              lambda first, second: (second, first)),
        _each("opencv-axes", AXES_STAGE,
              "the rotations are for camera axes x right, y down, z forward (OpenCV, COLMAP)",
              "multiply every rotation by diag(1, −1, −1) from the right",
              _turned(OPENCV_AXES)),
        _each("centre-at-edge", AXES_STAGE,
              "the rotations are for images whose centre is at the left and right edge (turned by 180° of yaw)",
              "roll the images by half their width, or turn every rotation by 180° about its y axis",
              _turned(HALF_TURN)),
        _each("z-up-camera", AXES_STAGE,
              "the rotations are for camera axes x right, y forward, z up: y and z are mixed up",
              "multiply every rotation by [[1, 0, 0], [0, 0, −1], [0, 1, 0]] from the right",
              _turned(Z_UP_AXES)),
        *(_mirror(*each) for each in (("x", (-1, 1, 1)), ("y", (1, -1, 1)), ("z", (1, 1, -1)))),
        _position_axes("position-yz-swapped", "x, z, y", "y and z of the positions are mixed up (height stands last)"),
        _position_axes("position-z-up", "x, z, −y", "the positions are z-up (x, −z, y), the rotations y-up"),
        *(_position_axes(f"position-{axis}-mirrored", "x, y, z".replace(axis, f"−{axis}"),
                         f"{axis} of the positions has the wrong sign") for axis in "xyz"),
        _position_axes("position-negated", "−x, −y, −z", "the positions are negated"),
        _position_axes("position-half-turn", "−x, y, −z", "headings and positions are 180° apart"),
        _position_axes("position-xz-swapped", "z, y, x", "x and z of the positions are mixed up"),
        _position_axes("position-quarter-left", "z, y, −x",
                       "headings and positions are 90° apart (as if headings counted from east)"),
        _position_axes("position-quarter-right", "−z, y, x",
                       "headings and positions are 90° apart (as if headings counted from west)"),
        _each("quaternion-order", NUMBER_STAGE,
              "the quaternions are [x, y, z, w] instead of [w, x, y, z]",
              "write w first",
              lambda pose: Pose(
                  geometry.rotation_from_quaternion(np.roll(geometry.quaternion_from_rotation(pose.rotation), 1)),
                  pose.position)),
        _each("radians-for-degrees", NUMBER_STAGE,
              "headings in radians were taken for degrees",
              "write heading, pitch and roll in degrees",
              _angles(np.degrees)),
        _each("heading-reversed", NUMBER_STAGE,
              "headings are counted counter-clockwise instead of clockwise",
              "change the sign of every heading (yaw)",
              _angles(lambda angles: np.multiply((-1, 1, 1), angles))),
    )  # fmt: skip


def _each(
    name: str, stage: int, words: str, remedy: str, correct: Callable[[Pose], Pose], is_common: bool = True
) -> ConventionHypothesis:
    """The same is undone in both poses."""
    return ConventionHypothesis(name, stage, words, remedy, lambda a, b: (correct(a), correct(b)), is_common)


def _mirror(axis: str, signs: tuple[int, int, int]) -> ConventionHypothesis:
    m = np.diag(np.array(signs, float))
    return _each(
        f"mirrored-{axis}", AXES_STAGE,
        f"the poses are from a left-handed frame, the {axis} axis mirrored (or the images are flipped)",
        f"with M = diag{signs} write M·R·M as rotation and M·p as position",
        lambda pose: Pose(m @ pose.rotation @ m, m @ pose.position),
    )  # fmt: skip


def _position_axes(name: str, axes: str, words: str, is_common: bool = True) -> ConventionHypothesis:
    matrix = next(matrix for matrix in SIGNED_PERMUTATIONS if _written(matrix) == axes)
    remedy = f"write ({axes}) as position instead of (x, y, z)"
    return _each(name, AXES_STAGE, words, remedy, lambda pose: Pose(pose.rotation, matrix @ pose.position), is_common)


def _other_camera_axes(matrix: np.ndarray) -> ConventionHypothesis:
    return _each(
        "camera-axes", AXES_STAGE,
        f"the rotations are for other camera axes: x, y, z of this program are {_written(matrix.T)} there",
        f"multiply every rotation by {matrix.astype(int).tolist()} from the right",
        _turned(matrix), is_common=False,
    )  # fmt: skip


def _one_half_turn(index: int, word: str) -> ConventionHypothesis:
    turned = _turned(HALF_TURN)
    return ConventionHypothesis(
        f"{word}-centre-at-edge", AXES_STAGE,
        f"the {word} image alone has its centre at the left and right edge (turned by 180° of yaw)",
        f"roll the {word} image by half its width, or turn its rotation by 180° about its y axis",
        lambda first, second: (first, turned(second)) if index else (turned(first), second), is_common=False,
    )  # fmt: skip


def _written(matrix: np.ndarray) -> str:
    """A signed permutation in letters, row by row: ``x, −z, y``."""
    return ", ".join(("−" if row.sum() < 0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in matrix)


def _angles(change: Callable[[Any], Any]) -> Callable[[Pose], Pose]:
    """Heading, pitch and roll are changed."""
    return lambda pose: Pose(geometry.rotation_from_heading(*change(heading_angles(pose.rotation))), pose.position)


def _turned(matrix: np.ndarray) -> Callable[[Pose], Pose]:
    """The camera's axes are others."""
    return lambda pose: Pose(pose.rotation @ matrix, pose.position)


def _angles_in_degrees(rotation: np.ndarray) -> np.ndarray:
    """Rotations ``(n, 3, 3)`` about the same axis by what the angle may have been before it was taken for radians."""
    vector = geometry.rotation_vector_from_rotation(rotation)
    angle = float(np.linalg.norm(vector))
    if angle < MIN_ANGLE:
        return rotation[None]
    degrees = angle + np.arange(-MAX_LOST_TURNS, MAX_LOST_TURNS + 1) * math.radians(360.0)
    degrees = degrees[np.abs(degrees) <= 180.0]
    return geometry.rotation_from_rotation_vector(np.radians(degrees)[:, None] * vector / angle)
