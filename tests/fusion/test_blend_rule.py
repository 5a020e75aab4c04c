"""The rule stands in two places, for arrays and for one pixel: they are the same, for numpy as for torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, blend_layers, view_weights
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, Layer

SIZE = (61, 1200)
"""More columns than are blended together."""


def rendering(seed: int) -> Layer:
    """Holes, masked pixels, weights around the least that counts, infinity, distances alike and far apart."""
    rng = np.random.default_rng(seed)
    colour = rng.uniform(-0.05, 1.2, (*SIZE, 4)).astype(np.float32)
    colour[..., 3] = np.clip(colour[..., 3], 0, 1) * (rng.random(SIZE) > 0.2)
    faint = rng.random(SIZE) < 0.1
    colour[faint, 3] = MIN_VISIBLE_WEIGHT * rng.choice(np.float32([0.5, 1.0, 1.001, 2.0]), faint.sum())
    rho = (0.3 + 0.02 * rng.standard_normal(SIZE)).clip(0.0) * (rng.random(SIZE) > 0.1)
    rho[rng.random(SIZE) < 0.1] *= 3
    hole = rng.random(SIZE) < 0.3
    colour[hole], rho[hole] = 0.0, -1.0
    offset = ((0.2, -0.1, 0.4), (-0.3, 0.2, -0.5))[seed]
    return Layer.from_arrays(rho.astype(np.float32), colour, Pose(np.eye(3), np.array(offset)))


def shown(view: Layer) -> LayerArrays:
    offset = view.target_from_source.position.astype(np.float32)
    return LayerArrays(view.colour[..., :3], view.colour[..., 3], view.inverse_depth, offset)


def as_tensors(view: LayerArrays) -> LayerArrays:
    return LayerArrays(*(torch.from_numpy(np.ascontiguousarray(part)) for part in vars(view).values()))


DIRECTIONS = pixel_directions(*SIZE).astype(np.float32)
VIEWS = rendering(0), rendering(1)


@pytest.mark.parametrize("t", [0.0, 0.002, 0.05, 0.5, 0.93, 1.0])
@pytest.mark.parametrize("changes", [{}, {"disagreement": 0.2, "hidden_weight": 0.3}, {"hidden_weight": 1.0}], ids=str)
@pytest.mark.parametrize("dissolves", [False, True])
def test_the_kernel_is_the_rule(t: float, changes: dict[str, float], dissolves: bool) -> None:
    """What is seen, to a tenth of a level; the exponential of the kernel is right to a ten-thousandth of itself."""
    rule, views = replace(BlendRule.at(t, dissolves=dissolves), **changes), [shown(view) for view in VIEWS]
    weights = view_weights(*views, DIRECTIONS, rule)
    expected, counts = blend_layers(*views, weights)
    fuser, found = GeometricFuser(SIZE, threads=1), np.empty((*SIZE, 3), np.float32)
    fuser.blend(LayerPair(*VIEWS), rule, found)
    np.testing.assert_array_equal(fuser.is_seen > 0, counts > 0)
    seen = counts > 0
    assert 0.05 < 1 - seen.mean() < 0.5
    np.testing.assert_allclose(found[seen], expected[seen], atol=1e-4)
    alone = seen & ((weights[0] == 0) | (weights[1] == 0))
    one = np.where((weights[0] > 0)[..., None], views[0].colour, views[1].colour)
    np.testing.assert_array_equal(found[alone], np.maximum(one, 0)[alone])


@pytest.mark.parametrize("t", [0.0, 0.3, 1.0])
def test_tensors_are_blended_as_arrays(t: float) -> None:
    rule, views = BlendRule.at(t), [shown(view) for view in VIEWS]
    expected = blend_layers(*views, view_weights(*views, DIRECTIONS, rule))
    tensors = [as_tensors(view) for view in views]
    found = blend_layers(*tensors, view_weights(*tensors, torch.from_numpy(DIRECTIONS), rule))
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == torch.float32
        assert other.dtype == np.float32
        np.testing.assert_allclose(one.numpy(), other, atol=2e-5)


def test_gradients_are_finite_holes_infinity_and_equal_depths_included() -> None:
    views = [as_tensors(shown(view)) for view in VIEWS]
    for view in views:
        view.colour.requires_grad_()
        view.inverse_depth.requires_grad_()
    weights = view_weights(*views, torch.from_numpy(DIRECTIONS), BlendRule.at(0.4))
    sum(part.sum() for part in blend_layers(*views, weights)).backward()
    for view in views:
        assert torch.isfinite(view.colour.grad).all()
        assert torch.isfinite(view.inverse_depth.grad).all()
        assert view.inverse_depth.grad.abs().max() > 0


def test_hiding_sets_in_smoothly_and_symmetrically() -> None:
    t = np.linspace(0, 1, 201)
    occlusion_strength = np.array([BlendRule.at(x).occlusion_strength for x in t])
    np.testing.assert_allclose(occlusion_strength, occlusion_strength[::-1], atol=1e-12)
    assert occlusion_strength[0] == occlusion_strength[-1] == 0
    assert (occlusion_strength[20:181] == 1).all()
    assert np.abs(np.diff(occlusion_strength)).max() < 0.1
    assert (np.diff(occlusion_strength[:21]) >= 0).all()


@pytest.mark.parametrize("t", [0.0, 0.25, 0.5, 1.0])
def test_a_dissolve_shows_most_places_from_one_layer(t: float) -> None:
    views = [shown(view) for view in VIEWS]
    plain, quick = (
        view_weights(*views, DIRECTIONS, BlendRule.at(t, dissolves=dissolves)) for dissolves in (False, True)
    )
    is_both = (plain[0] > 0) & (plain[1] > 0)
    before, after = (weights[0][is_both] / (weights[0] + weights[1])[is_both] for weights in (plain, quick))
    np.testing.assert_allclose(after, before**4 / (before**4 + (1 - before) ** 4), atol=1e-5)
    for weights, kept in zip(quick, plain, strict=True):
        np.testing.assert_array_equal(weights > 0, kept > 0)
