"""Shards, in frames of a room of coloured rectangles: none in its photographs, all where torn triangles are pasted."""

import cv2
import numpy as np
import pytest

from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.evaluation.metrics.artefacts import MAX_ROWS, PhotographEdges, shard_share
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.types import View

SIZE = (256, 512)


def turned(degrees: float) -> Pose:
    return Pose(rotation_from_heading(np.radians(degrees)), np.zeros(3))


def room(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Rectangles of blue and grey shades."""
    rng = np.random.default_rng(seed)
    image = np.full((*SIZE, 3), 0.5, np.float32)
    for _ in range(150):
        row, col = rng.integers(0, SIZE[0]), rng.integers(0, SIZE[1])
        shade = rng.random()
        image[row : row + 40, col : col + 40] = shade * np.array([0.6, 0.8, 1.0])
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_LINEAR)


def torn(image: np.ndarray, count: int) -> np.ndarray:
    """The picture with triangles of red and green."""
    rng = np.random.default_rng(9)
    image = image.copy()
    for number in range(count):
        corner = rng.integers((40, 60), (SIZE[1] - 80, SIZE[0] - 90))
        colour = ((0.9, 0.1, 0.1), (0.1, 0.9, 0.1))[number % 2]
        cv2.fillConvexPoly(image, corner + np.array([[0, 0], [36, 8], [10, 30]]), colour)
    return image


PHOTOGRAPHS = View(room(1), turned(0)), View(room(2), turned(40))
KNOWN = PhotographEdges(PHOTOGRAPHS, SIZE)


@pytest.mark.parametrize("view", PHOTOGRAPHS)
def test_photographs_have_none(view):
    assert shard_share(view.image, view.pose, KNOWN) == 0.0


def test_torn_triangles_are_shards_and_the_more_the_more():
    shares = [shard_share(torn(PHOTOGRAPHS[0].image, count), turned(0), KNOWN) for count in (0, 4, 12, 40)]
    assert shares[0] == 0.0
    assert (np.diff(shares) > 0.02).all()


@pytest.mark.parametrize("degrees", [45.0, 180.0, -7.3])
def test_turning_everything_changes_nothing(degrees):
    """Photographs and the frame alike, by columns of pixels and by a pose."""
    expected = shard_share(torn(PHOTOGRAPHS[0].image, 12), turned(0), KNOWN)
    columns = round(degrees / 360 * SIZE[1])
    rolled = [View(np.roll(view.image, columns, axis=1), view.pose) for view in PHOTOGRAPHS]
    frame = np.roll(torn(PHOTOGRAPHS[0].image, 12), columns, axis=1)
    assert shard_share(frame, turned(0), PhotographEdges(rolled, SIZE)) == pytest.approx(expected, abs=0.01)
    world = turned(degrees)
    posed = [View(view.image, world @ view.pose) for view in PHOTOGRAPHS]
    share = shard_share(torn(PHOTOGRAPHS[0].image, 12), world, PhotographEdges(posed, SIZE))
    assert share == pytest.approx(expected, abs=0.01)


def test_a_direction_far_from_the_photographs_is_another_place():
    """One blue bar: behind the camera it is a shard, 20° aside it is not."""
    bar = np.full((*SIZE, 3), 0.5, np.float32)
    bar[100:150, 250:262] = (0.0, 0.0, 0.9)
    known = PhotographEdges([View(bar, turned(0))], SIZE)
    assert shard_share(bar, turned(20), known) == 0.0
    assert shard_share(bar, turned(180), known) == 1.0


def test_without_edges_nothing_is_a_shard_and_beside_photographs_without_edges_everything_is():
    flat = np.full((*SIZE, 3), 0.5, np.float32)
    blank = PhotographEdges([View(flat, turned(0))], SIZE)
    assert shard_share(flat, turned(0), KNOWN) == 0.0
    assert shard_share(flat, turned(0), blank) == 0.0
    assert shard_share(PHOTOGRAPHS[0].image, turned(0), blank) == 1.0


def test_sizes_and_threads_do_not_matter():
    """Photographs and frames may be larger than the edges are looked for at."""
    large = (2 * MAX_ROWS, 4 * MAX_ROWS)
    views = [View(room(seed, large), turned(0)) for seed in (1, 2)]
    known = PhotographEdges(views, large)
    assert known.size == (MAX_ROWS, 2 * MAX_ROWS)
    assert shard_share(views[0].image, turned(0), known) == 0.0
    frame = torn(PHOTOGRAPHS[0].image, 12)
    shares = set()
    for threads in (1, 2):
        with limited_threads(threads):
            shares.add(shard_share(frame, turned(0), PhotographEdges(PHOTOGRAPHS, SIZE)))
    assert len(shares) == 1
