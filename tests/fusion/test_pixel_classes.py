"""Kinds of pixels: where the answer is known in closed form, at their definition, for numpy as for torch."""

import numpy as np
import pytest
import torch
from ball_samples import inverse_depth, seen_by

from omnisyn_cli.fusion.pixel_classes import SILHOUETTE_PIXELS as REACH
from omnisyn_cli.fusion.pixel_classes import PixelClasses, classify_pixels, silhouette_mask
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.tolerances import SAME_SURFACE_TOLERANCE
from omnisyn_cli.render.renderer import MeshRenderer, RendererInputs
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, Layer

SIZE = (128, 256)
TARGET = np.array([0.05, 0.0, 0.1])
BELOW = (np.array([-0.2, -0.9, -0.3]), np.array([0.2, -0.9, -0.3]))
SILHOUETTE_PIXELS = (np.array([-0.9, 0.1, -0.6]), np.array([1.0, -0.1, -0.5]))
MAX_SHIFT_PIXELS = (np.array([-0.5, 0.1, 0.0]), np.array([0.6, -0.1, 0.0]))


def rendering(rho: np.ndarray, weight: np.ndarray | float = 1.0) -> Layer:
    colour = np.zeros((*rho.shape, 4), np.float32)
    colour[..., 3] = np.where(rho >= 0, weight, 0.0)
    return Layer.from_arrays(rho.astype(np.float32), colour, Pose.identity())


def meshed(place: np.ndarray) -> Layer:
    """The exact surface that a view at a place has, from the target."""
    size = (2 * SIZE[0], 2 * SIZE[1])
    image = np.full((*size, 3), 0.5, np.float32)
    draw = MeshRenderer(RendererInputs(image, None, inverse_depth(place, size), None, SIZE, threads=1))
    return draw(Pose(np.eye(3), place - TARGET))


def grown(mask: np.ndarray, reach: int) -> np.ndarray:
    """Pixels within a square, one by one; columns wrap."""
    found = np.zeros_like(mask)
    for row, col in zip(*np.nonzero(mask), strict=True):
        cols = np.arange(col - reach, col + reach + 1) % mask.shape[1]
        found[max(row - reach, 0) : row + reach + 1, cols] = True
    return found


def borders(kinds: PixelClasses) -> np.ndarray:
    """Pixels beside one of another kind."""
    number = np.argmax(np.stack(kinds), axis=0)
    found = np.zeros(number.shape, bool)
    for step, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        moved = np.roll(number, step, axis)
        if axis == 0:
            moved[0 if step > 0 else -1] = number[0 if step > 0 else -1]
        found |= moved != number
    return found


def test_behind_and_around_a_ball_kinds_are_those_of_geometry() -> None:
    """What either view sees of a ball, of what lies behind it, and through its unseen side, follows from spheres."""
    count = np.zeros(4, int)
    for places in (BELOW, SILHOUETTE_PIXELS, MAX_SHIFT_PIXELS):
        views = [meshed(place) for place in places]
        exact = [seen_by(place, TARGET, SIZE) for place in places]
        expected = classify_pixels(*map(rendering, exact))
        inner = ~grown(borders(expected), 3)
        for kind, (found, is_there) in enumerate(zip(classify_pixels(*views), expected, strict=True)):
            assert (found != is_there)[inner].mean() < 5e-4, "more than a few grazing quads differ"
            count[kind] += (is_there & inner).sum()
        outline, beside = _steps(inverse_depth(TARGET, SIZE)), silhouette_mask(*views)
        is_shown = np.isclose(np.maximum(*exact), inverse_depth(TARGET, SIZE), rtol=1e-3)
        assert beside[outline & ~grown(~is_shown, 1)].mean() > 0.98
        around = grown(borders(expected) | silhouette_mask(*map(rendering, exact)), 2)
        assert around[beside].mean() > 0.9, "a grazing surface has steps of its own"
    assert (count > 20).all(), "a kind is missing"


def _steps(rho: np.ndarray) -> np.ndarray:
    """Both sides of the outline of the ball."""
    return borders(PixelClasses(*(rho > 0.4, rho <= 0.4), *np.zeros((2, *rho.shape), bool)))


def test_every_pixel_is_of_one_kind() -> None:
    rng = np.random.default_rng(1)
    views = [rendering(np.where(rng.random(SIZE) < 0.3, -1.0, rng.random(SIZE)), rng.random(SIZE)) for _ in range(2)]
    kinds = classify_pixels(*views)
    np.testing.assert_array_equal(np.sum(kinds, axis=0), 1)
    swapped = classify_pixels(*views[::-1])
    for kind, other in zip(kinds, swapped, strict=True):
        np.testing.assert_array_equal(kind, other)


@pytest.mark.parametrize(
    ("first", "second", "weight", "kind"),
    [
        (1.0, 1.0 - 0.99 * SAME_SURFACE_TOLERANCE, 1.0, "agree"),
        (1.0, 1.0 - 1.01 * SAME_SURFACE_TOLERANCE, 1.0, "disagree"),
        (0.0, 0.0, 1.0, "agree"),
        (0.0, 1e-8, 1.0, "agree"),
        (0.0, 0.01, 1.0, "disagree"),
        (0.0, -1.0, 1.0, "one_view"),
        (-1.0, 0.5, 1.0, "one_view"),
        (-1.0, -1.0, 1.0, "hole"),
        (0.5, -1.0, MIN_VISIBLE_WEIGHT / 2, "hole"),
    ],
)
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
    views = [rendering(np.where(rng.random(SIZE) < 0.2, -1.0, rng.random(SIZE) ** 2)) for _ in range(2)]
    tensors = [Layer.from_arrays(torch.from_numpy(v.inverse_depth), torch.from_numpy(v.colour), v.target_from_source)
               for v in views]  # fmt: skip
    for one, other in zip(classify_pixels(*views), classify_pixels(*tensors), strict=True):
        np.testing.assert_array_equal(one, other.numpy())
    np.testing.assert_array_equal(silhouette_mask(*views), silhouette_mask(*tensors).numpy())
