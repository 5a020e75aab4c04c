"""Makes all input channels of a fusion network from layers of any larger size."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays
from omnisyn_cli.fusion.downsample_kernels import downsample_rows
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.input_channels import fusion_input_channels
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.fusion.warp_candidates import CANDIDATE_SCALE, WarpCandidates, make_warp_candidates
from omnisyn_cli.types import SourceSampler

TILE_COARSE_ROWS = 4  # rows of the smaller size that are averaged together. Set by hand.


class InputBuilder:
    """Makes channels of a size from layers :data:`CANDIDATE_SCALE` times that or larger. Not shared between threads."""

    def __init__(self, size: tuple[int, int], tiles: LayerPairShader) -> None:
        self.size, self._tiles = size, tiles
        self._filler = HoleFiller(size, tiles.threads)

    def __call__(
        self, layers: LayerPair, rule: BlendRule, source_samplers: tuple[SourceSampler, SourceSampler]
    ) -> tuple[Float32[np.ndarray, "channels height width"], WarpCandidates]:
        """The channels of both parts, and the candidates that the network chooses from."""
        fine = downsampled_pair(layers, (CANDIDATE_SCALE * self.size[0], CANDIDATE_SCALE * self.size[1]), self._tiles)
        first, second = (_halve(layer) for layer in fine)
        baseline = float(np.linalg.norm(first.offset - second.offset))
        channels = fusion_input_channels(first, second, rule, baseline, self._fill)
        candidates = make_warp_candidates(*fine, source_samplers, baseline, self._tiles.threads)
        return np.concatenate([channels, candidates.channels]), candidates

    def _fill(self, image: np.ndarray, weight: np.ndarray) -> np.ndarray:
        self._filler(image, weight)
        return image


def downsampled_pair(
    layers: LayerPair, size: tuple[int, int], tiles: LayerPairShader
) -> tuple[LayerArrays, LayerArrays]:
    """Both layers at a smaller size: weighted block means of what is seen; colours are clipped to [0, 1]."""
    (height, _), (rows, _) = tiles.size, size
    colours, rhos = np.empty((2, *size, 4), np.float32), np.empty((2, *size), np.float32)
    both = (layers.first, layers.second)

    def downsample(top: int, bottom: int, *shaded: np.ndarray) -> None:
        for layer, colour, coarse, rho in zip(both, shaded, colours, rhos, strict=True):
            downsample_rows(colour, layer.inverse_depth[top:bottom], coarse, rho, top, height)

    tiles(layers, downsample, [*(i * height // rows for i in range(0, rows, TILE_COARSE_ROWS)), height])
    first, second = (
        LayerArrays(colour[..., :3], colour[..., 3], rho, layer.target_from_source.position.astype(np.float32))
        for layer, colour, rho in zip(both, colours, rhos, strict=True)
    )
    return first, second


def _halve(layer: LayerArrays) -> LayerArrays:
    """The layer at the size of the channels."""
    rows, cols = layer.weight.shape
    size = (rows // CANDIDATE_SCALE, cols // CANDIDATE_SCALE)
    colour, rho = np.empty((*size, 4), np.float32), np.empty(size, np.float32)
    weighted = np.concatenate([layer.colour, layer.weight[..., None]], axis=-1)
    downsample_rows(weighted, layer.inverse_depth, colour, rho, 0, rows)
    return replace(layer, colour=colour[..., :3], weight=colour[..., 3], inverse_depth=rho)
