"""What the silhouette network is told, and what is made of its answers; functions stand in for the network."""

import cv2
import numpy as np
import pytest

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.stereo.silhouettes import (
    AROUND,
    COLOURED,
    DIFFERENCES,
    EAST_PLANE,
    silhouette_planes,
    with_silhouettes,
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
    rolled = silhouette_planes(
        (View(image, Pose(view.pose.rotation @ heading, view.pose.position)), other), (DepthEstimate(*depth), theirs)
    )
    plain = np.roll(silhouette_planes((view, other), (own, theirs)), columns, axis=2)
    assert (np.abs(plain - rolled) > 1e-3).mean() < 0.01  # nearest neighbours at exact halves


def test_in_a_mirror_all_planes_are_mirrored_and_one_changes_its_sign(pair):
    views, estimates = pair
    flip = np.diag([-1.0, 1.0, 1.0])
    mirrored = silhouette_planes(
        tuple(
            View(v.image[:, ::-1].copy(), Pose(flip @ v.pose.rotation @ flip, flip @ v.pose.position)) for v in views
        ),
        tuple(DepthEstimate(e.inverse_depth[:, ::-1].copy(), e.confidence[:, ::-1].copy()) for e in estimates),
    )
    expected = silhouette_planes(views, estimates)[..., ::-1].copy()
    expected[EAST_PLANE] *= -1.0
    off = np.abs(expected - mirrored) > 1e-3
    assert off.mean() < 0.01  # nearest neighbours at exact halves
    assert np.abs(expected[EAST_PLANE]).max() > 0.5
    for first in COLOURED:
        assert np.abs(expected - mirrored)[first : first + 3].max() < 1e-3


def test_the_surfaces_around_span_what_the_neighbourhood_holds(pair):
    planes = silhouette_planes(*pair)
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
    planes, exact = silhouette_planes(views, grown), silhouette_planes(views, estimates)
    is_visible = exact[DIFFERENCES][0] < 0.05
    is_grown = planes[ROOT] > exact[ROOT] + 0.05
    own, _, behind = planes[DIFFERENCES]
    ring = is_visible & is_grown
    assert ring.sum() > 50
    assert behind[ring].mean() < 0.8 * own[ring].mean()


def test_a_network_that_keeps_everything_changes_no_depth_and_says_how_sure_that_is(pair):
    """Where there was no confidence, as under a mask, there is none after it."""
    views, (own, theirs) = pair
    half = np.where(np.arange(SIZE[1]) < SIZE[1] // 2, own.confidence, 0.0).astype(np.float32)
    before = (DepthEstimate(own.inverse_depth, half), theirs)
    after = with_silhouettes(*views, before, lambda planes: (np.square(planes[ROOT]), np.full(SIZE, 0.2, np.float32)))
    for one, same in zip(before, after, strict=True):
        np.testing.assert_array_equal(one.inverse_depth, same.inverse_depth)
    confidence = after[0].confidence
    assert np.all(confidence[:, SIZE[1] // 2 :] == 0.0)
    assert confidence.max() <= np.float32(0.2)
    assert np.median(confidence[:, : SIZE[1] // 2]) == np.float32(0.2)


def test_what_the_network_chooses_is_the_depth_in_metres(pair):
    views, (own, theirs) = pair

    def behind(planes):
        return np.square(planes[ROOT] - planes[FARTHER]), np.full(SIZE, 0.2, np.float32)

    first, _ = with_silhouettes(*views, (own, theirs), behind)
    farthest = cv2.erode(own.inverse_depth, np.ones((AROUND, AROUND), np.uint8))
    inside = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(first.inverse_depth[inside], farthest[inside], rtol=1e-4)


def test_what_is_believed_stays(pair):
    views, (own, theirs) = pair
    left = np.arange(SIZE[1]) < SIZE[1] // 2
    mixed = DepthEstimate(own.inverse_depth, np.where(left, np.float32(0.4), own.confidence))
    first, _ = with_silhouettes(*views, (mixed, theirs), lambda planes: (planes[ROOT] * 0.0, np.ones(SIZE, np.float32)))
    np.testing.assert_array_equal(first.inverse_depth[:, left], own.inverse_depth[:, left])
    assert np.all(first.inverse_depth[:, ~left] == 0.0)


def test_pictures_of_fewer_rows_than_the_estimate_move_nothing(pair):
    views, estimates = pair
    small = [View(cv2.resize(view.image, (SIZE[1] // 2, SIZE[0] // 2)), view.pose) for view in views]
    after = with_silhouettes(*small, estimates, lambda planes: (planes[ROOT] * 0.0, np.full(SIZE, 0.2, np.float32)))
    for one, same in zip(estimates, after, strict=True):
        np.testing.assert_array_equal(one.inverse_depth, same.inverse_depth)
        assert same.confidence.max() == np.float32(0.2)


def test_elevation_and_the_way_to_the_other_camera_are_told(pair):
    views, estimates = pair
    planes = silhouette_planes(views, estimates)
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
        gap = silhouette_planes(views, (own, moved))[23]
        assert (sign * gap > 0.0).mean() > 0.9
