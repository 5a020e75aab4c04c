"""What moved is shown by one view alone, wholly; what stayed is blended as if nobody looked for ghosts."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from fusion_samples import asked

from omnisyn_cli.fusion import ghosts
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.ghosts import GhostRemover, label_regions
from omnisyn_cli.fusion.residual import ResidualFuser
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import Layer

SIZE = (256, 512)
RED = np.array([0.85, 0.1, 0.1], np.float32)


def wall(shift: float = 0.0) -> np.ndarray:
    """A finely textured picture; ``shift`` columns displaced."""
    row, col = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    angle = (col - shift) * (2 * np.pi / SIZE[1])
    waves = [np.sin(40 * angle + row / 5), np.sin(61 * angle - row / 7), np.sin(23 * angle + row / 11)]
    return (0.5 + 0.25 * np.stack(waves, axis=-1)).astype(np.float32)


def rendering(image: np.ndarray, rho: float | np.ndarray = 0.3, z: float = 0.0) -> Layer:
    colour = np.dstack([image, np.ones(SIZE, np.float32)]).astype(np.float32)
    return Layer.from_arrays(np.full(SIZE, rho, np.float32), colour, Pose(np.eye(3), np.array([0.0, 0.0, z])))


def ball(azimuth_col: int, radius: float = 0.16) -> np.ndarray:
    """Pixels within a cone around a column of the equator."""
    towards = pixel_directions(*SIZE)[SIZE[0] // 2, azimuth_col % SIZE[1]]
    return pixel_directions(*SIZE) @ towards > np.cos(radius)


def with_ball(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    return np.where(where[..., None], RED, image)


def border(where: np.ndarray, reach: int) -> np.ndarray:
    near = [np.roll(where, (i, j), (0, 1)) for i in range(-reach, reach + 1) for j in (-reach, 0, reach)]
    near += [np.roll(where, (i, j), (0, 1)) for i in (-reach, 0, reach) for j in range(-reach, reach + 1)]
    return np.any(near, axis=0) & ~np.all(near, axis=0)


def suppress(first: Layer, second: Layer, t: float, **changes: float) -> None:
    height = len(first.inverse_depth)
    remover = GhostRemover(first.inverse_depth.shape, threads=1)
    step = remover(first, second, replace(BlendRule.at(t), **changes))
    for rows in (slice(0, height // 3), slice(height // 3, height)):
        if step is not None:
            step(first.colour[rows], second.colour[rows], rows.start)


def fuse(first: Layer, second: Layer, t: float, threads: int | None = 1) -> np.ndarray:
    return GeometricFuser(SIZE, threads=threads)(first, second, t).copy()


def share_of(found: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How much of ``one`` against ``other`` is in a picture, by least squares over the channels."""
    step = one - other
    return ((found - other) * step).sum(-1) / np.maximum((step * step).sum(-1), 1e-9)


@pytest.mark.parametrize("column", [256, 100, 0], ids=["centre", "aside", "on the seam"])
@pytest.mark.parametrize("object_rho", [0.3, 0.5], ids=["depth of the wall", "nearer"])
def test_a_thing_in_one_picture_only_is_there_or_not_but_never_half(column: int, object_rho: float) -> None:
    where, background = ball(column), wall()
    picture, rho = with_ball(background, where), np.where(where, object_rho, 0.3)
    for t in (0.03, 0.07, 0.2, 0.4, 0.6, 0.8, 0.93, 0.97):
        found = fuse(rendering(picture, rho, z=-1e-3), rendering(background, z=1e-3), t)
        share = share_of(found, picture, background)[where & ~border(where, 8)]
        assert ((share < 0.03) | (share > 0.97)).all(), t
        assert share.max() - share.min() < 0.1, "one view for the whole of it"
        if object_rho == 0.3:
            assert (share > 0.5).all() == (t < 0.5)


@pytest.mark.parametrize(("disagreement", "winner"), [(0.06, 0), (50.0, 1)])
def test_the_view_that_wins_is_the_one_that_the_blend_prefers(disagreement: float, winner: int) -> None:
    """The nearer thing of the first view, unless differences of distance count for nothing: then the share decides."""
    where, background = ball(200), wall()
    near = rendering(with_ball(background, where), np.where(where, 0.6, 0.3), z=-1e-3)
    far = rendering(background, z=1e-3)
    suppress(near, far, 0.8, disagreement=disagreement)
    inner = where & ~border(where, 8)
    assert ((near, far)[winner].colour[inner, 3] == 1.0).all()
    assert ((near, far)[1 - winner].colour[inner, 3] < 0.03).all()


@pytest.mark.parametrize(("weight", "winner"), [(0.3, 0), (0.01, 1)])
def test_a_nearer_surface_that_is_hardly_trusted_wins_no_region(weight: float, winner: int) -> None:
    """Wrong depth in front of what the other view knows well: the blend shows the other view, and so does a region."""
    where, background = ball(200), wall()
    near = rendering(with_ball(background, where), np.where(where, 0.6, 0.3), z=-1e-3)
    near.colour[where, 3] = weight
    found = fuse(near, rendering(background, z=1e-3), 0.5)
    inner = where & ~border(where, 8)
    np.testing.assert_allclose(found[inner], (with_ball(background, where), background)[winner][inner], atol=0.03)


@pytest.mark.parametrize(("stripes", "winner"), [(4, 1), (64, 0)], ids=["half of it", "hardly"])
def test_a_torn_thing_does_not_show_the_other_view_through_its_holes(stripes: int, winner: int) -> None:
    """The first view counts more at this place of the way, but not if the second fills half of the rows of its ball."""
    where, background = ball(200), wall()
    torn = rendering(with_ball(background, where), z=-1e-3)
    holes = where & (np.arange(SIZE[0]) % stripes < 2)[:, None]
    torn.colour[holes], torn.inverse_depth[holes] = 0.0, -1.0
    found = fuse(torn, rendering(background, z=1e-3), 0.35)
    inner = where & ~holes & ~border(where, 8)
    share = share_of(found, with_ball(background, where), background)[inner]
    assert np.median(share) == pytest.approx(1.0 - winner, abs=0.03)


def test_a_network_has_no_say_in_what_moved() -> None:
    """Nor at the border of it, where the view that is not shown keeps some of its weight."""
    where, elsewhere, background = ball(200), ball(400), wall()
    near = rendering(with_ball(background, where), np.where(where, 0.6, 0.3), z=-1e-3)
    brighter = background + np.float32(0.1) * elsewhere[..., None]  # too little to have moved
    far = rendering(brighter, np.where(elsewhere, 0.2, 0.3), z=1e-3)

    def insist(planes: np.ndarray) -> np.ndarray:
        return np.full((4, *planes.shape[1:]), 0.2, np.float32)

    fused = ResidualFuser(SIZE, insist, 128, threads=1)(asked(near), asked(far), 0.5)
    change = np.abs(fused - fuse(near, far, 0.5)).max(axis=-1)
    assert change[where].max() < 1e-5
    assert change[elsewhere].max() > 0.05


def test_outside_of_what_moved_nothing_changes() -> None:
    where, background = ball(200), wall()
    picture = with_ball(background, where)
    far = ~where & ~border(where, 14)
    found = fuse(rendering(picture, z=-1e-5), rendering(wall(0.5), z=1e-5), 0.4)
    without = 0.6 * background + 0.4 * wall(0.5)
    np.testing.assert_allclose(found[far], without[far], atol=1e-4)


# A quarter of the range from one side of the panorama to the other: vignetting, another sky.
LIGHT = 0.125 * np.cos(np.arange(SIZE[1]) * (2 * np.pi / SIZE[1]))[None, :, None]
THIN = np.abs(np.arange(SIZE[1]) - 150)[None, :] * np.ones(SIZE) < 2


@pytest.mark.parametrize(
    ("first", "second"),
    [*((wall(), wall(shift)) for shift in (0.0, 0.5, 1.0)), (wall() + LIGHT, wall() - LIGHT),
     (with_ball(wall(), THIN), wall())],
    ids=["alike", "half a pixel aside", "a pixel aside", "light that differs widely", "a thin line"],
)  # fmt: skip
def test_what_has_not_moved_is_no_ghost(first: np.ndarray, second: np.ndarray) -> None:
    views = rendering(first), rendering(second)
    suppress(*views, 0.5)
    assert all((view.colour[..., 3] == 1).all() for view in views)


def test_exchanging_the_views_exchanges_who_loses() -> None:
    a, b = with_ball(wall(), ball(130)), with_ball(wall(), ball(300))
    there, back = (rendering(a, z=-0.4), rendering(b, z=0.6)), (rendering(b, z=0.6), rendering(a, z=-0.4))
    suppress(*there, 0.3)
    suppress(*back, 0.7)
    np.testing.assert_allclose(there[0].colour, back[1].colour, atol=1e-6)
    np.testing.assert_allclose(there[1].colour, back[0].colour, atol=1e-6)
    assert (there[0].colour[..., 3] == 0).any() or (there[1].colour[..., 3] == 0).any()


def test_turning_everything_by_whole_cells_turns_the_result() -> None:
    picture = with_ball(wall(), ball(500))
    plain, turned = (rendering(picture), rendering(wall())), (
        rendering(np.roll(picture, 40, axis=1)), rendering(np.roll(wall(), 40, axis=1))
    )  # fmt: skip
    for pair in (plain, turned):
        suppress(*pair, 0.7)
    np.testing.assert_allclose(np.roll(plain[0].colour, 40, axis=1), turned[0].colour, atol=1e-6)
    assert (plain[0].colour[..., 3] == 0).any()


def test_from_one_place_everything_cross_fades() -> None:
    picture = with_ball(wall(), ball(256))
    found = fuse(rendering(picture), rendering(wall()), 0.4)
    np.testing.assert_allclose(found, 0.6 * picture + 0.4 * wall(), atol=1e-6)


def test_what_only_one_view_shows_keeps_its_weight() -> None:
    where = ball(256)
    picture = with_ball(wall(), where)
    first, second = rendering(picture), rendering(wall())
    alone = np.zeros(SIZE, bool)
    alone[:, 250:260] = True
    second.colour[alone] = 0
    second.inverse_depth[alone] = -1
    suppress(first, second, 0.8)
    assert (first.colour[alone, 3] == 1).all()
    assert (first.colour[where & ~alone & ~border(where, 8), 3] < 0.01).all()


@pytest.mark.parametrize("as_array", [np.asarray, torch.from_numpy])
def test_regions_are_those_of_opencv_joined_across_the_seam(as_array: Callable[[np.ndarray], Any]) -> None:
    """Islands, rings and winding walls; two regions that touch the seam beside each other are one."""
    rng = np.random.default_rng(0)
    for share in (0.05, 0.3, 0.45, 0.6):
        differs = rng.random((40, 70)) < share
        differs[3:30:2], differs[4:30:4, 69], differs[6:30:4, 1], differs[:, 35] = True, False, False, False
        differs[3:30:2, 34:37] = True
        found = np.asarray(label_regions(as_array(differs)))
        _, twice = cv2.connectedComponents(np.tile(differs, 2).astype(np.uint8), connectivity=8)
        assert ((found > 0) == differs).all()
        for i, j in rng.integers(0, (40, 70), (60, 2)):
            own = found == found[i, j]
            reached = twice == twice[i, j]
            assert not differs[i, j] or own[(reached[:, :70] | reached[:, 70:])].all()
        pairs = [(found[a], found[b]) for a in (np.s_[1:], np.s_[:-1]) for b in (np.s_[1:], np.s_[:-1])]
        assert all((one[(one > 0) & (two > 0)] == two[(one > 0) & (two > 0)]).all() for one, two in pairs[:1])
        assert len(np.unique(found)) - 1 <= cv2.connectedComponents(differs.astype(np.uint8), connectivity=8)[0] - 1


@pytest.mark.parametrize("size", [(2, 4), (16, 32), (50, 100), (130, 260), (300, 600)])
def test_any_size_works(size: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ghosts, "MIN_GHOST_DIFFERENCE", 0.01)
    rng = np.random.default_rng(1)
    colour = [np.ones((*size, 4), np.float32) for _ in range(2)]
    for c in colour:
        c[..., :3] = rng.random((*size, 3))
    views = [Layer.from_arrays(np.full(size, 0.2, np.float32), c, Pose(np.eye(3), np.zeros(3))) for c in colour]
    suppress(views[0], views[1], 0.5)
    assert all(np.isfinite(c).all() and (c >= 0).all() for c in colour)


def test_the_number_of_threads_does_not_show() -> None:
    first, second = rendering(with_ball(wall(), ball(90))), rendering(wall(0.5), z=0.3)
    again = rendering(with_ball(wall(), ball(90))), rendering(wall(0.5), z=0.3)
    np.testing.assert_array_equal(fuse(first, second, 0.4, 1), fuse(*again, 0.4, 3))
