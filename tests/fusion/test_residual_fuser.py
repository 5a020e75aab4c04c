"""A network corrects the geometric fusion where the views contradict each other, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from fusion_samples import asked
from hypothesis import given, settings
from hypothesis import strategies as st

from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.input_channels import INPUT_CHANNELS, disagreement_mask
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.fusion.residual import InputBuilder, ResidualFuser, downsample_rows, network_size
from omnisyn_cli.fusion.warp_candidates import CANDIDATE_CHANNELS, CANDIDATE_SCALE
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import Layer

ROWS = 32  # That the network looks at.
SIZE = (CANDIDATE_SCALE * ROWS, 2 * CANDIDATE_SCALE * ROWS)  # Of the least renderings that it can be asked about.


def rendering(seed, size=SIZE, offset=(0.0, 0.0, 0.5), holes=0.2):
    """Random colours and weights at random distances from 2 m on, with holes in blocks of 4."""
    rng = np.random.default_rng(seed)
    colour = rng.random((*size, 4), np.float32)
    colour[..., 3] = 0.2 + 0.8 * colour[..., 3]
    rho = rng.random(size, np.float32) * 0.5
    blocks = rng.random((size[0] // 4, size[1] // 4)) < holes
    hole = np.kron(blocks, np.ones((4, 4), bool))
    colour[hole], rho[hole] = 0.0, -1.0
    return asked(Layer.from_arrays(rho, colour, Pose(np.eye(3), np.array(offset, float))))


def pair(size=SIZE, holes=0.2):
    return rendering(1, size, (0.1, 0.0, 0.5), holes), rendering(2, size, (0.0, -0.1, -0.5), holes)


def copy(view):
    same = Layer.from_arrays(view.inverse_depth.copy(), view.colour.copy(), view.target_from_source)
    return replace(same, source_sampler=view.source_sampler)


class Answers:
    """Stands in for the network: constant or given shares; remembers what it was shown."""

    def __init__(self, shares=0.0):
        self.shares, self.shown = shares, []

    def __call__(self, planes):
        self.shown.append(planes.copy())
        return np.broadcast_to(np.float32(self.shares), (4, *planes.shape[1:])).copy()


def fuse(views, t, network, threads=1, rows=ROWS):
    size = views[0].inverse_depth.shape
    return ResidualFuser(size, network, rows, threads)(*map(copy, views), t).copy()


def geometric(views, t):
    return GeometricFuser(views[0].inverse_depth.shape, threads=1)(*map(copy, views), t).copy()


def seen(views):
    return [view.colour[..., 3] > 0 for view in views]


@pytest.mark.parametrize("size", [(64, 128), (128, 256), (80, 160)])
@pytest.mark.parametrize("t", [0.0, 0.03, 0.5, 0.8])
def test_a_network_that_says_nothing_is_the_geometric_fusion(size, t):
    views = pair(size)
    np.testing.assert_array_equal(fuse(views, t, Answers()), geometric(views, t))


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 0.25), st.sampled_from([0.0, 1.0]))
def test_the_ends_are_the_photographs_whatever_the_network_says(share, t):
    views = pair(holes=0.0)
    np.testing.assert_array_equal(fuse(views, t, Answers(share)), views[int(t)].colour[..., :3])


def test_towards_the_ends_its_word_counts_less_and_less():
    views = pair()
    changes = [np.abs(fuse(views, t, Answers(0.2)) - geometric(views, t)).max() for t in (1e-3, 0.01, 0.03, 0.1, 0.3)]
    assert changes[:4] == sorted(changes[:4])
    assert changes[0] < 1e-3
    assert changes[-1] > 0.25


@pytest.mark.parametrize("size", [(64, 128), (128, 256), (72, 144)])
def test_candidates_take_their_share_of_every_pixel_holes_included(size):
    """Both photographs are grey of one kind each; what is hardly wanted is left away."""
    views = [asked(view, colour) for view, colour in zip(pair(size, holes=0.5), (0.25, 0.75), strict=True)]
    shares = np.array([0.3, 0.2, 0.1, 0.02], np.float32)[:, None, None]
    plain, mixed = geometric(views, 0.5), fuse(views, 0.5, Answers(shares))
    first, second = 0.3 + 0.1, 0.2
    expected = (1 - first - second) * plain + first * 0.25 + second * 0.75
    np.testing.assert_allclose(mixed, expected, atol=1e-5)


def test_shares_are_carried_to_the_frame_across_the_seam():
    """Those of one column of the network beside the seam, against a linear interpolation of it."""
    size, shares = (128, 256), np.zeros((4, ROWS, 2 * ROWS), np.float32)
    shares[0, :, 0] = 0.5
    views = [asked(view, 1.0) for view in pair(size, holes=0.0)]
    plain, mixed = (image[..., 0] for image in (geometric(views, 0.5), fuse(views, 0.5, Answers(shares))))
    position = (np.arange(256) + 0.5) / 4 - 0.5
    share = 0.5 * np.maximum(0, 1 - np.abs((position + 32) % 64 - 32))
    np.testing.assert_allclose(mixed, plain + share * (1 - plain), atol=1e-5)


def test_means_over_blocks_count_what_is_seen_by_its_worth():
    view = rendering(3, (40, 72), holes=0.4)
    coarse, rho = np.empty((12, 20, 4), np.float32), np.empty((12, 20), np.float32)
    downsample_rows(view.colour[:20], view.inverse_depth[:20], coarse, rho, 0, 40)
    downsample_rows(view.colour[20:], view.inverse_depth[20:], coarse, rho, 20, 40)
    for i in range(12):
        for j in range(20):
            block = np.s_[i * 40 // 12 : (i + 1) * 40 // 12, j * 72 // 20 : (j + 1) * 72 // 20]
            weight = view.colour[block][..., 3].astype(float)
            if weight.sum() == 0:
                assert (coarse[i, j] == 0).all()
                assert rho[i, j] == -1
                continue
            np.testing.assert_allclose(coarse[i, j, 3], weight.mean(), rtol=1e-5)
            expected = (view.colour[block][..., :3] * weight[..., None]).sum((0, 1)) / weight.sum()
            np.testing.assert_allclose(coarse[i, j, :3], expected, rtol=1e-5)
            expected_rho = (np.maximum(view.inverse_depth[block], 0) * weight).sum() / weight.sum()
            np.testing.assert_allclose(rho[i, j], expected_rho, rtol=1e-5)


def test_of_large_blocks_every_second_row_and_column_is_enough_for_a_mean():
    view = rendering(4, (64, 128), holes=0.4)
    coarse, rho = np.empty((8, 16, 4), np.float32), np.empty((8, 16), np.float32)
    downsample_rows(view.colour, view.inverse_depth, coarse, rho, 0, 64)
    some, some_rho = np.empty_like(coarse), np.empty_like(rho)
    downsample_rows(view.colour[::2, ::2].copy(), view.inverse_depth[::2, ::2].copy(), some, some_rho, 0, 32)
    np.testing.assert_array_equal(coarse, some)
    np.testing.assert_array_equal(rho, some_rho)


def enlarged(view):
    """Every pixel as a block, so that means over blocks are what it was."""
    rho, colour = (x.repeat(CANDIDATE_SCALE, 0).repeat(CANDIDATE_SCALE, 1) for x in (view.inverse_depth, view.colour))
    return asked(Layer.from_arrays(rho, colour, view.target_from_source))


def test_the_planes_are_what_they_are_said_to_be():
    """Written out in NumPy from the definitions, at the size of the renderings."""
    (first, second), t, size = pair((ROWS, 2 * ROWS)), 0.3, (ROWS, 2 * ROWS)
    finer = [enlarged(view) for view in (first, second)]
    rule, source_samplers = BlendRule.at(t), (first.source_sampler, second.source_sampler)
    planes, _ = InputBuilder(size, LayerPairShader(SIZE, 1))(LayerPair(*finer), rule, source_samplers)
    a, b = seen((first, second))
    assert planes.shape == (INPUT_CHANNELS + CANDIDATE_CHANNELS, *size)
    directions = pixel_directions(*size)
    weights = []
    for view, share in ((first, 1 - t), (second, t)):
        away = directions - np.maximum(view.inverse_depth, 0)[..., None] * view.target_from_source.position
        weights.append(share * view.colour[..., 3] * ((away**2).sum(-1) + 1e-8) ** -1.5)
    rhos = [np.maximum(view.inverse_depth, 0).astype(float) for view in (first, second)]
    gap = (rhos[0] - rhos[1]) / (np.maximum(*rhos) * 0.06 + 1e-9)
    surface_confidence = np.where(gap > 0, first.colour[..., 3], second.colour[..., 3])
    rest = 1 - np.minimum(1, 4 * surface_confidence) * (1 - np.maximum(np.exp(-(gap**2)), 0.003))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(weights[0] / weights[1]) + np.where(gap > 0, -np.log(rest), np.log(rest))
    np.testing.assert_allclose(planes[channel.LOG_WEIGHT_RATIO][a & b], np.clip(ratio / 8, -1, 1)[a & b], atol=1e-3)
    np.testing.assert_allclose(planes[channel.DEPTH_GAP][a & b], np.clip(gap / 4, -1, 1)[a & b], atol=1e-4)
    assert not planes[[channel.LOG_WEIGHT_RATIO, channel.DEPTH_GAP]][:, ~(a & b)].any()
    np.testing.assert_array_equal(planes[channel.SEEN_MASKS : channel.SEEN_MASKS + 2], np.stack([a, b]))
    baseline = np.linalg.norm(first.target_from_source.position - second.target_from_source.position)
    for k, view in enumerate((first, second)):
        colour = planes[(channel.FIRST_RGB, channel.SECOND_RGB)[k] :][:3].transpose(1, 2, 0)
        np.testing.assert_allclose(colour, view.colour[..., :3], atol=1e-6)
        np.testing.assert_allclose(planes[channel.BLEND_WEIGHTS + k], view.colour[..., 3], atol=1e-6)
        np.testing.assert_allclose(planes[channel.SQRT_INVERSE_DEPTHS + k], np.sqrt(rhos[k] * baseline), atol=1e-5)
    difference = np.sqrt(((first.colour - second.colour)[..., :3] ** 2).mean(-1))
    sure = a & b & (difference > 0.06)
    doubt = disagreement_mask(np.where(a & b, gap, 0).astype(np.float32))
    np.testing.assert_allclose(planes[channel.RELEVANCE][sure], doubt[sure], atol=1e-5)
    assert (planes[channel.RELEVANCE][~a & ~b] == 1).all()
    assert (planes[channel.RELEVANCE][a ^ b] == 0).all()
    np.testing.assert_allclose(planes[channel.PATH_POSITION], 2 * t - 1)
    np.testing.assert_allclose(planes[channel.LATITUDE], directions[..., 1], atol=1e-6)
    np.testing.assert_allclose(
        planes[channel.FUSED_RGB : channel.FUSED_RGB + 3].transpose(1, 2, 0), geometric((first, second), t), atol=1e-5
    )


def test_doubt_is_where_distances_disagree_and_around_there():
    """Against the definition, column by column around the seam."""
    gap = np.zeros((32, 64), np.float32)
    gap[10, 62], gap[25, 30] = 3.0, -0.5
    doubt = disagreement_mask(gap)
    near = np.zeros_like(gap)
    for row, col in ((10, 62), (25, 30)):
        for i in range(row - 4, row + 5):
            for j in range(col - 4, col + 5):
                near[i, j % 64] = max(near[i, j % 64], 1 - np.exp(-(gap[row, col] ** 2)))
    wrapped = np.pad(np.pad(near, ((2, 2), (0, 0)), mode="edge"), ((0, 0), (2, 2)), mode="wrap")
    mean = sum(wrapped[i : i + 32, j : j + 64] for i in range(5) for j in range(5)) / 25
    np.testing.assert_allclose(doubt, mean, atol=1e-6)
    np.testing.assert_array_equal(disagreement_mask(np.roll(gap, 7, axis=1)), np.roll(doubt, 7, axis=1))


def test_the_network_is_not_asked_where_it_has_no_say():
    view = rendering(1, holes=0.0)
    same = asked(
        Layer.from_arrays(view.inverse_depth.copy(), view.colour.copy(), Pose(np.eye(3), np.array([0.0, 0.0, -0.5])))
    )
    small = (32, 64)
    cases = {
        "both show the same": ((view, same), 0.5),
        "an end of the way": (pair(), 0.0),
        "one place": ((rendering(1), rendering(2)), 0.5),
        "tiny frames": (pair(small), 0.5),
    }
    for name, (views, t) in cases.items():
        network = Answers(0.2)
        np.testing.assert_array_equal(fuse(views, t, network), geometric(views, t), err_msg=name)
        assert not network.shown, name


@pytest.mark.parametrize(
    ("size", "expected"),
    [((2048, 4096), (128, 256)), ((128, 256), (64, 128)), ((120, 240), (32, 64)), ((63, 126), None)],
)
def test_the_size_that_the_network_works_at(size, expected):
    assert network_size(size, 128) == expected


def test_the_number_of_threads_does_not_show():
    views = pair((64, 128))
    shares = np.random.default_rng(0).uniform(0.0, 0.25, (4, 32, 64))
    one, three = (fuse(views, 0.4, Answers(shares), threads) for threads in (1, 3))
    np.testing.assert_array_equal(one, three)


def test_nothing_pops_up_along_the_way():
    """The network's answer being constant, the picture is a continuous function of the way, ends included."""
    views = pair()
    for t in (0.0, 0.001, 0.03, 0.0999, 0.5, 0.9, 0.97, 0.9989):
        now, soon = (fuse(views, place, Answers(0.2)) for place in (t, t + 1e-4))
        assert np.abs(soon - now).max() < 0.01, t
