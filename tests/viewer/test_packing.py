"""What is packed into a page is what was there, as exactly as its docstrings say."""

import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnisyn_cli.interpolation.viewer.packing import (
    NO_SURFACE_CODE,
    Blocks,
    confidence_codes,
    inverse_depth_codes,
    level_widths,
    packed_map,
    packed_mask,
    packed_photograph,
)
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.shade import make_confidence_map
from omnisyn_cli.render.texture import make_texture


def unpacked(packed: bytes, shape: tuple[int, int], dtype: type) -> np.ndarray:
    """As web/blocks.js does it: planes of bytes, then sums along rows and columns modulo the type."""
    planes = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(np.dtype(dtype).itemsize, -1)
    rest = np.ascontiguousarray(planes.T).view(f"<u{planes.shape[0]}").reshape(shape)
    return np.cumsum(np.cumsum(rest, axis=0, dtype=dtype), axis=1, dtype=dtype)


@given(st.integers(1, 9), st.integers(1, 9), st.sampled_from([np.uint8, np.uint16]), st.integers(0, 2**32 - 1))
def test_maps_come_back_exactly(rows: int, cols: int, dtype: type, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (rows, cols), dtype, endpoint=True)
    np.testing.assert_array_equal(unpacked(packed_map(values), (rows, cols), dtype), values)


def test_a_plane_takes_next_to_nothing() -> None:
    rows, cols = np.mgrid[:256, :512]
    assert len(packed_map((37 * rows + 11 * cols).astype(np.uint16))) < 1000


def test_inverse_depths_are_off_by_less_than_one_part_in_their_code() -> None:
    rho = np.geomspace(1e-5, 7.0, 4096, dtype=np.float32).reshape(64, 64)
    codes, peak = inverse_depth_codes(rho)
    decoded = peak * (codes / (NO_SURFACE_CODE - 1.0)) ** 2
    assert (np.abs(decoded - rho) <= rho / np.maximum(codes, 1) * 1.01).all()
    assert codes.max() == NO_SURFACE_CODE - 1
    assert peak == pytest.approx(7.0)


def test_infinitely_far_and_no_surface_have_codes_of_their_own() -> None:
    codes, peak = inverse_depth_codes(np.array([[0.0, -1e-9], [1e-7, 2.0]], np.float32))
    assert codes.tolist() == [[0, NO_SURFACE_CODE], [round(65534 * (1e-7 / peak) ** 0.5), 65534]]
    assert (inverse_depth_codes(np.zeros((2, 4), np.float32))[0] == 0).all()


def test_trust_is_that_of_the_renderer() -> None:
    rho = np.full((16, 32), 0.2, np.float32)
    rho[5:9, 10:14] = 1.0
    mesh = build_mesh(rho)
    codes = confidence_codes(mesh)
    assert codes is not None
    expected = make_confidence_map(mesh, make_texture(np.zeros((16, 32, 3), np.float32))).values.reshape(32, 65)[
        1:-1, 1:
    ]
    np.testing.assert_allclose((codes[1:-1] / 255.0) ** 2, expected, atol=0.004)
    assert confidence_codes(build_mesh(np.full((16, 32), 0.2, np.float32))) is None


def test_lossless_photographs_are_the_samples_and_others_nearly() -> None:
    samples = cv2.resize(np.random.default_rng(0).integers(0, 256, (8, 16, 3), np.uint8), (128, 64))
    for is_lossless, most in ((True, 0.0), (False, 6.0)):
        content, kind = packed_photograph(samples, is_lossless=is_lossless)
        decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert np.abs(decoded.astype(float) - samples).mean() <= most
        assert (kind["width"], kind["height"]) == (128, 64)
        assert kind["type"] == ("image/png" if is_lossless else "image/jpeg")


@pytest.mark.parametrize(
    ("width", "has_half", "widths"),
    [(64, True, [64]), (1152, True, [768, 1152]), (2302, True, [768, 2302]), (4096, True, [768, 2048, 4096]),
     (4096, False, [768, 4096])],
)  # fmt: skip
def test_photographs_have_levels_from_small_to_large(width: int, has_half: bool, widths: list[int]) -> None:
    assert level_widths(width, has_half=has_half) == widths


def test_a_preview_is_small_and_equal_blocks_are_kept_once(tmp_path: Path) -> None:
    blocks = Blocks(tmp_path)
    samples = cv2.resize(np.random.default_rng(0).integers(0, 256, (64, 128, 3), np.uint8), (1536, 768))
    levels = blocks.add_levels(samples, is_lossless=True)
    assert [(level["width"], level["height"], level["type"]) for level in levels] == [
        (768, 384, "image/jpeg"), (1536, 768, "image/png"),
    ]  # fmt: skip
    kept = [file.stat().st_size for file in sorted(tmp_path.iterdir())]
    assert kept[0] < 64_000
    assert blocks.add_levels(samples, is_lossless=True) == levels
    assert (len(blocks), blocks.size) == (2, sum(kept))


def test_masks_shrink_with_their_photographs() -> None:
    mask = np.ones((32, 64), bool)
    mask[16:] = False
    np.testing.assert_array_equal(packed_mask(mask, 64), np.where(mask, 255, 0))
    small = packed_mask(mask, 32)
    assert small.shape == (16, 32)
    np.testing.assert_array_equal(small, np.where(mask[::2, ::2], 255, 0))
