import numpy as np
import pytest
import torch

from omnisyn_cli.networks.layers import ResidualBlock, WrappedConv, initialise, wrap_columns


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
    expand = block(torch.randn(1, 32, 16, 32)).std()
    assert 0.3 < expand < 30
