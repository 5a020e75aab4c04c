"""Real and ray-traced pairs whose poses are known, where that data lies beside the checkout."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from registration_samples import MADE, unit

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.io import read_panorama
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.poses.registration.diagnosis import diagnose
from omnisyn_cli.poses.registration.features import Matches, find_features, match_features
from omnisyn_cli.poses.registration.least_squares import direction_error, relative_pose, rotation_error
from omnisyn_cli.poses.registration.robust import estimate_relative_pose

DATA = Path(__file__).parents[3] / "shared" / "data"
PHOTOGRAPHS = ("campus-pair", "vertical-hall", "vertical-room", "vertical-stairs")
RENDERED = ("carla-pair", "warehouse_0", "warehouse_1", "warehouse_2")

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the measured scenes in {DATA}")
every_pair = pytest.mark.parametrize("scene", PHOTOGRAPHS + RENDERED)

WORLD = Pose(rotation_from_rotation_vector(np.array([0.3, 1.1, -0.2])), np.array([4.0, 1.5, -7.0]))
"""Another world: the data has its first cameras at the origin, where many mistakes change nothing."""

FREQUENT = (
    "world-to-camera", "opencv-extrinsics", "images-swapped", "centre-at-edge", "mirrored-x", "position-yz-swapped",
    "quaternion-order", "degrees-for-radians",
)  # fmt: skip

NOMINAL = "vertical-stairs"
"""Its given pose, straight up without a turn, is less accurate than the estimate: its residual is five times larger."""


@lru_cache(maxsize=8)
def matched(scene: str) -> Matches:
    names = list(read_poses(DATA / scene / "poses.json").panoramas)
    pictures = (read_panorama(DATA / scene / name) for name in (names[0], names[-1]))
    return match_features(*(find_features(picture.image, picture.mask, threads=2) for picture in pictures))


def given(scene: str) -> tuple[Pose, Pose]:
    poses = [panorama.pose for panorama in read_poses(DATA / scene / "poses.json").panoramas.values()]
    return poses[0], poses[-1]


@every_pair
def test_estimated_poses_agree_with_the_given_ones(scene):
    estimate, truth = estimate_relative_pose(matched(scene)), relative_pose(*given(scene))
    assert estimate is not None
    assert np.degrees(rotation_error(estimate.first_from_second, truth)) < 1.0
    assert np.degrees(direction_error(estimate.first_from_second, truth)) < (3.5 if scene == NOMINAL else 2.0)
    assert np.degrees(estimate.residual) < 0.1


@every_pair
def test_three_degrees_are_brought_back(scene):
    matches, (first, second) = matched(scene), given(scene)
    rng, undisturbed = np.random.default_rng(1), estimate_relative_pose(matches)
    turn = rotation_from_rotation_vector(unit(rng.normal(size=3)) * np.radians(3.0))
    across = unit(np.cross(second.position - first.position, rng.normal(size=3)))
    retract = across * np.linalg.norm(second.position - first.position) * np.tan(np.radians(3.0))
    diagnosis = diagnose(first, Pose(turn @ second.rotation, second.position + retract), matches)
    assert undisturbed is not None
    assert (diagnosis.verdict, diagnosis.is_refinable) == ("close", True)
    assert diagnosis.estimate is not None
    refined = diagnosis.estimate.first_from_second
    assert np.degrees(rotation_error(refined, relative_pose(first, second))) < 0.3
    assert np.degrees(rotation_error(refined, undisturbed.first_from_second)) < 0.05
    assert np.degrees(direction_error(refined, undisturbed.first_from_second)) < 0.3


@pytest.mark.parametrize("name", FREQUENT)
@pytest.mark.parametrize("scene", ["campus-pair", "vertical-hall", "warehouse_1"])
def test_a_mistake_is_named(scene, name):
    """Unless it changes nothing: turning both images by 180° does not show where one stands above the other."""
    first, second = (WORLD @ pose for pose in given(scene))
    wrong, truth = MADE[name](first, second), relative_pose(first, second)
    diagnosis = diagnose(*wrong, matched(scene))
    changed = max(f(relative_pose(*wrong), truth) for f in (rotation_error, direction_error))
    if changed < np.radians(0.1):
        assert diagnosis.verdict == "fits"
        return
    assert diagnosis.verdict == "mistake"
    assert name in {explanation.hypothesis.name for explanation in diagnosis.explanations}


@every_pair
def test_given_poses_are_not_accused(scene):
    diagnosis = diagnose(*given(scene), matched(scene))
    assert diagnosis.verdict == ("close" if scene == NOMINAL else "fits")
    assert diagnosis.given.residual > (4 if scene == NOMINAL else 0) * diagnosis.estimate.residual
    assert diagnosis.is_refinable == (scene in PHOTOGRAPHS)
