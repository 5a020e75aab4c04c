"""Planes for fusion networks (:mod:`omnisyn_cli.fusion.input_channels`), made of renderings of any larger size."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays
from omnisyn_cli.fusion.downsample_kernels import downsample_rows
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.input_channels import fusion_input_channels
from omnisyn_cli.fusion.layer_pair import LayerPair, RowTileRunner
from omnisyn_cli.fusion.warp_candidates import FINER, WarpCandidates, make_warp_candidates
from omnisyn_cli.types import SourceSampler

__all__ = ["InputBuilder", "downsampled_pair"]

COARSE_ROWS = 4
"""That are reduced together."""


class InputBuilder:
    """Makes planes of one size from renderings of at least :data:`FINER` times that. Not shared between threads.

    Args:
        size: height and width of the planes.
        bands: of the renderings.
    """

    def __init__(self, size: tuple[int, int], bands: RowTileRunner) -> None:
        self.size, self._bands = size, bands
        self._filler = HoleFiller(size, bands.threads)

    def __call__(
        self, views: LayerPair, rule: BlendRule, source_samplers: tuple[SourceSampler, SourceSampler]
    ) -> tuple[Float32[np.ndarray, "planes height width"], WarpCandidates]:
        """Planes of two renderings, those of a second look among them.

        Args:
            views: both, and what is done to their colours.
            rule: at its place of the way.
            witnesses: of both.
        """
        fine = downsampled_pair(views, (FINER * self.size[0], FINER * self.size[1]), self._bands)
        first, second = (_halved(view) for view in fine)
        baseline = float(np.linalg.norm(first.offset - second.offset))
        planes = fusion_input_channels(first, second, rule, baseline, self._filled)
        look = make_warp_candidates(*fine, source_samplers, baseline, self._bands.threads)
        return np.concatenate([planes, look.planes]), look

    def _filled(self, image: np.ndarray, weight: np.ndarray) -> np.ndarray:
        self._filler(image, weight)
        return image


def downsampled_pair(views: LayerPair, size: tuple[int, int], bands: RowTileRunner) -> tuple[LayerArrays, LayerArrays]:
    """Two renderings at a smaller size: means over blocks of what is seen, by its weight; colours are within [0, 1]."""
    (height, _), (rows, _) = bands.size, size
    colours, rhos = np.empty((2, *size, 4), np.float32), np.empty((2, *size), np.float32)
    renderings = (views.first, views.second)

    def reduce(top: int, bottom: int, *shown: np.ndarray) -> None:
        for view, colour, coarse, rho in zip(renderings, shown, colours, rhos, strict=True):
            downsample_rows(colour, view.inverse_depth[top:bottom], coarse, rho, top, height)

    bands(views, reduce, [*(i * height // rows for i in range(0, rows, COARSE_ROWS)), height])
    first, second = (
        LayerArrays(colour[..., :3], colour[..., 3], rho, view.target_from_source.position.astype(np.float32))
        for view, colour, rho in zip(renderings, colours, rhos, strict=True)
    )
    return first, second


def _halved(view: LayerArrays) -> LayerArrays:
    """The same at half the size."""
    rows, cols = view.weight.shape
    size = (rows // FINER, cols // FINER)
    colour, rho = np.empty((*size, 4), np.float32), np.empty(size, np.float32)
    weighted = np.concatenate([view.colour, view.weight[..., None]], axis=-1)
    downsample_rows(weighted, view.inverse_depth, colour, rho, 0, rows)
    return replace(view, colour=colour[..., :3], weight=colour[..., 3], inverse_depth=rho)
