"""Point cloud rendering, which the paper compares meshes with: every pixel of a panorama is a small disc.

The points are what the mesh shows at its own place, so that none floats between two surfaces. They never stretch: where
the camera comes closer they come apart and leave holes.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from omnisyn_cli.baselines.soft_points import blend, list_visible
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.renderer import MeshRenderer, RendererInputs
from omnisyn_cli.types import Layer

RADIUS_ROWS = 1.0  # of a disc: 0.71 closes a surface that is seen from where it was taken
POINTS_PER_PIXEL = 8  # that are blended at most; more are there only where the camera has moved away


class PointRenderer:
    """See :class:`omnisyn_cli.render.renderer.Renderer`: a disc for every pixel of a panorama of the frames' size."""

    shades_on_demand: ClassVar[bool] = False

    def __init__(self, inputs: RendererInputs) -> None:
        self._mesh, self._threads = MeshRenderer(replace(inputs, path_end=None)), inputs.threads
        seen = self._mesh(Pose.identity())
        self._features, self._inverse_depth = seen.colour, seen.inverse_depth.copy()
        self._mask = self._features[..., 3] > 0.0

    def __call__(self, target_from_source: Pose) -> Layer:
        """See :class:`omnisyn_cli.render.renderer.Renderer`."""
        lists = list_visible(
            [self._inverse_depth], [target_from_source], self._mask.shape, [self._mask], radius=RADIUS_ROWS,
            most=POINTS_PER_PIXEL, threads=self._threads,
        )  # fmt: skip
        features = np.concatenate([self._features.reshape(-1, 4), lists.points[:, 3:]], axis=-1)
        blended = blend(lists, features, radius=RADIUS_ROWS, threads=self._threads)
        is_seen = blended[..., -1:] > 0.0
        seen = np.where(is_seen, blended[..., :-1] / np.where(is_seen, blended[..., -1:], 1.0), 0.0)
        inverse_depth = np.where(is_seen[..., 0], seen[..., 4], np.float32(-1.0))
        layer = Layer.from_arrays(inverse_depth, np.ascontiguousarray(seen[..., :4]), target_from_source)
        return replace(layer, source_sampler=self._mesh.source_sampler(target_from_source))
