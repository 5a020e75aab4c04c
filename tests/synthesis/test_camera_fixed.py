"""What moves with the camera is found in both panoramas of a pair, and nothing is in a pair without it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from omnisyn_cli.geometry.pose import rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.synthesis.camera_fixed import find_camera_fixed
from omnisyn_cli.synthesis.still_outlines import find_still_region
from omnisyn_cli.types import View

SIZE = (256, 512)
KINDS = ("white", "black", "logo", "blurred", "tripod", "operator")


@pytest.fixture(scope="module", params=["street", "room"])
def pair(request: pytest.FixtureRequest) -> tuple[View, View]:
    scene = generate_scene(request.param, 11)
    ends = sample_path(scene, 11, 2)
    first, second = (View(render_panorama(scene, pose, SIZE, supersample=2, threads=1)[0], pose) for pose in ends)
    return first, second


def shape(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Where something is painted, and its colours, in the frame of the camera."""
    directions = pixel_directions(*SIZE)
    angle = np.degrees(np.arccos(np.clip(-directions[..., 1], -1, 1)))
    scale = angle / np.maximum(np.hypot(directions[..., 0], directions[..., 2]), 1e-9)
    x, y = scale * directions[..., 0], scale * directions[..., 2]
    colour = np.full((*SIZE, 3), {"white": 0.97, "tripod": 0.1}.get(kind, 0.03), np.float32)
    if kind == "tripod":
        legs = [
            (np.abs(x * np.cos(turn) - y * np.sin(turn)) < 2.0) & (x * np.sin(turn) + y * np.cos(turn) > 0)
            for turn in (0.2, 2.3, 4.4)
        ]
        return (np.any(legs, axis=0) & (angle < 28.0)) | (angle < 5.0), colour
    if kind == "operator":
        shirt = np.hypot((x - 30.0) / 15.0, y / 11.0) < 1.0
        head = np.hypot(x - 46.0, y) < 6.0
        colour[shirt] = (0.1, 0.2, 0.7)
        colour[head] = (0.9, 0.7, 0.6)
        return shirt | head | (np.hypot((x - 14.0) / 6.0, (np.abs(y) - 4.0) / 2.5) < 1.0), colour
    if kind == "logo":
        colour[(np.abs(x) < 3.0) | (np.abs(y - 4.0) < 2.0)] = (0.9, 0.8, 0.1)
    return angle < 18.0, colour


def painted(view: View, kind: str) -> View:
    where, colour = shape(kind)
    image = view.image.copy()
    if kind == "blurred":
        colour = cv2.GaussianBlur(image, (0, 0), 8.0)
        colour[230:] = colour[230:].mean(axis=(0, 1))
    image[where] = colour[where]
    return replace(view, image=image)


@pytest.mark.parametrize("kind", KINDS)
def test_what_moves_with_the_camera_is_found(pair: tuple[View, View], kind: str) -> None:
    where, _ = shape(kind)
    found = find_camera_fixed(painted(pair[0], kind), painted(pair[1], kind))
    for mask in found:
        assert (mask & where).sum() > 0.7 * where.sum()
        assert not mask[: SIZE[0] // 2].any()


def test_a_pair_without_it_loses_nothing(pair: tuple[View, View]) -> None:
    assert find_camera_fixed(*pair) == (None, None)


def test_the_same_is_found_whichever_comes_first(pair: tuple[View, View]) -> None:
    first, second = (painted(view, "operator") for view in pair)
    there, back = find_camera_fixed(first, second), find_camera_fixed(second, first)
    for one, other in zip(there, back[::-1], strict=True):
        assert (one & other).sum() > 0.7 * (one | other).sum()


@pytest.mark.parametrize("kind", ["tripod", "operator"])
def test_where_the_seam_is_does_not_matter(pair: tuple[View, View], kind: str) -> None:
    views, quarter = [painted(view, kind) for view in pair], rotation_from_heading(np.pi / 2)
    rolled = [
        View(np.roll(view.image, SIZE[1] // 4, axis=1), replace(view.pose, rotation=view.pose.rotation @ quarter.T))
        for view in views
    ]
    for mask, turned in zip(find_camera_fixed(*views), find_camera_fixed(*rolled), strict=True):
        assert (np.roll(mask, SIZE[1] // 4, axis=1) != turned).sum() < 0.01 * mask.sum()


def test_a_striped_line_where_another_one_was_is_left(pair: tuple[View, View]) -> None:
    """Tape on the floor across the way: its pieces are alike, and two of them may lie the same way from the camera."""
    directions = pixel_directions(*SIZE)
    way = (pair[0].pose.rotation.T @ (pair[1].pose.position - pair[0].pose.position))[[0, 2]]
    ground = directions[..., [0, 2]] / np.maximum(-directions[..., 1:2], 1e-3)
    ahead, across = (ground @ axis / np.hypot(*way) for axis in (way, np.array([-way[1], way[0]])))
    tape = (np.abs(ahead - 0.3) < 0.05) & (np.abs(across) < 1.5) & (directions[..., 1] < -0.3)
    colour = np.where((np.floor((across + ahead) / 0.06) % 2 > 0)[..., None], (0.9, 0.8, 0.1), (0.05, 0.05, 0.05))
    views = [replace(view, image=np.where(tape[..., None], colour, view.image).astype(np.float32)) for view in pair]
    assert find_camera_fixed(*views) == (None, None)


@pytest.fixture(scope="module", params=["street", "home"])
def walk(request: pytest.FixtureRequest) -> list[View]:
    scene = generate_scene(request.param, 5)
    return [View(render_panorama(scene, pose, SIZE, supersample=2)[0], pose) for pose in sample_path(scene, 5, 5)]


@pytest.mark.parametrize("kind", ["white", "logo", "tripod", "operator"])
@pytest.mark.parametrize("count", [3, 5])
def test_an_outline_that_stays_in_a_tour_is_found(walk: list[View], kind: str, count: int) -> None:
    where, _ = shape(kind)
    lights = (0.3, 1.0, 0.6, 0.8, 0.4)[:count]
    views = [painted(view, kind) for view in walk[:count]]
    views = [replace(view, image=view.image * light) for view, light in zip(views, lights, strict=True)]
    still = find_still_region(views)
    assert still is not None
    found, _ = find_camera_fixed(*views[:2], still)
    assert (found & where).sum() > 0.9 * where.sum()
    assert (found & ~where)[SIZE[0] // 2 :].mean() < 0.08


def test_a_tour_without_it_loses_nothing_and_two_pictures_tell_nothing(walk: list[View]) -> None:
    assert find_still_region(walk) is None
    assert find_still_region(walk[::2]) is None
    assert find_still_region([painted(view, "tripod") for view in walk[:2]]) is None


def as_jpeg(view: View, where: np.ndarray, level: int) -> View:
    """A view in which an area is painted grey, as its JPEG shows it."""
    image = np.rint(view.image * 255.0).astype(np.uint8)
    image[where] = level
    samples = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1], cv2.IMREAD_COLOR)
    return replace(view, image=samples.astype(np.float32) / np.float32(255.0))


def overlap(first: np.ndarray | None, second: np.ndarray) -> float:
    return 0.0 if first is None else float((first & second).sum() / (first | second).sum())


def operator(shift: float) -> np.ndarray:
    """Somebody painted over, and an area beside of him."""
    down, right = np.meshgrid(np.arange(SIZE[0]) * 180.0 / SIZE[0], np.arange(SIZE[1]) * 360.0 / SIZE[1], indexing="ij")
    body = np.hypot((down - 180.0) / 65.0, (right - 90.0 - shift) / 30.0) < 1.0
    return body | (down > 155.0 + 10.0 * np.sin(np.radians(3.0 * right))) | (np.hypot(down - 140, right - 200) < 9.0)


@pytest.mark.parametrize("level", [0, 110, 255])
def test_a_painted_operator_is_found_in_the_jpegs_of_both(pair: tuple[View, View], level: int) -> None:
    areas = operator(0.0), operator(12.0)
    found = find_camera_fixed(*(as_jpeg(view, area, level) for view, area in zip(pair, areas, strict=True)))
    assert min(overlap(mask, area) for mask, area in zip(found, areas, strict=True)) > 0.85


@pytest.mark.parametrize("level", [0, 255])
def test_bands_beside_a_partial_panorama_are_found(pair: tuple[View, View], level: int) -> None:
    band = np.zeros(SIZE, bool)
    band[:60] = band[-40:] = True
    band[:, 100:150] = True
    for mask in find_camera_fixed(*(as_jpeg(view, band, level) for view in pair)):
        assert overlap(mask, band) > 0.9


@pytest.mark.parametrize("kind", ["street", "room"])
@pytest.mark.parametrize("level", [0, 110, 255])
def test_plain_floors_skies_and_the_dark_are_kept(kind: str, level: int) -> None:
    scene, plain, dark = generate_scene(kind, 12), [], []
    for pose in sample_path(scene, 12, 2):
        image, depth = render_panorama(scene, pose, SIZE, supersample=1, threads=1)
        up = (pixel_directions(*SIZE) @ pose.rotation.T)[..., 1] * np.where(np.isfinite(depth), depth, 1e9)
        on_floor = up < np.nanmedian(up[-20:]) + 0.05
        assert on_floor.mean() > 0.05
        plain.append(as_jpeg(View(image, pose), on_floor | ~np.isfinite(depth), level))
        dark.append(View(np.maximum(image - np.float32(0.7), 0.0), pose))
    assert find_camera_fixed(*plain) == (None, None)
    assert find_camera_fixed(*dark) == (None, None)
