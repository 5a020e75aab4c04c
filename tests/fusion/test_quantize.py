"""Numbers become samples by rounding to the nearest, and what is out of range goes to its end."""

import numpy as np
import pytest

from omnisyn_cli.fusion.blend_kernels import quantize_rows


def quantized(values: np.ndarray, dtype: type = np.uint8) -> np.ndarray:
    image = np.repeat(np.asarray(values, np.float32)[None, :, None], 3, axis=2)
    out = np.zeros(image.shape, dtype)
    quantize_rows(image, np.float32(np.iinfo(dtype).max), out, 0, 1)
    assert (out == out[..., :1]).all()
    return out[0, :, 0]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_sample_survives_the_way_to_a_number_and_back(dtype: type) -> None:
    samples = np.arange(np.iinfo(dtype).max + 1)
    np.testing.assert_array_equal(quantized(samples / np.iinfo(dtype).max, dtype), samples)


def test_the_nearest_sample_is_taken() -> None:
    np.testing.assert_array_equal(
        quantized(np.array([0.49, 0.51, 1.49, 1.51, 254.49, 254.51]) / 255), [0, 1, 1, 2, 254, 255]
    )


def test_out_of_range_goes_to_the_ends() -> None:
    np.testing.assert_array_equal(
        quantized(np.array([-5, -1e-9, 1 + 1e-6, 7, np.inf, -np.inf])), [0, 0, 255, 255, 255, 0]
    )


def test_only_the_asked_rows_are_written() -> None:
    out = np.full((4, 2, 3), 9, np.uint8)
    quantize_rows(np.zeros((4, 2, 3), np.float32), np.float32(255), out, 1, 3)
    np.testing.assert_array_equal(out[:, 0, 0], [9, 0, 0, 9])
