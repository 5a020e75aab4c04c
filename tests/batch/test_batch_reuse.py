"""What a worker remembers is what it would find again, and never more than a few things."""

import os
import weakref

import numpy as np
from batch_samples import write_row

from omnisyn_cli.batch.interpolations import MAX_CACHED_PANORAMAS, DepthCache, PanoramaCache
from omnisyn_cli.fusion.photometry import darken_to_match, rough_exposure_curve
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.types import DepthEstimate, View


class Counting:
    """An estimator that says in its estimates which views it was asked about, and in which order."""

    def __init__(self) -> None:
        self.calls: list[tuple[float, float]] = []

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        self.calls.append((first.pose.position[0], second.pose.position[0]))
        return estimate(first), estimate(second)


def estimate(view: View) -> DepthEstimate:
    value = np.full((1, 1), view.image.sum() + 100 * view.pose.position[0])
    return DepthEstimate(value, np.ones((1, 1)))


def view(x: float, image: np.ndarray | None = None, mask: np.ndarray | None = None) -> View:
    return View(np.full((2, 4, 3), x) if image is None else image, Pose(np.eye(3), np.array([x, 0.0, 0.0])), mask)


def values(depths: tuple[DepthEstimate, DepthEstimate]) -> list[float]:
    return [float(depth.inverse_depth[0, 0]) for depth in depths]


def test_depth_of_both_directions_is_found_once_and_in_one_order():
    inner, a, b = Counting(), view(1.0), view(2.0)
    memory = DepthCache(inner)
    expected = [float(estimate(one).inverse_depth[0, 0]) for one in (a, b)]
    for _ in range(2):
        assert values(memory(b, a)) == expected[::-1]
        assert values(memory(a, b)) == expected
    assert inner.calls == [(1.0, 2.0)]
    assert memory.misses == 1


def test_another_picture_pose_or_mask_is_another_pair():
    inner, a, b = Counting(), view(1.0), view(2.0)
    memory = DepthCache(inner)
    mask = np.ones((2, 4), bool)
    others = [view(2.5, b.image), view(2.0, b.image + 0.1), view(2.0, b.image, mask), view(2.0, b.image, ~mask)]
    for other in (b, *others):
        assert values(memory(a, other)) == [float(estimate(one).inverse_depth[0, 0]) for one in (a, other)]
    assert memory.misses == len(inner.calls) == 5
    memory(a, view(2.0, b.image, np.zeros((2, 4), bool)))
    assert memory.misses == 5, "an equal mask is the same mask"
    memory(a, view(2.0, b.image.copy(), ~mask))
    assert memory.misses == 5, "an equal picture is the same picture"


def test_pictures_that_were_darkened_to_one_exposure_are_known_again_in_either_direction():
    """They are made anew for each job."""
    bright = np.random.default_rng(0).uniform(0.2, 0.8, (64, 128, 3)).astype(np.float32)
    memory, a, b = DepthCache(Counting()), view(1.0, bright), view(2.0, np.float32(0.7) * bright[:, ::-1])
    for pair in ((a, b), (b, a), (a, b)):
        darkened = darken_to_match(*pair, rough_exposure_curve(*pair))
        assert not any(one is other for one, other in zip(darkened, pair, strict=True) if other is a)
        memory(*darkened)
    assert memory.misses == 1


def test_depth_keeps_no_picture_alive():
    memory, image = DepthCache(Counting()), np.full((2, 4, 3), 2.0)
    memory(view(1.0), view(2.0, image))
    picture = weakref.ref(image)
    del image
    assert picture() is None


def test_a_panorama_is_decoded_once_until_its_file_changes(tmp_path):
    write_row(tmp_path, 2)
    memory, path = PanoramaCache(), tmp_path / "p0.png"
    first = memory(path)
    assert memory(path).original is first.original
    np.testing.assert_array_equal(first.image, read_panorama(path).image)
    memory(tmp_path / "p1.png")
    assert memory.misses == 2
    write_image(path, np.zeros((16, 32, 3), np.uint8))
    os.utime(path, ns=(1, 1))
    assert not memory(path).image.any()
    assert memory.misses == 3


def test_panoramas_are_remembered_as_the_samples_of_their_files(tmp_path):
    """And are the same numbers when they are made of these again."""
    write_row(tmp_path, 1)
    memory, path = PanoramaCache(), tmp_path / "p0.png"
    numbers = weakref.ref(memory(path).image)
    assert numbers() is None
    np.testing.assert_array_equal(memory(path).image, read_panorama(path).image)
    assert memory.misses == 1


def test_only_a_few_panoramas_are_remembered(tmp_path):
    write_row(tmp_path, MAX_CACHED_PANORAMAS + 1)
    memory = PanoramaCache()
    for index in range(MAX_CACHED_PANORAMAS + 1):
        memory(tmp_path / f"p{index}.png")
    assert len(memory._known) == MAX_CACHED_PANORAMAS
    memory(tmp_path / "p1.png")
    assert memory.misses == MAX_CACHED_PANORAMAS + 1
    memory(tmp_path / "p0.png")
    assert memory.misses == MAX_CACHED_PANORAMAS + 2
