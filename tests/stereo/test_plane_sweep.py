"""Planes found by sweeping: where they are, when there are none, and what the second camera sees of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.stereo.plane_fitting import planes_from_second
from omnisyn_cli.stereo.plane_sweep import sweep_directions, sweep_planes
from omnisyn_cli.stereo.rectify import HALF_TURN_ABOUT_Z, rectify
from omnisyn_cli.types import View

SIZE = (256, 512)


def turn(axis: np.ndarray, degrees: float) -> np.ndarray:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.radians(degrees)
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def texture(points: np.ndarray, seed: int) -> np.ndarray:
    """Smooth noise over a plane, ``(..., 2)`` metres to ``(..., 3)`` in [0, 1]: waves of many lengths and headings."""
    rng = np.random.default_rng(seed)
    value = np.zeros((*points.shape[:-1], 3))
    for wavelength in np.geomspace(0.25, 4.0, 24):
        angle, phase = rng.uniform(0, 2 * math.pi), rng.uniform(0, 2 * math.pi, 3)
        way = points @ np.array([math.cos(angle), math.sin(angle)]) * (2 * math.pi / wavelength)
        value += np.sin(way[..., None] + phase)
    return np.clip(0.5 + 0.07 * value, 0.0, 1.0)


def photograph(position: np.ndarray, heading_deg: float, unit: np.ndarray, distance: float, seed: int = 3) -> View:
    """A view of an infinite textured plane ``unit · x = distance`` under an even sky."""
    rotation = turn(np.array([0.0, 1.0, 0.0]), heading_deg)
    rays = pixel_directions(*SIZE) @ rotation.T
    towards = rays @ unit
    reach = (distance - position @ unit) / np.where(towards > 1e-3, towards, np.inf)
    side = np.cross(unit, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    points = position + rays * reach[..., None]
    colours = texture(np.stack([points @ side, points @ np.cross(unit, side)], axis=-1), seed)
    fading = np.clip(reach / 40.0, 0.0, 1.0)[..., None]  # far waves are finer than pixels
    colours = (1.0 - fading) * colours + 0.5 * fading
    image = np.where((towards > 1e-3)[..., None], colours, 0.7)
    return View(image.astype(np.float32), Pose(rotation, position))


def pair_above(unit: np.ndarray, distance: float, baseline: float, heading_deg: float):
    """Rectified: two cameras a baseline apart, their images turned by other headings."""
    way = baseline * np.array([math.sin(math.radians(heading_deg)), 0.0, -math.cos(math.radians(heading_deg))])
    first = photograph(np.zeros(3), 40.0, unit, distance)
    return rectify(first, photograph(way, -75.0, unit, distance), SIZE)


@pytest.mark.parametrize("tilt_deg", [0.0, 1.0, 2.0, 4.0, 7.0, 10.0, 180.0], ids="{:.0f}".format)
@pytest.mark.parametrize("heading_deg", [0.0, 77.0, 200.0])
def test_a_textured_ground_that_is_nearly_level_is_found_whatever_the_heading(tilt_deg, heading_deg) -> None:
    """And a ceiling as a floor is."""
    unit = turn(np.array([1.0, 0.0, 0.0]), tilt_deg) @ np.array([0.0, -1.0, 0.0])
    pair = pair_above(unit, 1.6, 4.0, heading_deg)
    best = sweep_planes(sweep_directions(pair), pair.grid.up[None])[0]
    assert 4.0 / np.linalg.norm(best) == pytest.approx(1.6, rel=0.01)
    found = pair.world_from_frame @ best / np.linalg.norm(best)
    assert math.degrees(math.acos(min(1.0, found @ unit))) < 0.7


def test_planes_that_fitting_moves_onto_one_another_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    down = np.array([0.0, -1.0, 0.0])
    pair = pair_above(down, 1.6, 4.0, 10.0)
    directions, up = sweep_directions(pair), pair.grid.up
    found = [-up * 2.5 * factor for factor in (1.0, 1.03, 0.97)]
    monkeypatch.setattr("omnisyn_cli.stereo.plane_sweep._greedy_planes", lambda *_: found)
    (plane,) = sweep_planes(directions, up[None])
    assert 4.0 / np.linalg.norm(plane) == pytest.approx(1.6, rel=0.01)


def level_planes(first: View, second: View) -> np.ndarray:
    pair = rectify(first, second, (first.image.shape[0], first.image.shape[1]))
    return sweep_planes(sweep_directions(pair), pair.grid.up[None])


@pytest.mark.parametrize("seed", range(4))
def test_unrelated_pictures_have_no_plane_in_common(seed: int) -> None:
    down = np.array([0.0, -1.0, 0.0])
    first = photograph(np.zeros(3), 0.0, down, 1.6, seed=seed)
    second = photograph(np.array([0.0, 0.0, -4.0]), 0.0, down, 1.6, seed=seed + 100)
    assert level_planes(first, second).shape == (0, 3)


@pytest.mark.parametrize("height", [8, 64])
def test_pictures_without_texture_have_no_plane(height: int) -> None:
    grey = np.full((height, 2 * height, 3), 0.5, np.float32)
    views = [View(grey, Pose(np.eye(3), np.array([0.0, 0.0, -z]))) for z in (0.0, 2.0)]
    assert level_planes(*views).shape == (0, 3)


def test_masked_ground_is_not_swept() -> None:
    down = np.array([0.0, -1.0, 0.0])
    first, second = photograph(np.zeros(3), 0.0, down, 1.6), photograph(np.array([0.0, 0.0, -4.0]), 0.0, down, 1.6)
    masked = View(first.image, first.pose, mask=np.zeros(SIZE, bool))
    assert level_planes(masked, second).shape == (0, 3)


@given(st.floats(0.1, 5.0), st.floats(0.0, math.pi), st.floats(-math.pi, math.pi))
def test_the_second_camera_sees_the_same_points(distance: float, polar: float, azimuth: float) -> None:
    unit = np.array([math.sin(polar) * math.sin(azimuth), math.cos(polar), -math.sin(polar) * math.cos(azimuth)])
    normal = unit / distance
    seen = planes_from_second(normal[None])[0]
    if np.isnan(seen).any():
        assert distance - unit[1] <= 1e-3
        return
    point = unit * distance + np.cross(unit, [0.3, 0.2, 0.9])
    ray = HALF_TURN_ABOUT_Z @ (point - np.array([0.0, 1.0, 0.0]))
    assert seen @ ray == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(planes_from_second(seen[None])[0], normal, rtol=1e-5, atol=1e-6)


def test_a_plane_at_infinity_is_no_plane_for_the_second_camera() -> None:
    through_that_camera = [0.0, 1.0, 0.0]
    assert np.isnan(planes_from_second(np.array([np.zeros(3), through_that_camera]))).all()
