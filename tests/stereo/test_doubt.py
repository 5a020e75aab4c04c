"""What the doubting network is told, and what is made of its answers; functions stand in for the network."""

import cv2
import numpy as np
import pytest

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.stereo.doubt import (
    AROUND,
    COLOURED,
    DIFFERENCES,
    EAST_PLANE,
    ROWS,
    doubt_planes,
    doubted,
    shrunk,
)
from omnisyn_cli.types import DepthEstimate, View

SIZE = (128, 256)
ROOT, NEARER, FARTHER = 3, 4, 5


@pytest.fixture(scope="module")
def pair():
    """Two views of a home, with their true depth."""
    scene = generate_scene("home", 5, None)
    path = sample_path(scene, 5, 3)
    views, estimates = [], []
    for pose in (path[0], path[-1]):
        image, depth = render_panorama(scene, pose, SIZE, supersample=2, threads=1)
        views.append(View(np.asarray(image, np.float32), pose))
        estimates.append(DepthEstimate((1.0 / depth).astype(np.float32), np.full(SIZE, 0.25, np.float32)))
    return tuple(views), tuple(estimates)


def test_nothing_knows_where_the_seam_is(pair):
    """A camera with another heading sees the same planes in other columns."""
    (view, other), (own, theirs) = pair
    columns = 37
    heading = rotation_from_heading(-2.0 * np.pi * columns / SIZE[1])
    image, *depth = (np.roll(x, columns, axis=1) for x in (view.image, own.inverse_depth, own.confidence))
    rolled = doubt_planes(
        (View(image, Pose(view.pose.rotation @ heading, view.pose.position)), other), (DepthEstimate(*depth), theirs)
    )
    plain = np.roll(doubt_planes((view, other), (own, theirs)), columns, axis=2)
    assert (np.abs(plain - rolled) > 1e-3).mean() < 0.01  # nearest neighbours at exact halves


def test_in_a_mirror_all_planes_are_mirrored_and_one_changes_its_sign(pair):
    views, estimates = pair
    flip = np.diag([-1.0, 1.0, 1.0])
    mirrored = doubt_planes(
        tuple(
            View(v.image[:, ::-1].copy(), Pose(flip @ v.pose.rotation @ flip, flip @ v.pose.position)) for v in views
        ),
        tuple(DepthEstimate(e.inverse_depth[:, ::-1].copy(), e.confidence[:, ::-1].copy()) for e in estimates),
    )
    expected = doubt_planes(views, estimates)[..., ::-1].copy()
    expected[EAST_PLANE] *= -1.0
    off = np.abs(expected - mirrored) > 1e-3
    assert off.mean() < 0.01  # nearest neighbours at exact halves
    assert np.abs(expected[EAST_PLANE]).max() > 0.5
    for first in COLOURED:
        assert np.abs(expected - mirrored)[first : first + 3].max() < 1e-3


def test_the_surfaces_around_span_what_the_neighbourhood_holds(pair):
    planes = doubt_planes(*pair)
    row, col, reach = 30, 2, AROUND // 2
    around = np.roll(planes[ROOT], reach - col, axis=1)[row - reach : row + reach + 1, :AROUND]
    np.testing.assert_allclose(planes[ROOT, row, col] + planes[NEARER, row, col], around.max(), rtol=1e-5)
    np.testing.assert_allclose(planes[ROOT, row, col] - planes[FARTHER, row, col], around.min(), rtol=1e-5)


def test_where_near_things_have_grown_the_other_picture_speaks_for_the_surface_behind(pair):
    """True depth grown by two pixels: of what is seen by both, colours fit better at the farthest surface around."""
    views, estimates = pair
    grown = tuple(
        DepthEstimate(cv2.dilate(e.inverse_depth, np.ones((7, 7), np.uint8)), e.confidence) for e in estimates
    )
    planes, exact = doubt_planes(views, grown), doubt_planes(views, estimates)
    is_visible = exact[DIFFERENCES][0] < 0.05
    is_grown = planes[ROOT] > exact[ROOT] + 0.05
    own, _, behind = planes[DIFFERENCES]
    ring = is_visible & is_grown
    assert ring.sum() > 50
    assert behind[ring].mean() < 0.8 * own[ring].mean()


def test_depth_stays_and_confidence_lies_between_what_it_was_and_what_is_told(pair):
    """Where there was no confidence, as under a mask, there is none after it."""
    views, (own, theirs) = pair
    half = np.where(np.arange(SIZE[1]) < SIZE[1] // 2, own.confidence, 0.0).astype(np.float32)
    before = (DepthEstimate(own.inverse_depth, half), theirs)

    after = doubted(*views, before, lambda planes: (0.1 + planes[ROOT]) / 4.0)
    for one, same in zip(before, after, strict=True):
        np.testing.assert_array_equal(one.inverse_depth, same.inverse_depth)
    told = (0.1 + doubt_planes(views, before)[ROOT]) / 4.0
    np.testing.assert_allclose(np.square(after[0].confidence), half * told, atol=1e-5)
    assert np.all(after[0].confidence[:, SIZE[1] // 2 :] == 0.0)
    assert np.all(after[1].confidence > 0.0)


def test_large_maps_are_looked_at_shrunk_and_believed_at_their_own_size(pair):
    """Depth of single pixels, mean confidence; the answer is carried over smoothly, over the seam too."""
    views, estimates = pair
    size = (2 * ROWS, 4 * ROWS)
    large = [
        DepthEstimate(*(np.kron(x, np.ones((4, 4), np.float32)) for x in (each.inverse_depth, each.confidence)))
        for each in estimates
    ]
    seen = []

    def network(planes):
        seen.append(planes)
        rows = np.linspace(0.2, 0.8, ROWS, dtype=np.float32)[:, None]
        return np.broadcast_to(rows, (ROWS, 2 * ROWS)).copy()

    after = doubted(*views, tuple(large), network)
    assert [planes.shape for planes in seen] == [(27, ROWS, 2 * ROWS)] * 2
    assert set(np.unique(shrunk(large[0]).inverse_depth)) <= set(np.unique(estimates[0].inverse_depth))
    assert shrunk(estimates[0]) is estimates[0]
    for one, same in zip(large, after, strict=True):
        assert same.confidence.shape == size
        np.testing.assert_array_equal(one.inverse_depth, same.inverse_depth)
        steps = np.diff(np.square(same.confidence[4:-4]) / one.confidence[4:-4], axis=0)
        assert steps.min() > 0.0
        assert steps.max() < 1.5 * (0.6 / size[0])


def test_elevation_and_the_way_to_the_other_camera_are_told(pair):
    views, estimates = pair
    planes = doubt_planes(views, estimates)
    towards = views[0].pose.rotation.T @ (views[1].pose.position - views[0].pose.position)
    towards /= np.linalg.norm(towards)
    directions = pixel_directions(*SIZE)
    np.testing.assert_allclose(planes[7], directions @ towards, atol=1e-6)
    np.testing.assert_allclose(planes[10], directions[..., 1], atol=1e-6)
    np.testing.assert_allclose(np.square(planes[7:10]).sum(axis=0), 1.0, atol=1e-5)
    north = -np.gradient(directions, axis=0) / (np.pi / SIZE[0])
    np.testing.assert_allclose(planes[9][1:-1], (north @ towards)[1:-1], atol=1e-3)
    east = np.gradient(directions, axis=1) / (2.0 * np.pi / SIZE[1])
    sine = np.sin(np.pi * (np.arange(SIZE[0]) + 0.5) / SIZE[0])[:, None]
    np.testing.assert_allclose((planes[8] * sine)[:, 1:-1], (east @ towards)[:, 1:-1], atol=1e-3)


def test_where_the_other_map_is_farther_its_gap_is_positive(pair):
    views, (own, theirs) = pair
    for factor, sign in ((0.25, 1.0), (4.0, -1.0)):
        moved = DepthEstimate(factor * theirs.inverse_depth, theirs.confidence)
        gap = doubt_planes(views, (own, moved))[23]
        assert (sign * gap > 0.0).mean() > 0.9
