"""Scale, shift and reading of monocular networks: found again whatever they are, and refused where nothing confirms."""

import numpy as np
import pytest
from tests.stereo.test_depth_prior import (
    POSITIONS,
    SIZE,
    distance_to_wall,
    photograph,
    room_views,
    true_disparity,
    turn,
    with_places_as_descriptors,
)

from omnisyn_cli.geometry.perspective import cell_directions
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.stereo.disparity import DisparityMap
from omnisyn_cli.stereo.monocular_answer import (
    READINGS,
    MonocularAnswer,
    MonocularModel,
    perspective_size,
    picture_rotations,
)  # fmt: skip
from omnisyn_cli.stereo.monocular_prior import ALIGNMENT_SIZE, align, with_monocular_priors
from omnisyn_cli.stereo.rectify import rectify
from omnisyn_cli.types import View

DIRECTIONS = pixel_directions(*ALIGNMENT_SIZE)
PANORAMA, PERSPECTIVE = (64, 128), (48, 48)
UNSEEN = View(np.zeros((2, 4, 3), np.float32), Pose(np.eye(3), POSITIONS[0]))  # Its picture is not looked at.


def log_inverse(rays: np.ndarray, position: np.ndarray = POSITIONS[0]) -> np.ndarray:
    return -np.log(distance_to_wall(position, rays)[0])


class DistortedRoom:
    """A network that knows the room of :mod:`tests.stereo.test_depth_prior`, up to scales and shifts."""

    def __init__(self, reading: str, scale: float, shift: float, *, is_perspective: bool, seed: int = 0) -> None:
        self.reading, self.scale, self.shift, self.is_perspective = reading, scale, shift, is_perspective
        self.generator = np.random.default_rng(seed)

    def __call__(self, view: View) -> MonocularAnswer:
        if not self.is_perspective:
            numbers = READINGS[self.reading].of_log(log_inverse(pixel_directions(*PANORAMA), view.pose.position))
            return MonocularAnswer(self.distorted(numbers, 1.0)[None], np.eye(3)[None])
        size = perspective_size(PERSPECTIVE)
        rays = cell_directions(size, PERSPECTIVE)
        lengths, maps = np.linalg.norm(rays, axis=-1), []
        for rotation in picture_rotations():
            logs = log_inverse((rays / lengths[..., None]) @ rotation.T, view.pose.position) + np.log(lengths)
            own = np.exp(self.generator.uniform(-0.5, 0.5))
            maps.append(self.distorted(READINGS[self.reading].of_log(logs), own))
        return MonocularAnswer(np.stack(maps), picture_rotations(), half_extent=size.half_extent, is_distance=False)

    def distorted(self, numbers: np.ndarray, own: float) -> np.ndarray:
        return (self.scale * own * numbers + self.shift * np.median(np.abs(numbers))).astype(np.float32)


def matches_of(seed: int, false_share: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Noisy logarithms of inverse depth, in part all too near as on tiles, and the two fifths that are known."""
    generator = np.random.default_rng(seed)
    measured = log_inverse(DIRECTIONS) + generator.normal(0.0, 0.02, ALIGNMENT_SIZE)
    measured += np.where(generator.random(ALIGNMENT_SIZE) < false_share, 0.6, 0.0)
    return measured, generator.random(ALIGNMENT_SIZE) < 0.4


@pytest.mark.parametrize("is_perspective", [False, True], ids=["panorama", "perspective"])
@pytest.mark.parametrize(("scale", "shift"), [(0.2, 0.2), (1.0, -0.2), (5.0, 0.1)])
@pytest.mark.parametrize("reading", READINGS)
def test_scale_shift_and_reading_are_found_again(reading, scale, shift, is_perspective) -> None:
    """Within 3 %, though three tenths of the matches are wrong in the same way."""
    answer = DistortedRoom(reading, scale, shift, is_perspective=is_perspective)(UNSEEN)
    alignment = align(answer, *matches_of(seed=3))
    assert alignment.reading == READINGS[reading]
    error = alignment.log_inverse_depth(answer.at(DIRECTIONS)) - log_inverse(DIRECTIONS)
    assert np.median(np.abs(error)) < 0.03
    assert alignment.confirming_share == pytest.approx(0.7, abs=0.06)


def test_perspective_pictures_see_everything_and_join_without_steps() -> None:
    """Between neighbouring directions the joined map changes as the true one does, at the seam and the poles too."""
    answer = DistortedRoom("inverse-depth", 2.0, 0.1, is_perspective=True)(UNSEEN)
    directions = pixel_directions(128, 256)
    assert answer.at(directions).weight.sum(axis=0).min() > 0.01
    alignment = align(answer, *matches_of(seed=5, false_share=0.0))
    error = alignment.log_inverse_depth(answer.at(directions)) - log_inverse(directions)
    for axis in (0, 1):
        assert np.quantile(np.abs(error - np.roll(error, 1, axis))[1:], 0.99) < 0.02


@pytest.mark.parametrize("is_perspective", [False, True], ids=["panorama", "perspective"])
def test_a_prior_is_where_the_room_is_in_both_panoramas(is_perspective: bool) -> None:
    """Whatever the cameras' orientation: the truth costs nothing, half of it costs something."""
    views = room_views()
    pair = rectify(*views, SIZE)
    known = np.random.default_rng(0).random(SIZE) < 0.3
    found = [
        DisparityMap(true_disparity(each, at), known)
        for each, at in zip((pair, pair.reversed()), POSITIONS, strict=True)
    ]
    model = DistortedRoom("inverse-depth", 1.7, 0.1, is_perspective=is_perspective)
    expecting = with_monocular_priors(pair, *views, (found[0], found[1]), model=model)
    for each, truth in zip((expecting, expecting.reversed()), found, strict=True):
        assert np.quantile(each.prior.cost(truth.disparity), 0.9) == 0.0
        assert np.median(each.prior.cost(0.5 * truth.disparity)) > 0.2


def test_what_no_match_confirms_is_not_used() -> None:
    """Noise, a smooth guess of another room, and any answer where hardly anything was matched."""
    views = photograph(POSITIONS[0], np.eye(3)), photograph(POSITIONS[1], np.eye(3))
    pair = rectify(*views, SIZE)
    truth = [true_disparity(each, at) for each, at in zip((pair, pair.reversed()), POSITIONS, strict=True)]
    noise = np.random.default_rng(1).lognormal(0.0, 1.0, (1, *PANORAMA)).astype(np.float32)

    def expecting(model, share: float):
        known = np.random.default_rng(0).random(SIZE) < share
        found = DisparityMap(truth[0], known), DisparityMap(truth[1], known)
        return with_monocular_priors(pair, *views, found, model=model)

    assert expecting(lambda view: MonocularAnswer(noise, np.eye(3)[None]), 0.3) is pair
    room = DistortedRoom("depth", 1.0, 0.0, is_perspective=False)
    assert expecting(room, 0.001) is pair
    assert expecting(room, 0.3) is not pair


@pytest.mark.parametrize("reading", READINGS)
def test_descriptors_find_scale_and_reading_where_most_matches_are_wrong(reading: str) -> None:
    views = room_views()
    pair = with_places_as_descriptors(rectify(*views, SIZE))
    known, elsewhere = np.random.default_rng(2).random((2, *SIZE))
    found = [
        DisparityMap(np.where(elsewhere < 0.8, 80.0 * elsewhere, true_disparity(each, at)), known < 0.3)
        for each, at in zip((pair, pair.reversed()), POSITIONS, strict=True)
    ]
    model = DistortedRoom(reading, 0.3 if READINGS[reading].power else 1.0, 0.0, is_perspective=False)
    expecting = with_monocular_priors(pair, *views, (found[0], found[1]), model=model)
    for each, at in zip((expecting, expecting.reversed()), POSITIONS, strict=True):
        assert np.quantile(each.prior.cost(true_disparity(each, at)), 0.9) == 0.0


def test_a_network_sees_upright_pictures() -> None:
    """The sky is up in what a tilted camera shows, in panoramas and in the pictures that look along the horizon."""
    rotation = turn(np.array([0.0, 0.0, 1.0]), 90.0)
    is_up = (pixel_directions(*SIZE) @ rotation.T)[..., 1] > 0
    image = np.repeat(is_up[..., None], 3, axis=-1).astype(np.float32)
    view = View(image, Pose(rotation, np.zeros(3)))

    class Sees:
        def __init__(self, size: tuple[int, int], is_panoramic: bool) -> None:
            self.size, self.is_panoramic, self.pictures = size, is_panoramic, []

        def __call__(self, picture: np.ndarray):
            self.pictures.append(picture)
            return picture[0], ("depth",), False

    for network, horizon in ((Sees((64, 128), True), 1), (Sees((40, 56), False), 6)):
        MonocularModel(network)(view)
        for picture in network.pictures[:horizon]:
            assert picture.shape == (3, *network.size)
            assert picture[:, : network.size[0] // 2 - 2].min() > 0.9
            assert picture[:, network.size[0] // 2 + 2 :].max() < 0.1
    assert len(network.pictures) == len(picture_rotations())
