"""Whole frames: those of a device are those of the processor, to 1/255, but for pixels at edges."""

from dataclasses import replace

import numpy as np
import pytest
from gpu_samples import (
    ALIKE,
    BRIGHTER,
    in_8_bits,
    on_device,
    on_processor,
    pair_along,
    pair_on,
    share_within_a_level,
    target_between,
)

from omnisyn_cli.fusion.photometry import ExposureCurve
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.synthesis.device import pair as frames
from omnisyn_cli.types import DepthEstimate, View

SIZE = (128, 256)

LEAST_SHARE = 0.999
"""What docs/gpu.md promises."""

WAYS = {"forward": (0.1, 0.05, -0.8), "vertical": (0.0, 0.9, 0.05)}

LayerPair = tuple[View, View]


@pytest.fixture(scope="module", params=[("street", "forward"), ("room", "vertical")], ids="-".join)
def views(request: pytest.FixtureRequest) -> LayerPair:
    """Cut meshes; the cameras are turned about all axes, and so is the target."""
    kind, way = request.param
    return pair_along(kind, WAYS[way], SIZE)


def masked(view: View, towards: tuple[float, float, float]) -> View:
    """Without a cone of 30°."""
    direction = np.array(towards) / np.linalg.norm(towards)
    return replace(view, mask=pixel_directions(*view.image.shape[:2]) @ direction < np.cos(np.radians(30)))


def with_ghost(view: View, towards: tuple[float, float, float]) -> View:
    """With something red in it that the other view does not show, painted on what is there."""
    direction = np.array(towards) / np.linalg.norm(towards)
    where = pixel_directions(*view.image.shape[:2]) @ direction > np.cos(np.radians(12))
    return replace(view, image=np.where(where[..., None], np.float32([0.9, 0.05, 0.1]), view.image))


def check(views: LayerPair, t: float, size: tuple[int, int] = SIZE, curve: ExposureCurve = ALIKE) -> np.ndarray:
    target = target_between(*views, t)
    found, expected = on_device(views, target, t, size, curve), on_processor(views, target, t, size, curve)
    assert share_within_a_level(found, expected) >= LEAST_SHARE
    rows, cols = size[0] // 16, size[1] // 32
    for part in (np.s_[:rows], np.s_[-rows:], np.s_[:, :cols], np.s_[:, -cols:]):  # both poles and the seam
        assert share_within_a_level(found[part], expected[part]) >= LEAST_SHARE - 0.004
    assert np.abs(found - expected).mean() < 0.1 / 255
    return expected


@pytest.mark.parametrize("t", [0.0, 0.004, 0.3, 0.5, 1.0])
def test_frames_agree_along_the_way(views: LayerPair, t: float) -> None:
    check(views, t)


@pytest.mark.parametrize("size", [(64, 128), (250, 500)], ids=["smaller", "larger"])
def test_frames_of_another_size_agree(views: LayerPair, size: tuple[int, int]) -> None:
    """Photographs are shrunk and magnified; 250 is no power of two, nor are most levels of its pyramid even."""
    check(views, 0.4, size)


def test_frames_of_8_bit_samples_agree(views: LayerPair) -> None:
    check((in_8_bits(views[0]), in_8_bits(views[1])), 0.6)


def test_frames_of_pictures_exposed_differently_agree(views: LayerPair) -> None:
    expected = check(views, 0.3, curve=BRIGHTER)
    plain = on_processor(views, target_between(*views, 0.3), 0.3, SIZE)
    assert share_within_a_level(expected, plain) < 0.5


def test_frames_with_masks_agree(views: LayerPair) -> None:
    """Both leave out what is below, so that there is a hole to fill, and one leaves out something at its seam."""
    below = tuple(masked(view, (0.1, -1.0, 0.2)) for view in views)
    check((masked(views[0], (0.1, 0.2, 1.0)), views[1]), 0.5)
    expected = check((below[0], below[1]), 0.5)
    plain = on_processor(views, target_between(*views, 0.5), 0.5, SIZE)
    assert share_within_a_level(expected, plain) < 0.98


def test_frames_with_ghosts_agree(views: LayerPair) -> None:
    haunted = (with_ghost(views[0], (0.5, 0.1, 1.0)), with_ghost(views[1], (-1.0, 0.1, -0.3)))
    expected = check(haunted, 0.4)
    assert share_within_a_level(expected, on_processor(views, target_between(*views, 0.4), 0.4, SIZE)) < 0.99


def test_from_one_place_both_pictures_fade_into_each_other(views: LayerPair) -> None:
    first, second = views
    check((first, replace(second, pose=Pose(second.pose.rotation, first.pose.position))), 0.5)


def test_uncertain_depth_counts_less(views: LayerPair) -> None:
    rng = np.random.default_rng(3)
    doubted = tuple(
        replace(view, known_depth=DepthEstimate(view.known_depth.inverse_depth, rng.random(SIZE, np.float32)))
        for view in views
    )
    check((doubted[0], doubted[1]), 0.5)


def test_samples_are_the_rounded_numbers(views: LayerPair) -> None:
    target, pair = target_between(*views, 0.5), pair_on("cpu", views, SIZE, ALIKE)
    poses = [target.inverse() @ view.pose for view in views]
    numbers, samples = np.empty((*SIZE, 3), np.float32), np.empty((*SIZE, 3), np.uint8)
    pair.frame(*poses, 0.5, numbers)
    pair.frame(*poses, 0.5, samples)
    np.testing.assert_array_equal(samples, np.floor(np.clip(numbers, 0, 1) * np.float32(255) + np.float32(0.5)))


def test_how_much_is_done_at_a_time_changes_nothing(views: LayerPair, monkeypatch: pytest.MonkeyPatch) -> None:
    target = target_between(*views, 0.5)
    whole = on_device(views, target, 0.5, SIZE, BRIGHTER)
    monkeypatch.setattr(frames, "PIXELS_PER_STEP", 7 * SIZE[1])
    np.testing.assert_array_equal(on_device(views, target, 0.5, SIZE, BRIGHTER), whole)


def test_the_nearest_thing_in_the_last_frame_is_known(views: LayerPair) -> None:
    pair, target = pair_on("cpu", views, SIZE, ALIKE), target_between(*views, 0.5)
    assert pair.nearest == np.inf
    poses = [target.inverse() @ view.pose for view in views]
    pair.frame(*poses, 0.5, np.empty((*SIZE, 3), np.uint8))
    seen = [surface(pose).inverse_depth.max() for surface, pose in zip(pair.surfaces, poses, strict=True)]
    assert pair.nearest == max(seen)
