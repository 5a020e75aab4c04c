"""Kinds of pixels of views of a ball, in closed form; pixels at edges are means of those of twice the size."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from fusion_samples import neighbours

from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.ghosts import GhostSuppression
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.fusion.pixel_classes import SILHOUETTE_PIXELS as REACH
from omnisyn_cli.fusion.pixel_classes import PixelClasses, classify_pixels, is_other_surface, silhouette_mask
from omnisyn_cli.fusion.supersampling import MIN_CONTRAST_LEVELS, EdgeSupersampler
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.tolerances import SAME_SURFACE_TOLERANCE
from omnisyn_cli.render.renderer import MeshRenderer, RendererInputs
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, Layer

RADIUS, AROUND = 0.5, 4.0
CENTRE = np.array([0.0, 0.0, -1.2])


def hits(origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances along unit rays to the front of the ball (infinite if missed) and to the hollow ball."""
    near, far = _roots(origin - CENTRE, directions, RADIUS), _roots(origin, directions, AROUND)
    return np.where((near[0] > 1e-6) & ~np.isnan(near[0]), near[0], np.inf), far[1]


def _roots(origin: np.ndarray, directions: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    along, beyond = (directions * origin).sum(axis=-1), (origin * origin).sum() - radius**2
    with np.errstate(invalid="ignore"):
        half = np.sqrt(along**2 - beyond)
    return -along - half, -along + half


def inverse_depth(position: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """As exact as float32 is; cameras are not turned."""
    return (1.0 / np.minimum(*hits(position, pixel_directions(*size)))).astype(np.float32)


def seen_by(view: np.ndarray, target: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Inverse depth at a target of the first thing on every ray that a view sees from its front; −1 where none."""
    directions = pixel_directions(*size)
    ball, hollow = hits(target, directions)
    shown = np.full(size, -1.0)
    for distance in (hollow, ball):  # what is nearer is written last
        points = target + np.where(np.isfinite(distance), distance, 1.0)[..., None] * directions
        away = points - view
        length = np.linalg.norm(away, axis=-1)
        first = np.minimum(*hits(view, away / length[..., None]))
        shown = np.where(np.isfinite(distance) & (first > length - 1e-6), 1.0 / distance, shown)
    return shown


SIZE = (64, 128)
DOUBLE = (2 * SIZE[0], 2 * SIZE[1])
TARGET = np.array([0.05, 0.1, 0.0])
PLACES = (np.array([-0.3, 0.1, 0.1]), np.array([0.4, -0.1, 0.0]))


def image(place: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A pale ball before a dark, striped wall."""
    directions = pixel_directions(*size)
    ball, wall = hits(place, directions)
    stripes = 0.2 + 0.1 * np.sin(7.0 * (place + wall[..., None] * directions))
    return np.where(np.isfinite(ball)[..., None], [0.9, 0.8, 0.7], stripes).astype(np.float32)


def seen(size: tuple[int, int], target: np.ndarray = TARGET) -> list[Layer]:
    fine = (192, 384)
    drawn = [
        MeshRenderer(RendererInputs(image(p, fine), None, inverse_depth(p, fine), None, size, threads=1))
        for p in PLACES
    ]
    return [draw(Pose(np.eye(3), p - target)) for draw, p in zip(drawn, PLACES, strict=True)]


VIEWS, FINE_VIEWS = seen(SIZE), seen(DOUBLE)


def fused(views: list[Layer], size: tuple[int, int], t: float = 0.5, **options: object) -> np.ndarray:
    fuser = GeometricFuser(size, threads=options.pop("threads", 1), **options)
    return fuser(*views, t).copy()


def edge_pixels(picture: np.ndarray) -> np.ndarray:
    return EdgeSupersampler(SIZE, 1).mark(LayerPair(*VIEWS), picture) > 0


def halved(picture: np.ndarray) -> np.ndarray:
    return picture.reshape(SIZE[0], 2, SIZE[1], 2, 3).mean(axis=(1, 3))


def test_edges_are_the_means_of_twice_the_size_and_nothing_else_changes() -> None:
    with_edges, without = fused(VIEWS, SIZE), fused(VIEWS, SIZE, edges=False)
    expected, there = halved(fused(FINE_VIEWS, DOUBLE, edges=False)), edge_pixels(without)
    assert 0.01 < there.mean() < 0.1
    np.testing.assert_array_equal(with_edges[~there], without[~there])
    found = np.abs(with_edges - expected).max(axis=-1)[there]
    assert (found < 0.01).mean() > 0.9, "but where samples are holes, which are filled otherwise"
    assert np.abs(without - expected).max(axis=-1)[there].mean() > 5 * found.mean()


def test_edges_come_closer_to_the_truth() -> None:
    """A picture of many samples, which no part of the program has made."""
    many = 8
    truth = image(TARGET, (many * SIZE[0], many * SIZE[1])).reshape(SIZE[0], many, SIZE[1], many, 3).mean(axis=(1, 3))
    errors = [((fused(VIEWS, SIZE, edges=edges) - truth) ** 2).mean() for edges in (True, False)]
    assert errors[0] < 0.6 * errors[1]


def test_edge_pixels_are_where_surfaces_jump_and_colours_differ() -> None:
    picture = fused(VIEWS, SIZE, edges=False)
    jumps = np.zeros(SIZE, bool)
    for view in VIEWS:
        near = np.maximum(view.inverse_depth, 0.0)
        for moved in neighbours(near):
            jumps |= is_other_surface(near, moved)
    wide = np.pad(np.pad(picture, ((0, 0), (1, 1), (0, 0)), "wrap"), ((1, 1), (0, 0), (0, 0)), "edge")
    levels = np.floor(255 * wide + 0.5)
    around = np.stack([levels[i : i + SIZE[0], j : j + SIZE[1]] for i in range(3) for j in range(3)])
    contrast = np.ptp(around, axis=0).max(axis=-1)
    np.testing.assert_array_equal(edge_pixels(picture), jumps & (contrast >= MIN_CONTRAST_LEVELS))


@pytest.mark.parametrize("t", [0.06, 0.5])
def test_samples_of_eight_bits_are_numbers_rounded(t: float) -> None:
    numbers, out = fused(VIEWS, SIZE, t), np.empty((*SIZE, 3), np.uint8)
    GeometricFuser(SIZE, threads=1)(*VIEWS, t, out)
    assert np.abs(out - np.clip(255 * numbers, 0, 255)).max() <= 1.01, "a rounded pixel may have a part in the mean"
    assert (np.abs(out - np.clip(255 * numbers, 0, 255)) <= 0.51).mean() > 0.995


def test_threads_change_nothing() -> None:
    np.testing.assert_array_equal(fused(VIEWS, SIZE, threads=3), fused(VIEWS, SIZE))


@pytest.mark.parametrize("t", [1e-6, 1 - 1e-6])
def test_at_the_ends_photographs_are_shown_as_they_are(t: float) -> None:
    np.testing.assert_array_equal(fused(VIEWS, SIZE, t), fused(VIEWS, SIZE, t, edges=False))


def test_samples_set_in_with_the_rule() -> None:
    """Half way between none and all of them, half of the change."""
    t = 0.05
    occlusion_strength = BlendRule.at(t).occlusion_strength
    without, there = fused(VIEWS, SIZE, t, edges=False), edge_pixels(fused(VIEWS, SIZE, t, edges=False))
    every = halved(fused(FINE_VIEWS, DOUBLE, t, edges=False))
    expected = without + occlusion_strength * (every - without)
    assert occlusion_strength == pytest.approx(0.5)
    assert (np.abs(fused(VIEWS, SIZE, t) - expected).max(axis=-1)[there] < 0.01).mean() > 0.9


def test_nothing_is_sampled_in_place_or_without_samples() -> None:
    bare = [replace(view, edge_samples=None) for view in VIEWS]
    np.testing.assert_array_equal(fused(bare, SIZE), fused(VIEWS, SIZE, edges=False))
    in_place = [replace(view, target_from_source=Pose(np.eye(3), CENTRE)) for view in VIEWS]
    np.testing.assert_array_equal(fused(in_place, SIZE), fused(in_place, SIZE, edges=False))


def test_what_is_suppressed_is_suppressed_in_samples() -> None:
    """With the first view suppressed everywhere it is as if it saw nothing that the second sees."""
    views = LayerPair(*VIEWS)
    rule, cells = BlendRule.at(0.5), np.full((8, 16), -1.0, np.float32)
    fuser, out = GeometricFuser(SIZE, threads=1), np.empty((*SIZE, 3), np.float32)
    fuser.blend(views.with_step(GhostSuppression(cells, 8)), rule, out)
    fine = GeometricFuser(DOUBLE, threads=1, edges=False)
    expected = np.empty((*DOUBLE, 3), np.float32)
    fine.blend(LayerPair(*FINE_VIEWS).with_step(GhostSuppression(cells, 16)), rule, expected)
    plain = np.empty_like(out)
    GeometricFuser(SIZE, threads=1, edges=False).blend(views.with_step(GhostSuppression(cells, 8)), rule, plain)
    there = edge_pixels(plain)
    assert (np.abs(out - halved(expected)).max(axis=-1)[there] < 0.01).mean() > 0.9


def test_where_a_view_does_not_jump_its_samples_lie_on_its_plane() -> None:
    """The other one jumps, so there are edge pixels; a hole of this one stays a hole."""
    row, col = (np.arange(n, dtype=np.float32) for n in SIZE)
    plane = 0.3 + 0.0002 * col[None, :] + 0.0005 * row[:, None]
    steps = np.where((np.arange(SIZE[1]) // 8 % 2 == 0)[None, :], 0.2, 0.5) * np.ones((SIZE[0], 1))
    steps[20:30, 40:60] = -1.0
    colour = np.random.default_rng(9).random((*SIZE, 4)).astype(np.float32)
    first, second = (Layer.from_arrays(rho.astype(np.float32), colour, Pose.identity()) for rho in (plane, steps))
    sampler, views = EdgeSupersampler(SIZE, 1), LayerPair(first, second)
    known, sought = sampler._edge_pixels(sampler.mark(views, colour[..., :3].copy()), views, 4, SIZE[0] - 3)
    rows = 4 + np.repeat(np.arange(len(known.tile_begins)), np.diff([0, *known.tile_begins[:, -1]]))
    inner = (known.cols > 0) & (known.cols < SIZE[1] - 1)
    at = np.repeat(known.cols, 2) + np.tile([-0.25, 0.25], len(known.cols))
    for half, down in ((0, -0.25), (1, 0.25)):
        expected = 0.3 + 0.0002 * at + 0.0005 * (np.repeat(rows, 2) + down)
        there = np.repeat(inner, 2)
        np.testing.assert_allclose(known.inverse_depth[half, there], expected[there], atol=2e-6)
    assert (known.unknown_counts == 0).all()
    assert (sought.inverse_depth == -1.0).all(), "its jumps make them edge pixels"
    assert (np.diff(sought.unknown_counts, axis=1) >= 0).all()
    assert sought.unknown_counts[:, -1].sum() == (sought.cols >= 0).sum(), "all of them are counted"


EYE = np.array([0.05, 0.0, 0.1])
BELOW = (np.array([-0.2, -0.9, -0.3]), np.array([0.2, -0.9, -0.3]))
SILHOUETTE_PIXELS = (np.array([-0.9, 0.1, -0.6]), np.array([1.0, -0.1, -0.5]))
MAX_SHIFT_PIXELS = (np.array([-0.5, 0.1, 0.0]), np.array([0.6, -0.1, 0.0]))


def rendering(rho: np.ndarray, weight: np.ndarray | float = 1.0) -> Layer:
    colour = np.zeros((*rho.shape, 4), np.float32)
    colour[..., 3] = np.where(rho >= 0, weight, 0.0)
    return Layer.from_arrays(rho.astype(np.float32), colour, Pose.identity())


def meshed(place: np.ndarray) -> Layer:
    """The exact surface that a view at a place has, from the target."""
    size = (2 * DOUBLE[0], 2 * DOUBLE[1])
    image = np.full((*size, 3), 0.5, np.float32)
    draw = MeshRenderer(RendererInputs(image, None, inverse_depth(place, size), None, DOUBLE, threads=1))
    return draw(Pose(np.eye(3), place - EYE))


def grown(mask: np.ndarray, reach: int) -> np.ndarray:
    """Pixels within a square, one by one; columns wrap."""
    found = np.zeros_like(mask)
    for row, col in zip(*np.nonzero(mask), strict=True):
        cols = np.arange(col - reach, col + reach + 1) % mask.shape[1]
        found[max(row - reach, 0) : row + reach + 1, cols] = True
    return found


def borders(kinds: PixelClasses) -> np.ndarray:
    number = np.argmax(np.stack(kinds), axis=0)
    return np.any([moved != number for moved in neighbours(number)], axis=0)


def test_behind_and_around_a_ball_kinds_are_those_of_geometry() -> None:
    """What either view sees of a ball, of what lies behind it, and through its unseen side, follows from spheres."""
    count = np.zeros(4, int)
    for places in (BELOW, SILHOUETTE_PIXELS, MAX_SHIFT_PIXELS):
        views = [meshed(place) for place in places]
        exact = [seen_by(place, EYE, DOUBLE) for place in places]
        expected = classify_pixels(*map(rendering, exact))
        inner = ~grown(borders(expected), 3)
        for kind, (found, is_there) in enumerate(zip(classify_pixels(*views), expected, strict=True)):
            assert (found != is_there)[inner].mean() < 5e-4, "more than a few grazing quads differ"
            count[kind] += (is_there & inner).sum()
        rho, beside = inverse_depth(EYE, DOUBLE), silhouette_mask(*views)
        outline = borders(PixelClasses(rho > 0.4, rho <= 0.4, *np.zeros((2, *rho.shape), bool)))  # of the ball
        is_shown = np.isclose(np.maximum(*exact), rho, rtol=1e-3)
        assert beside[outline & ~grown(~is_shown, 1)].mean() > 0.98
        around = grown(borders(expected) | silhouette_mask(*map(rendering, exact)), 2)
        assert around[beside].mean() > 0.9, "a grazing surface has steps of its own"
    assert (count > 20).all(), "a kind is missing"


def test_every_pixel_is_of_one_kind() -> None:
    rng = np.random.default_rng(1)
    views = [
        rendering(np.where(rng.random(DOUBLE) < 0.3, -1.0, rng.random(DOUBLE)), rng.random(DOUBLE)) for _ in range(2)
    ]
    kinds = classify_pixels(*views)
    np.testing.assert_array_equal(np.sum(kinds, axis=0), 1)
    swapped = classify_pixels(*views[::-1])
    for kind, other in zip(kinds, swapped, strict=True):
        np.testing.assert_array_equal(kind, other)


@pytest.mark.parametrize(
    ("first", "second", "weight", "kind"),
    [
        (1.0, 1.0 - 0.99 * SAME_SURFACE_TOLERANCE, 1.0, "agree"),
        (1.0, 1.0 - 1.01 * SAME_SURFACE_TOLERANCE, 1.0, "disagree"), (0.0, 0.0, 1.0, "agree"),
        (0.0, 1e-8, 1.0, "agree"), (0.0, 0.01, 1.0, "disagree"), (0.0, -1.0, 1.0, "one_view"),
        (-1.0, 0.5, 1.0, "one_view"), (-1.0, -1.0, 1.0, "hole"), (0.5, -1.0, MIN_VISIBLE_WEIGHT / 2, "hole"),
    ],
)  # fmt: skip
def test_kinds_at_their_limits(first: float, second: float, weight: float, kind: str) -> None:
    """Infinity agrees with infinity, and a colour without weight is none."""
    kinds = classify_pixels(*(rendering(np.full((1, 2), rho), weight) for rho in (first, second)))
    assert [name for name, mask in kinds._asdict().items() if mask.all()] == [kind]


def test_silhouettes_reach_over_the_seam_and_end_at_the_poles() -> None:
    rho = np.full((20, 40), 0.1)
    rho[0, 0] = rho[10, 39] = 1.0
    found = silhouette_mask(rendering(rho), rendering(np.full(rho.shape, -1.0)))
    jumps = np.zeros(rho.shape, bool)
    jumps[[0, 0, 0, 1, 10, 10, 10, 9, 11], [0, 1, 39, 0, 39, 38, 0, 39, 39]] = True
    np.testing.assert_array_equal(found, grown(jumps, REACH))
    assert not found[-5:].any()
    flat = rendering(np.full(rho.shape, 0.1))
    assert not silhouette_mask(flat, flat).any()


def test_torch_says_the_same() -> None:
    rng = np.random.default_rng(2)
    views = [rendering(np.where(rng.random(DOUBLE) < 0.2, -1.0, rng.random(DOUBLE) ** 2)) for _ in range(2)]
    tensors = [Layer.from_arrays(torch.from_numpy(v.inverse_depth), torch.from_numpy(v.colour), v.target_from_source)
               for v in views]  # fmt: skip
    for one, other in zip(classify_pixels(*views), classify_pixels(*tensors), strict=True):
        np.testing.assert_array_equal(one, other.numpy())
    np.testing.assert_array_equal(silhouette_mask(*views), silhouette_mask(*tensors).numpy())
