"""Warp candidates: hypotheses, channels, how they are mixed in; and the paper's fusion, whose picture is the frame."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from fusion_samples import plain_sampler
from test_residual_fuser import copy, geometric, pair

from omnisyn_cli.baselines import direct_fuser
from omnisyn_cli.baselines.direct_fuser import SIZE_MULTIPLE, DirectFuser
from omnisyn_cli.fusion import warp_candidates
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays
from omnisyn_cli.fusion.exposure_curve import ExposureCurve
from omnisyn_cli.fusion.input_channels import INPUT_CHANNELS, fusion_input_channels
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.fusion.photometry import ExposureMatcher
from omnisyn_cli.fusion.residual import downsampled_pair
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.networks.fusion import FUSION_VARIANTS
from omnisyn_cli.training.losses import network_inputs
from omnisyn_cli.types import Layer, SourceSampler

SIZE = (32, 64)


def shown(rho, colour=0.5, size=SIZE):
    rho = np.broadcast_to(np.float32(rho), size).copy()
    return LayerArrays(
        np.full((*size, 3), colour, np.float32), (rho >= 0).astype(np.float32), rho, np.zeros(3, np.float32)
    )


def test_the_nearest_and_the_farthest_surface_are_looked_for_around_every_pixel_and_over_the_seam():
    first, second = np.full(SIZE, 0.3), np.full(SIZE, -1.0)
    first[10, 63], second[20, 30] = 0.9, 0.1
    farthest, nearest = warp_candidates.depth_hypotheses(shown(first), shown(second))
    row, col = np.indices(SIZE)
    by_near = (np.abs(row - 10) <= warp_candidates.HYPOTHESIS_WINDOW_RADIUS) & (
        np.abs((col - 63 + 32) % 64 - 32) <= warp_candidates.HYPOTHESIS_WINDOW_RADIUS
    )
    by_far = (np.abs(row - 20) <= warp_candidates.HYPOTHESIS_WINDOW_RADIUS) & (
        np.abs(col - 30) <= warp_candidates.HYPOTHESIS_WINDOW_RADIUS
    )
    np.testing.assert_array_equal(nearest, np.where(by_near, np.float32(0.9), np.float32(0.3)))
    np.testing.assert_array_equal(farthest, np.where(by_far, np.float32(0.1), np.float32(0.3)))


def test_where_nothing_is_seen_at_all_points_are_infinitely_far():
    assert not warp_candidates.depth_hypotheses(shown(-1.0), shown(-1.0)).any()


def test_planes_say_at_which_depths_photographs_are_looked_up():
    """The second surface is everywhere, the first one on the left only."""
    half_seen = np.where(np.arange(64) < 32, 0.2, -1.0)
    samplers = (plain_sampler(0.25), plain_sampler(0.75))
    planes = warp_candidates.make_warp_candidates(shown(half_seen), shown(0.4), samplers, 4.0, threads=1).channels
    assert planes.shape == (warp_candidates.CANDIDATE_CHANNELS, 16, 32)
    farthest, nearest = planes[warp_candidates.HYPOTHESIS_DEPTHS - INPUT_CHANNELS :][:2]
    np.testing.assert_allclose(farthest[:, 4:12], np.sqrt(0.2 * 4), atol=1e-6)
    np.testing.assert_allclose(farthest[:, 20:28], np.sqrt(0.4 * 4), atol=1e-6)
    np.testing.assert_allclose(nearest, np.sqrt(0.4 * 4), atol=1e-6)


@pytest.mark.parametrize("threads", [1, 3])
def test_planes_are_means_over_blocks_of_what_is_seen(threads):
    rng = np.random.default_rng(0)
    colours, gaps = rng.random((2, *SIZE, 4), np.float32), rng.uniform(-0.3, 0.3, (2, *SIZE)).astype(np.float32)
    source_samplers = tuple(
        SourceSampler(lambda *_: None, lambda points, k=k: colours[k], lambda points, least, k=k: gaps[k])
        for k in (0, 1)
    )
    first, second = shown(np.where(rng.random(SIZE) < 0.5, 0.2, -1.0)), shown(0.4)
    planes = warp_candidates.make_warp_candidates(first, second, source_samplers, 4.0, threads).channels

    def means(values, counts=True):
        blocks = np.where(counts, values, 0.0).reshape(16, 2, 32, 2).sum(axis=(1, 3))
        return blocks / np.maximum(np.broadcast_to(counts, SIZE).reshape(16, 2, 32, 2).sum(axis=(1, 3)), 1)

    told, seen, half = np.clip(gaps / 0.24, -1, 1), first.inverse_depth >= 0, np.abs(colours - 0.5)[..., :3].mean(-1)
    expected = {
        warp_candidates.CROSS_VIEW: [
            *(means(colours[1, ..., k], seen) for k in range(3)),
            *(means(each, seen) for each in (half[1], np.maximum(told[1], 0), np.maximum(-told[1], 0))),
            *(means(colours[0, ..., k]) for k in range(3)),
            *(means(each) for each in (half[0], np.maximum(told[0], 0), np.maximum(-told[0], 0))),
        ],
        warp_candidates.CANDIDATE_RGB: 2 * [means(colours[view, ..., k]) for view in (0, 1) for k in range(3)],
        warp_candidates.HYPOTHESIS_OCCLUSION: 2 * [means(each) for each in told],
        warp_candidates.CANDIDATE_DIFFERENCE: 2 * [means(np.abs(colours[0] - colours[1])[..., :3].mean(-1))],
    }
    for channel, values in expected.items():
        np.testing.assert_allclose(planes[channel - INPUT_CHANNELS :][: len(values)], values, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
@pytest.mark.parametrize("threads", [1, 3])
def test_points_are_those_of_the_hypotheses_and_masked_photographs_have_no_share(dtype, threads):
    """The first photograph answers with the inverse depth it is asked about, the second one has nothing to show."""
    rng, size = np.random.default_rng(0), (128, 256)
    hypotheses = rng.random((2, 64, 128), np.float32)

    def tell(points, top, out):
        out[..., :3] = np.maximum(points, 0)[..., None]
        out[..., 3] = points >= 0

    def hide(points, top, out):
        out[:] = 0.0

    source_samplers = tuple(
        SourceSampler(paint, lambda points: points, lambda points, least: points) for paint in (tell, hide)
    )
    shares = np.zeros((4, 32, 64), np.float32)
    shares[0, :16], shares[2, 16:], shares[3] = 0.5, 0.25, 0.5
    image = np.full((*size, 3), 0.5, np.float32)
    image = image if dtype == np.float32 else np.rint(255 * image).astype(np.uint8)
    warp_candidates.WarpCandidates(np.empty(0), hypotheses, source_samplers).mix_in(shares, image, threads)
    found = image if dtype == np.float32 else image / 255
    wide = hypotheses.repeat(2, 1).repeat(2, 2)[..., None]
    for rows, share, which in ((np.s_[:60], 0.5, 0), (np.s_[68:], 0.25, 1)):
        expected = np.broadcast_to((1 - share) * 0.5 + share * wide[which], (*size, 3))
        np.testing.assert_allclose(found[rows], expected[rows], atol=1e-5 if dtype == np.float32 else 1.01 / 255)


def test_candidates_are_both_photographs_at_both_surfaces():
    """Each photograph answers with the inverse depth it is asked about, or with twice that."""

    def tell(factor):
        def paint(points, top, out):
            out[..., :3], out[..., 3] = factor * points[..., None], 1.0

        return SourceSampler(paint, lambda points: points, lambda points, least: points)

    hypotheses = np.random.default_rng(0).random((2, 32, 64), np.float32)
    found = warp_candidates.WarpCandidates(np.empty(0), hypotheses, (tell(1.0), tell(2.0))).candidates((64, 128))
    wide = hypotheses.repeat(2, 1).repeat(2, 2)
    for candidate, (surface, factor) in zip(found, ((0, 1), (0, 2), (1, 1), (1, 2)), strict=True):
        np.testing.assert_allclose(candidate[..., 0], factor * wide[surface], rtol=1e-6)


def test_photographs_are_asked_in_the_exposure_of_the_frame():
    """Candidates look as the rendering of the same view does, half way between two exposures."""
    colour = np.float32([0.5, 0.5, 0.5, 1.0]) * np.ones((*SIZE, 1), np.float32)
    views = [
        replace(
            Layer.from_arrays(np.zeros(SIZE, np.float32), colour, Pose.identity()), source_sampler=plain_sampler(0.5)
        )
        for _ in range(2)
    ]
    points, rows = np.zeros(SIZE, np.float32), np.empty((8, SIZE[1], 4), np.float32)
    for view in ExposureMatcher(ExposureCurve(np.ones((3, 6))))(*views, 0.5):
        assert abs(view.colour[0, 0, 0] - 0.5) > 0.05
        np.testing.assert_allclose(view.source_sampler.sample(points), view.colour, atol=1e-6)
        view.source_sampler.sample_rows(points[4:12], 4, rows)
        np.testing.assert_allclose(rows, view.colour[4:12], atol=1e-6)


class RecordingNetwork:
    """Stands in for the network: answers with a picture, or with the first view; remembers what it was shown."""

    def __init__(self, picture=None):
        self.picture, self.shown = picture, []

    def __call__(self, channels):
        self.shown.append(channels.copy())
        return channels[:3].copy() if self.picture is None else self.picture


def predict(views, network, t=0.5, threads=1):
    size = views[0].inverse_depth.shape
    return DirectFuser(size, network, threads)(*map(copy, views), t).copy()


@pytest.mark.parametrize(("size", "most"), [((64, 128), 1024), ((128, 256), 64), ((100, 200), 1024)])
def test_the_network_sees_what_it_was_trained_with(monkeypatch, size, most):
    """Against the planes that training takes from a pool, which another module makes."""
    monkeypatch.setattr(direct_fuser, "MAX_NETWORK_ROWS", most)
    views, network = pair(size), RecordingNetwork()
    predict(views, network)
    first, second = downsampled_pair(LayerPair(*views), (64, 128), LayerPairShader(size, 1))
    rule = BlendRule.at(0.5)
    recorded = fusion_input_channels(first, second, rule, 1.0, lambda image, weight: image)
    assert len(recorded) == INPUT_CHANNELS
    expected = network_inputs(FUSION_VARIANTS["paper-narrow"], torch.from_numpy(recorded)[None])[0].numpy()
    np.testing.assert_array_equal(network.shown[0], expected)
    assert {0.0, 1.0} == set(np.unique(network.shown[0][6:]))


def test_at_its_own_size_the_picture_is_the_frame_within_the_range_of_colours():
    picture = np.random.default_rng(0).uniform(-0.5, 1.5, (3, 64, 128)).astype(np.float32)
    found = predict(pair((64, 128)), RecordingNetwork(picture))
    np.testing.assert_array_equal(found, picture.transpose(1, 2, 0).clip(0, 1))


def test_it_paints_from_the_first_frame_to_the_last():
    """Nothing fades towards the ends: the authors' network is not told how far the way is."""
    views, picture = pair((64, 128)), np.full((3, 64, 128), 0.25, np.float32)
    for t in (0.002, 0.5, 0.998):
        assert (predict(views, RecordingNetwork(picture), t) == 0.25).all()


def test_larger_frames_are_enlarged_across_the_seam_and_the_poles(monkeypatch):
    monkeypatch.setattr(direct_fuser, "MAX_NETWORK_ROWS", 64)
    picture = np.random.default_rng(1).random((64, 128, 3), np.float32)
    found = predict(pair((200, 400)), RecordingNetwork(picture.transpose(2, 0, 1)))
    expected = sample_bilinear(picture.astype(float), pixel_directions(200, 400))
    np.testing.assert_allclose(found, expected, atol=0.02)  # OpenCV knows 32 places between two pixels
    assert np.abs(found - expected).mean() < 0.005


def test_from_one_place_views_are_cross_faded_without_the_network():
    first, second = pair((64, 128))
    views = first, Layer.from_arrays(second.inverse_depth, second.colour, first.target_from_source)
    network = RecordingNetwork()
    np.testing.assert_array_equal(predict(views, network), geometric(views, 0.5))
    assert network.shown == []


def test_frames_that_cannot_be_halved_often_enough_are_fused_by_rules():
    views, network = pair((SIZE_MULTIPLE // 2, SIZE_MULTIPLE)), RecordingNetwork()
    np.testing.assert_array_equal(predict(views, network), geometric(views, 0.5))
    assert network.shown == []


def test_threads_change_nothing():
    views = pair((96, 192))
    np.testing.assert_array_equal(predict(views, RecordingNetwork()), predict(views, RecordingNetwork(), threads=3))
