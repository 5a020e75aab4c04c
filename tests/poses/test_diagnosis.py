"""Every deliberate mistake is named, on matches and on pictures with exact truth; right poses are not accused."""

import numpy as np
import pytest
from registration_samples import MADE, PIXEL, matches_of, random_pose, street_matches, street_poses

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.poses.registration.conventions import combined_hypotheses, heading_angles, single_hypotheses
from omnisyn_cli.poses.registration.diagnosis import diagnose, diagnosis_sentences, diagnosis_values
from omnisyn_cli.poses.registration.features import Matches

every_mistake = pytest.mark.parametrize("name", MADE)


def headed_pair() -> tuple[Pose, Pose]:
    """As with GPS and a compass: level cameras, headings in all directions."""
    return (
        Pose(rotation_from_heading(np.radians(70.0)), np.array([3.0, 1.5, -2.0])),
        Pose(rotation_from_heading(np.radians(-25.0)), np.array([5.0, 1.9, -5.0])),
    )


@every_mistake
def test_a_mistake_in_matches_is_named(name):
    rng = np.random.default_rng(7)
    poses = random_pose(rng), random_pose(rng)
    matches = matches_of(rng, *poses, noise=0.2 * PIXEL, wrong=0.3)
    diagnosis = diagnose(*MADE[name](*poses), matches)
    assert diagnosis.verdict == "mistake"
    assert diagnosis.explanations[0].hypothesis.name == name
    assert diagnosis.explanations[0].fit.worst < np.radians(1.0)
    assert diagnosis.explanations[0].fit.in_front > 0.99


@every_mistake
def test_a_mistake_over_pictures_is_named(name):
    diagnosis = diagnose(*MADE[name](*street_poses()), street_matches())
    assert diagnosis.verdict == "mistake"
    assert name in {explanation.hypothesis.name for explanation in diagnosis.explanations}


@pytest.mark.parametrize(
    ("name", "change"),
    [("heading-reversed", lambda heading: -heading), ("radians-for-degrees", np.radians),
     ("position-half-turn", lambda heading: heading + np.pi),
     ("position-quarter-left", lambda heading: heading - np.pi / 2),
     ("position-quarter-right", lambda heading: heading + np.pi / 2)],
)  # fmt: skip
def test_a_mistake_in_headings_is_named(name, change):
    rng, poses = np.random.default_rng(8), headed_pair()
    matches = matches_of(rng, *poses, noise=0.2 * PIXEL, wrong=0.3)
    wrong = [Pose(rotation_from_heading(change(heading_angles(p.rotation)[0])), p.position) for p in poses]  # type: ignore[operator]
    diagnosis = diagnose(wrong[0], wrong[1], matches)
    assert name in {explanation.hypothesis.name for explanation in diagnosis.explanations}


@pytest.mark.parametrize("headings", [(70.0, -25.0), (0.0, 0.0)])
def test_rolls_of_the_other_sign_are_named_first(headings):
    """Also where nothing but the rolls is turned, which world-to-camera would explain as well."""
    rng, places = np.random.default_rng(8), ([3.0, 1.5, -2.0], [5.0, 1.9, -5.0])
    right, wrong = (
        [
            Pose(rotation_from_heading(*np.radians([heading, 0.0, sign * roll])), np.array(place))
            for heading, roll, place in zip(headings, (5.0, -5.0), places, strict=True)
        ]
        for sign in (1.0, -1.0)
    )
    diagnosis = diagnose(wrong[0], wrong[1], matches_of(rng, right[0], right[1], noise=0.2 * PIXEL, wrong=0.3))
    assert diagnosis.explanations[0].hypothesis.name == "roll-reversed"


@pytest.mark.parametrize("names", [("quaternion-order", "opencv-axes"), ("world-to-camera", "centre-at-edge")])
def test_two_mistakes_at_once_are_named(names):
    """They are made in the opposite order of the corrections."""
    rng = np.random.default_rng(9)
    poses = random_pose(rng), random_pose(rng)
    matches = matches_of(rng, *poses, noise=0.2 * PIXEL, wrong=0.3)
    diagnosis = diagnose(*MADE[names[0]](*MADE[names[1]](*poses)), matches)
    assert diagnosis.explanations[0].hypothesis.name == "+".join(names)


@pytest.mark.parametrize("seed", range(6))
def test_right_poses_are_not_accused_and_inaccurate_ones_are_no_mistake(seed):
    rng = np.random.default_rng(seed)
    first, second = random_pose(rng), random_pose(rng)
    matches = matches_of(rng, first, second, noise=0.2 * PIXEL, wrong=0.3)
    right = diagnose(first, second, matches)
    assert right.verdict == "fits"
    assert not right.is_refinable
    turn = rotation_from_rotation_vector(np.radians(3.0) * np.array([0.6, 0.0, 0.8]))
    near = diagnose(first, Pose(turn @ second.rotation, second.position), matches)
    assert (near.verdict, near.is_refinable) == ("close", True)
    assert near.given is not None
    assert near.given.rotation == pytest.approx(np.radians(3.0), abs=np.radians(0.2))


def test_arbitrary_poses_are_a_contradiction_without_an_excuse():
    rng = np.random.default_rng(3)
    matches = matches_of(rng, random_pose(rng), random_pose(rng), noise=0.2 * PIXEL)
    diagnosis = diagnose(random_pose(rng), random_pose(rng), matches)
    assert (diagnosis.verdict, diagnosis.explanations) == ("contradiction", ())
    assert "no common mistake explains it" in diagnosis_sentences(diagnosis)[0]


def test_without_matches_nothing_is_claimed():
    diagnosis = diagnose(Pose.identity(), Pose.identity(), Matches(np.zeros((0, 3)), np.zeros((0, 3)), PIXEL))
    assert (diagnosis.verdict, diagnosis.given, diagnosis.is_refinable) == ("unknown", None, False)
    assert "too few matches" in diagnosis_sentences(diagnosis)[0]
    assert diagnosis_values(diagnosis)["given"] is None


def test_equal_positions_in_the_file_are_a_contradiction_if_the_pictures_differ():
    rng = np.random.default_rng(4)
    first, second = random_pose(rng), random_pose(rng)
    matches = matches_of(rng, first, second, noise=0.2 * PIXEL)
    diagnosis = diagnose(first, Pose(second.rotation, first.position), matches)
    assert diagnosis.verdict == "contradiction"
    sentences = " ".join(diagnosis_sentences(diagnosis))
    assert "the poses put both cameras in one place, the pictures do not" in sentences
    assert "give each panorama its own position" in sentences
    assert "direction of the second camera by" not in sentences
    assert "median residual" not in sentences


def test_one_place_is_said_and_its_rotations_are_judged():
    rng = np.random.default_rng(5)
    first = random_pose(rng)
    second = Pose(first.rotation @ rotation_from_heading(1.0), first.position)
    matches = matches_of(rng, first, second, noise=0.2 * PIXEL)
    assert diagnose(first, second, matches).verdict == "in place"
    swapped = diagnose(second, first, matches)
    assert swapped.verdict == "mistake"
    assert "images-swapped" in {explanation.hypothesis.name for explanation in swapped.explanations}


def test_names_and_words_are_complete():
    hypotheses = [*single_hypotheses(), *combined_hypotheses()]
    common = [hypothesis.name for hypothesis in single_hypotheses() if hypothesis.is_common]
    assert len(set(common)) == len(common)
    assert all(hypothesis.words and hypothesis.remedy for hypothesis in hypotheses)
    assert {*MADE} <= {*(hypothesis.name for hypothesis in hypotheses), "degrees-for-radians"}


def test_headings_come_back():
    for angles in ((0.3, 0.2, -0.1), (-3.0, -1.2, 2.0), (1.0, 0.0, 0.0)):
        np.testing.assert_allclose(heading_angles(rotation_from_heading(*angles)), angles, atol=1e-12)
