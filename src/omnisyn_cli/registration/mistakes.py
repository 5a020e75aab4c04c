"""What commonly goes wrong when poses are written down, each as the correction that would undo it.

A correction takes both camera-to-world poses as they were given to what they were meant to be. Corrections are tried
alone and then in pairs, in the order of their stages: numbers are read before transforms are inverted, axes come last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_angle
from omnisyn_cli.registration.misreadings import angles_in_degrees, angles_scaled, heading_reversed, scalar_first

__all__ = ["Mistake", "combined_mistakes", "degree_mistakes", "single_mistakes"]

OPENCV = np.diag([1.0, -1.0, -1.0])
"""This program's camera axes in those of OpenCV (x right, y down, z forward), and back."""

Correction = Callable[[Pose, Pose], tuple[Pose, Pose]]


@dataclass(frozen=True)
class Mistake:
    """A way of writing poses down wrongly.

    Attributes:
        name: short and fixed, for programs.
        words: what was done, for people; goes on from "it looks as if".
        remedy: what to do about it.
        correct: undoes it.
        stage: 0 numbers, 1 transforms, 2 axes, 3 the pair.
        is_common: listed where several mistakes explain the same; the others only where nothing else does.
    """

    name: str
    words: str
    remedy: str
    correct: Correction
    stage: int
    is_common: bool = True


def single_mistakes() -> tuple[Mistake, ...]:
    """One mistake each, the most common ones first."""
    return (*_transforms(), *_cameras(), *_mirrors(), *_positions(), *_numbers(), *_rare_cameras(), *_rare_positions())


def combined_mistakes() -> Iterator[Mistake]:
    """Pairs of the common mistakes that belong to different stages."""
    common = [mistake for mistake in single_mistakes() if mistake.is_common]
    for first, second in product(common, common):
        if first.stage < second.stage:
            yield Mistake(
                f"{first.name}+{second.name}",
                f"{first.words}, and {second.words}",
                f"{first.remedy}; then {second.remedy}",
                _after(first.correct, second.correct),
                stage=second.stage,
            )


def degree_mistakes(first: Pose, second: Pose, found: Pose, limit: float) -> Iterator[Mistake]:
    """Rotation angles in degrees that were taken for radians: one candidate for each number of lost full turns.

    There are thousands; only those are given whose relative rotation is within ``limit`` radians of ``found``.
    """
    firsts, seconds = angles_in_degrees(first.rotation), angles_in_degrees(second.rotation)
    relative = np.swapaxes(firsts, 1, 2)[:, None] @ seconds[None]
    for a, b in np.argwhere(rotation_angle(found.rotation.T @ relative) <= limit):
        yield Mistake(
            "degrees-for-radians",
            "rotation angles in degrees were taken for radians",
            "convert angles to radians before making quaternions or matrices of them",
            _replaced(firsts[a], seconds[b]),
            stage=0,
        )


def _transforms() -> Iterator[Mistake]:
    yield Mistake(
        "world-to-camera",
        "the poses are world-to-camera transforms, given as camera-to-world ones",
        "invert every transform: rotation Rᵀ, position −Rᵀ·t",
        _each(lambda pose: pose.inverse()),
        stage=1,
    )
    yield Mistake(
        "opencv-extrinsics",
        "the poses are world-to-camera transforms with OpenCV's axes as COLMAP writes them",
        "convert them, for example with `omnisyn poses import --format colmap`",
        _each(lambda pose: Pose(pose.rotation.T @ OPENCV, pose.inverse().position)),
        stage=1,
    )
    yield Mistake(
        "rotation-transposed",
        "the rotations are world-to-camera (transposed, or conjugated quaternions), the positions right",
        "transpose every rotation matrix, or negate x, y, z of every quaternion",
        _each(lambda pose: Pose(pose.rotation.T, pose.position)),
        stage=1,
    )
    yield Mistake(
        "translation-for-position",
        "the positions are translations t of world-to-camera transforms instead of camera centres",
        "write −R·t with the camera-to-world rotation R as position",
        _each(lambda pose: Pose(pose.rotation, -pose.rotation @ pose.position)),
        stage=1,
    )
    yield Mistake(
        "images-swapped",
        "the two images are swapped: each has the pose of the other",
        "exchange the two names in the pose file",
        lambda first, second: (second, first),
        stage=3,
    )


def _cameras() -> Iterator[Mistake]:
    yield Mistake(
        "opencv-axes",
        "the rotations are for camera axes x right, y down, z forward (OpenCV, COLMAP)",
        "multiply every rotation by diag(1, −1, −1) from the right",
        _camera_axes(OPENCV),
        stage=2,
    )
    yield Mistake(
        "centre-at-edge",
        "the rotations are for images whose centre is at the left and right edge (turned by 180° of yaw)",
        "roll the images by half their width, or turn every rotation by 180° about its y axis",
        _camera_axes(np.diag([-1.0, 1.0, -1.0])),
        stage=2,
    )
    yield Mistake(
        "z-up-camera",
        "the rotations are for camera axes x right, y forward, z up: y and z are mixed up",
        "multiply every rotation by [[1, 0, 0], [0, 0, −1], [0, 1, 0]] from the right",
        _camera_axes(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])),
        stage=2,
    )


def _mirrors() -> Iterator[Mistake]:
    for axis, signs in (("x", (-1, 1, 1)), ("y", (1, -1, 1)), ("z", (1, 1, -1))):
        mirror = np.diag(np.array(signs, float))
        yield Mistake(
            f"mirrored-{axis}",
            f"the poses are from a left-handed frame, the {axis} axis mirrored (or the images are flipped)",
            f"with M = diag{signs} write M·R·M as rotation and M·p as position",
            _each(lambda pose, m=mirror: Pose(m @ pose.rotation @ m, m @ pose.position)),  # type: ignore[misc]
            stage=2,
        )


def _positions() -> Iterator[Mistake]:
    named = {
        "position-yz-swapped": ((0, 2, 1), (1, 1, 1), "y and z of the positions are mixed up (height stands last)"),
        "position-z-up": ((0, 2, 1), (1, 1, -1), "the positions are z-up (x, −z, y), the rotations y-up"),
        "position-x-mirrored": ((0, 1, 2), (-1, 1, 1), "x of the positions has the wrong sign"),
        "position-y-mirrored": ((0, 1, 2), (1, -1, 1), "y of the positions has the wrong sign"),
        "position-z-mirrored": ((0, 1, 2), (1, 1, -1), "z of the positions has the wrong sign"),
        "position-negated": ((0, 1, 2), (-1, -1, -1), "the positions are negated"),
        "position-half-turn": ((0, 1, 2), (-1, 1, -1), "headings and positions are 180° apart"),
        "position-xz-swapped": ((2, 1, 0), (1, 1, 1), "x and z of the positions are mixed up"),
        "position-quarter-left": (
            (2, 1, 0),
            (1, 1, -1),
            "headings and positions are 90° apart (as if headings counted from east)",
        ),
        "position-quarter-right": (
            (2, 1, 0),
            (-1, 1, 1),
            "headings and positions are 90° apart (as if headings counted from west)",
        ),
    }
    for name, (order, signs, words) in named.items():
        yield _position_mistake(name, words, order, signs, is_common=True)


def _numbers() -> Iterator[Mistake]:
    yield Mistake(
        "quaternion-order",
        "the quaternions are [x, y, z, w] instead of [w, x, y, z]",
        "write w first",
        _each(lambda pose: Pose(scalar_first(pose.rotation), pose.position)),
        stage=0,
    )
    yield Mistake(
        "radians-for-degrees",
        "headings in radians were taken for degrees",
        "write heading, pitch and roll in degrees",
        _each(lambda pose: Pose(angles_scaled(pose.rotation), pose.position)),
        stage=0,
    )
    yield Mistake(
        "heading-reversed",
        "headings are counted counter-clockwise instead of clockwise",
        "change the sign of every heading (yaw)",
        _each(lambda pose: Pose(heading_reversed(pose.rotation), pose.position)),
        stage=0,
    )


def _rare_cameras() -> Iterator[Mistake]:
    for matrix in _signed_permutations(1):
        yield Mistake(
            "camera-axes",
            f"the rotations are for other camera axes: x, y, z of this program are {_axes(matrix)} there",
            f"multiply every rotation by {matrix.astype(int).tolist()} from the right",
            _camera_axes(matrix),
            stage=2,
            is_common=False,
        )
    for word, at in (("first", 0), ("second", 1)):
        yield Mistake(
            f"{word}-centre-at-edge",
            f"the {word} image alone has its centre at the left and right edge (turned by 180° of yaw)",
            f"roll the {word} image by half its width, or turn its rotation by 180° about its y axis",
            _turned_alone(at),
            stage=2,
            is_common=False,
        )


def _rare_positions() -> Iterator[Mistake]:
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            words = "the axes of the positions are not those of the rotations"
            yield _position_mistake("position-axes", words, order, signs, is_common=False)


def _position_mistake(
    name: str, words: str, order: tuple[int, ...], signs: tuple[int, ...], *, is_common: bool
) -> Mistake:
    matrix = np.eye(3)[list(order)] * np.array(signs, float)[:, None]
    written = ", ".join(("−" if sign < 0 else "") + "xyz"[axis] for axis, sign in zip(order, signs, strict=True))
    return Mistake(
        name,
        words,
        f"write ({written}) as position instead of (x, y, z)",
        _each(lambda pose: Pose(pose.rotation, matrix @ pose.position)),
        stage=2,
        is_common=is_common,
    )


def _signed_permutations(determinant: int) -> Iterator[np.ndarray]:
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if round(float(np.linalg.det(matrix))) == determinant:
                yield matrix


def _axes(matrix: np.ndarray) -> str:
    """The names, in the other camera's axes, of this program's x, y and z."""
    columns = (int(np.argmax(np.abs(column))) for column in matrix.T)
    return ", ".join(("−" if matrix[row, k] < 0 else "") + "xyz"[row] for k, row in enumerate(columns))


def _each(correct: Callable[[Pose], Pose]) -> Correction:
    return lambda first, second: (correct(first), correct(second))


def _after(earlier: Correction, later: Correction) -> Correction:
    return lambda first, second: later(*earlier(first, second))


def _camera_axes(other_from_camera: np.ndarray) -> Correction:
    return _each(lambda pose: Pose(pose.rotation @ other_from_camera, pose.position))


def _turned_alone(index: int) -> Correction:
    def correct(first: Pose, second: Pose) -> tuple[Pose, Pose]:
        poses = [first, second]
        poses[index] = Pose(poses[index].rotation @ np.diag([-1.0, 1.0, -1.0]), poses[index].position)
        return poses[0], poses[1]

    return correct


def _replaced(first_rotation: np.ndarray, second_rotation: np.ndarray) -> Correction:
    return lambda first, second: (Pose(first_rotation, first.position), Pose(second_rotation, second.position))
