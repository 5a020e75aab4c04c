"""Pixels that fly, in a grey hall built by hand; and shards, in frames of a room of coloured rectangles."""

import cv2
import numpy as np
import pytest

from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.evaluation.metrics.artefacts import (
    COLOUR_TOLERANCE,
    MAX_ROWS,
    PhotographEdges,
    flying_pixels,
    flying_share,
    is_around,
    shard_share,
)
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions, solid_angles
from omnisyn_cli.types import DepthEstimate, View

SIZE = (128, 256)
RADIUS = 2.0
GREY, RED = np.full(3, 0.5), np.array([0.9, 0.1, 0.1])
HERE = Pose.identity()


def disc(direction: np.ndarray, degrees: float, size: tuple[int, int] = SIZE) -> np.ndarray:
    return pixel_directions(*size) @ (direction / np.linalg.norm(direction)) > np.cos(np.radians(degrees))


def view(position: tuple[float, float, float], mark: np.ndarray | None = None, heading: float = 0.0) -> View:
    """The hall from a place inside, with a red mark of 4° where the wall is in a direction of the frame."""
    pose = Pose(rotation_from_heading(heading), np.asarray(position, dtype=np.float64))
    rays = pixel_directions(*SIZE) @ pose.rotation.T
    along = rays @ pose.position
    distance = -along + np.sqrt(along**2 + RADIUS**2 - pose.position @ pose.position)
    image = np.broadcast_to(GREY, (*SIZE, 3)).copy()
    if mark is not None:
        place = RADIUS * mark / np.linalg.norm(mark) - pose.position
        image[disc(pose.rotation.T @ place, 4.0)] = RED
    return View(image, pose, None, DepthEstimate(1.0 / distance, np.ones(SIZE)))


def views(mark: np.ndarray | None = None) -> tuple[View, View]:
    return view((0.9, 0.0, 0.3), mark, heading=0.7), view((-0.9, 0.0, -0.3), mark, heading=-2.1)


def with_mark(direction: np.ndarray) -> np.ndarray:
    image = np.broadcast_to(GREY, (*SIZE, 3)).copy()
    image[disc(direction, 3.0)] = RED
    return image


TRUTH = np.broadcast_to(GREY, (*SIZE, 3))
AHEAD = np.array([0.2, 0.1, -1.0])


@pytest.mark.parametrize("reach", [1, 3])
def test_colours_are_found_within_the_square_and_not_beyond(reach):
    """As brute force finds them."""
    rng = np.random.default_rng(reach)
    wide = rng.random((20, 30, 3), np.float32)
    rows, cols = rng.integers(0, 20 - 2 * reach, 50), rng.integers(0, 30 - 2 * reach, 50)
    colours = rng.random((50, 3), np.float32)
    side = 2 * reach + 1
    near = np.stack([wide[r : r + side, c : c + side].reshape(-1, 3) for r, c in zip(rows, cols, strict=True)])
    expected = (np.abs(near - colours[:, None]) <= COLOUR_TOLERANCE).all(axis=-1).any(axis=-1)
    assert 0 < expected.sum() < 50
    np.testing.assert_array_equal(is_around(wide, reach, rows, cols, colours), expected)


def test_what_neither_photograph_shows_anywhere_flies():
    image = with_mark(AHEAD)
    np.testing.assert_array_equal(flying_pixels(image, TRUTH, HERE, views()), disc(AHEAD, 3.0))
    area = solid_angles(*SIZE)[disc(AHEAD, 3.0)].sum() / (4 * np.pi)
    assert flying_share(image, TRUTH, HERE, views()) == pytest.approx(area, rel=1e-3)


def test_what_a_photograph_shows_where_it_should_does_not_fly_though_it_is_wrong():
    """Parallax is followed: in the photographs the mark is up to 27° aside."""
    image = with_mark(AHEAD)
    near, other = views(AHEAD)
    rows, cols = direction_to_pixel(near.pose.rotation.T @ AHEAD, SIZE)
    assert (near.image[round(float(rows)), round(float(cols))] == GREY).all()
    assert not flying_pixels(image, TRUTH, HERE, (near, other)).any()
    assert not flying_pixels(image, TRUTH, HERE, (near, views()[1])).any()


def test_what_a_photograph_shows_elsewhere_flies():
    """30° from where the wall is shown there."""
    aside = np.array([0.9, 0.1, -1.0])
    assert flying_pixels(with_mark(AHEAD), TRUTH, HERE, views(aside)).sum() == disc(AHEAD, 3.0).sum()


def test_nothing_flies_that_is_near_the_truth():
    image = np.clip(TRUTH + np.random.default_rng(3).uniform(-29 / 255, 29 / 255, (*SIZE, 3)), 0, 1)
    assert not flying_pixels(image, TRUTH, HERE, views()).any()


def test_without_known_distances_a_photograph_may_show_all_from_infinity_to_a_metre():
    """The mark hangs 1.3 m before the frame; true depth says that the wall is at 2 m."""
    mark = 1.3 * AHEAD / np.linalg.norm(AHEAD)
    shown = []
    for plain in views():
        image = plain.image.copy()
        image[disc(plain.pose.rotation.T @ (mark - plain.pose.position), 4.0)] = RED
        shown.append(View(image, plain.pose, None, plain.known_depth))
    unknown = tuple(View(v.image, v.pose, None, DepthEstimate(np.ones(SIZE), np.zeros(SIZE))) for v in shown)
    assert flying_pixels(with_mark(AHEAD), TRUTH, HERE, (shown[0], shown[1])).any()
    assert not flying_pixels(with_mark(AHEAD), TRUTH, HERE, (unknown[0], unknown[1])).any()


def test_a_photograph_from_the_place_of_the_frame_shows_everything_where_it_is():
    assert not flying_pixels(with_mark(AHEAD), TRUTH, HERE, (view((0, 0, 0), AHEAD), views()[1])).any()
    assert flying_pixels(with_mark(AHEAD), TRUTH, HERE, (view((0, 0, 0)), views()[1])).any()


def test_photographs_may_be_larger_than_frames_and_their_true_depth_smaller():
    near, other = views(AHEAD)
    large = View(near.image.repeat(2, 0).repeat(2, 1), near.pose, None, near.known_depth)
    assert not flying_pixels(with_mark(AHEAD), TRUTH, HERE, (large, other)).any()


def test_views_without_depth_are_refused():
    blind = View(views()[0].image, HERE)
    with pytest.raises(ValueError, match="known depth"):
        flying_pixels(with_mark(AHEAD), TRUTH, HERE, (blind, blind))


ROOM_SIZE = (256, 512)


def turned(degrees: float) -> Pose:
    return Pose(rotation_from_heading(np.radians(degrees)), np.zeros(3))


def room(seed: int, size: tuple[int, int] = ROOM_SIZE) -> np.ndarray:
    """Rectangles of blue and grey shades."""
    rng = np.random.default_rng(seed)
    image = np.full((*ROOM_SIZE, 3), 0.5, np.float32)
    for _ in range(150):
        row, col = rng.integers(0, ROOM_SIZE[0]), rng.integers(0, ROOM_SIZE[1])
        shade = rng.random()
        image[row : row + 40, col : col + 40] = shade * np.array([0.6, 0.8, 1.0])
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_LINEAR)


def torn(image: np.ndarray, count: int) -> np.ndarray:
    """The picture with triangles of red and green."""
    rng = np.random.default_rng(9)
    image = image.copy()
    for number in range(count):
        corner = rng.integers((40, 60), (ROOM_SIZE[1] - 80, ROOM_SIZE[0] - 90))
        colour = ((0.9, 0.1, 0.1), (0.1, 0.9, 0.1))[number % 2]
        cv2.fillConvexPoly(image, corner + np.array([[0, 0], [36, 8], [10, 30]]), colour)
    return image


PHOTOGRAPHS = View(room(1), turned(0)), View(room(2), turned(40))
KNOWN = PhotographEdges(PHOTOGRAPHS, ROOM_SIZE)


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
    columns = round(degrees / 360 * ROOM_SIZE[1])
    rolled = [View(np.roll(view.image, columns, axis=1), view.pose) for view in PHOTOGRAPHS]
    frame = np.roll(torn(PHOTOGRAPHS[0].image, 12), columns, axis=1)
    assert shard_share(frame, turned(0), PhotographEdges(rolled, ROOM_SIZE)) == pytest.approx(expected, abs=0.01)
    world = turned(degrees)
    posed = [View(view.image, world @ view.pose) for view in PHOTOGRAPHS]
    share = shard_share(torn(PHOTOGRAPHS[0].image, 12), world, PhotographEdges(posed, ROOM_SIZE))
    assert share == pytest.approx(expected, abs=0.01)


def test_a_direction_far_from_the_photographs_is_another_place():
    """One blue bar: behind the camera it is a shard, 20° aside it is not."""
    bar = np.full((*ROOM_SIZE, 3), 0.5, np.float32)
    bar[100:150, 250:262] = (0.0, 0.0, 0.9)
    known = PhotographEdges([View(bar, turned(0))], ROOM_SIZE)
    assert shard_share(bar, turned(20), known) == 0.0
    assert shard_share(bar, turned(180), known) == 1.0


def test_without_edges_nothing_is_a_shard_and_beside_photographs_without_edges_everything_is():
    flat = np.full((*ROOM_SIZE, 3), 0.5, np.float32)
    blank = PhotographEdges([View(flat, turned(0))], ROOM_SIZE)
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
            shares.add(shard_share(frame, turned(0), PhotographEdges(PHOTOGRAPHS, ROOM_SIZE)))
    assert len(shares) == 1
