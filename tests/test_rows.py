"""When frames are made by rows is said of names as of what has them."""

from itertools import product

import numpy as np
import pytest

from omnisyn_cli.fusion import GeometricFuser
from omnisyn_cli.fusion.network import NetworkFuser
from omnisyn_cli.fusion.painting import PaintingFuser
from omnisyn_cli.presets import FUSIONS
from omnisyn_cli.render.renderer import RENDERERS, make_renderer
from omnisyn_cli.rows import LEAST_ROWS, are_frames_by_rows, row_makers

GRID = (4, 8)

SIZES = [(64, 128), (LEAST_ROWS - 1, 2 * LEAST_ROWS - 2), (LEAST_ROWS, 2 * LEAST_ROWS), (LEAST_ROWS + 1, 1796)]


def correct_nothing(planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(planes.shape[1:], np.float32), np.zeros((3, *planes.shape[1:]), np.float32)


def fuser_named(name: str, size: tuple[int, int]) -> GeometricFuser:
    made = {
        "geometric": GeometricFuser,
        "network": lambda at: NetworkFuser(at, correct_nothing),
        "painting": lambda at: PaintingFuser(at, lambda planes: planes[:3]),
    }
    return made[name](size)


@pytest.mark.parametrize("size", SIZES)
def test_names_tell_what_the_objects_do(size: tuple[int, int]) -> None:
    """Every renderer with every fusion, for frames on both sides of the least size and of an odd height."""
    image, inverse_depth = np.full((*GRID, 3), 0.5, np.float32), np.full(GRID, 0.2, np.float32)
    renderers = {name: make_renderer(name, image, None, inverse_depth, None, GRID) for name in RENDERERS}
    fusers = {name: fuser_named(name, size) for name in FUSIONS}
    for renderer, fusion in product(renderers, fusers):
        pair = (renderers[renderer], renderers[renderer])
        for is_rounded, is_judged in product((False, True), repeat=2):
            wanted = {"is_rounded": is_rounded, "is_judged": is_judged}
            found = row_makers(pair, fusers[fusion], **wanted)
            assert are_frames_by_rows(renderer, fusion, size, **wanted) == (found is not None)
            assert found is None or found == (*pair, fusers[fusion])


def test_large_rounded_frames_of_the_defaults_are_made_by_rows_and_no_others() -> None:
    size = (1024, 2048)
    assert are_frames_by_rows("mesh", "geometric", size, is_rounded=True, is_judged=False)
    assert not are_frames_by_rows("mesh", "geometric", size, is_rounded=False, is_judged=False)
    assert not are_frames_by_rows("mesh", "geometric", size, is_rounded=True, is_judged=True)
    assert not are_frames_by_rows("mesh", "network", size, is_rounded=True, is_judged=False)
    assert not are_frames_by_rows("points", "geometric", size, is_rounded=True, is_judged=False)


def test_both_surfaces_have_to_give_rows() -> None:
    image, inverse_depth = np.full((*GRID, 3), 0.5, np.float32), np.full(GRID, 0.2, np.float32)
    mesh, points = (make_renderer(name, image, None, inverse_depth, None, GRID) for name in ("mesh", "points"))
    fuser = GeometricFuser((1024, 2048))
    assert row_makers((mesh, mesh), fuser, is_rounded=True, is_judged=False)
    for mixed in ((mesh, points), (points, mesh)):
        assert row_makers(mixed, fuser, is_rounded=True, is_judged=False) is None
