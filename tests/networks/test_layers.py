import numpy as np
import pytest
import torch
from torch.nn import functional

from omnisyn_cli.networks.layers import (
    ResidualBlock,
    WrappedConv,
    convex_upsample,
    coordinate_channels,
    initialise,
    normalised_patches,
    unit_groups,
    wrap_columns,
)


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


def test_wrapped_columns_are_those_of_numpy():
    x = torch.rand(2, 3, 4, 8)
    expected = np.pad(x.numpy(), ((0, 0), (0, 0), (0, 0), (2, 3)), mode="wrap")
    np.testing.assert_array_equal(wrap_columns(x, 2, 3).numpy(), expected)
    assert wrap_columns(x, 0, 0) is x


def test_a_convolution_does_not_know_where_the_seam_is():
    x = torch.rand(1, 3, 8, 16)
    block = ResidualBlock(3, 5)
    torch.testing.assert_close(block(x.roll(5, -1)), block(x).roll(5, -1))


def test_a_strided_convolution_commutes_with_rolls_by_its_stride():
    x, convolution = torch.rand(1, 3, 8, 16), WrappedConv(3, 5, (2, 2))
    assert convolution(x).shape == (1, 5, 4, 8)
    torch.testing.assert_close(convolution(x.roll(6, -1)), convolution(x).roll(3, -1))


def test_beyond_the_poles_a_convolution_sees_zeros():
    convolution = WrappedConv(1, 1)
    torch.nn.init.ones_(convolution.weight)
    torch.nn.init.zeros_(convolution.bias)
    rows = convolution(torch.ones(1, 1, 3, 8))[0, 0, :, 0]
    torch.testing.assert_close(rows, torch.tensor([6.0, 9.0, 6.0]))


def test_initialisation_keeps_the_size_of_signals():
    block = torch.nn.Sequential(*(ResidualBlock(32, 32) for _ in range(6)))
    initialise(block)
    spread = block(torch.randn(1, 32, 16, 32)).std()
    assert 0.3 < spread < 30


def test_coordinates_are_those_of_the_convention_and_do_not_tell_a_mirror_image():
    grid = coordinate_channels(torch.zeros(2, 7, 8, 16))
    assert grid.shape == (2, 2, 8, 16)
    assert torch.all(grid[:, 0].diff(dim=1) > 0)
    torch.testing.assert_close(grid[0, 0, :, 0], -grid[0, 0, :, 0].flip(0))
    torch.testing.assert_close(grid, grid.flip(-1))
    assert grid[0, 1, 0].argmax() in (7, 8)  # the ground, azimuth 0, is in the middle


def test_convex_upsampling_stays_within_the_neighbourhood_and_keeps_constants():
    x = torch.rand(2, 2, 4, 8)
    fine = convex_upsample(x, torch.randn(2, 36, 4, 8))
    assert fine.shape == (2, 2, 8, 16)
    repeated = torch.cat([x[:, :, :1], x, x[:, :, -1:]], dim=2)
    highest = functional.max_pool2d(wrap_columns(repeated, 1, 1), 3, 1)
    lowest = -functional.max_pool2d(-wrap_columns(repeated, 1, 1), 3, 1)
    for i in range(2):
        for j in range(2):
            assert torch.all(fine[:, :, i::2, j::2] <= highest + 1e-6)
            assert torch.all(fine[:, :, i::2, j::2] >= lowest - 1e-6)
    torch.testing.assert_close(
        convex_upsample(torch.full((1, 1, 4, 8), 0.3), torch.randn(1, 36, 4, 8)), torch.full((1, 1, 8, 16), 0.3)
    )


@pytest.mark.parametrize(("neighbour", "shift"), [(4, (0, 0)), (3, (0, 1)), (5, (0, -1)), (7, (-1, 0))])
def test_convex_upsampling_can_choose_a_single_neighbour(neighbour, shift):
    x = torch.rand(1, 1, 6, 8)
    logits = torch.zeros(1, 9, 4, 6, 8)
    logits[:, neighbour] = 100.0
    expected = x.roll(shift, (-2, -1)).repeat_interleave(2, -1).repeat_interleave(2, -2)
    inner = slice(2, -2)
    torch.testing.assert_close(convex_upsample(x, logits.view(1, 36, 6, 8))[:, :, inner], expected[:, :, inner])


def test_groups_have_length_one():
    grouped = unit_groups(torch.randn(2, 8, 3, 4), 2)
    assert grouped.shape == (2, 2, 4, 3, 4)
    torch.testing.assert_close(grouped.norm(dim=2), torch.ones(2, 2, 3, 4))


def test_patches_ignore_brightness_and_contrast():
    image = torch.rand(1, 3, 32, 64)
    plain, changed = normalised_patches(image, 8, (4, 4)), normalised_patches(0.3 * image + 0.5, 8, (4, 4))
    assert plain.shape == (1, 64, 8, 16)
    similarity = (plain * changed).sum(dim=1)
    assert similarity.min() > 0.85
    assert (plain * plain.roll(3, -1)).sum(dim=1).abs().mean() < 0.3


def test_patches_wrap_at_the_seam_and_plain_ones_match_nothing():
    image = torch.rand(1, 3, 16, 32)
    rolled = normalised_patches(image.roll(8, -1), 8, (2, 4))
    torch.testing.assert_close(rolled, normalised_patches(image, 8, (2, 4)).roll(2, -1))
    assert torch.all(normalised_patches(torch.full((1, 3, 16, 32), 0.7), 8, (4, 4)).abs() < 1e-4)
