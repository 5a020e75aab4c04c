"""A panorama as a cloud of points: the comparison that assumes no surface (as SynSin does).

Every source pixel is a disc on the target's sphere. A disc of constant angle grows as 1/sin(polar angle) in columns,
wraps at the seam and reaches over the poles by itself. The nearest disc wins; among the discs of one surface (those
whose inverse depths differ by a few per cent) the one that is centred closest to the pixel, so that a surface keeps its
texture. Points never stretch: where the camera comes closer, they come apart and leave holes.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import direction_tables, pixel_directions, pixel_scale
from omnisyn_cli.render.mesh import Cut, build_mesh
from omnisyn_cli.render.point_kernels import choose_points, find_nearest, project_points
from omnisyn_cli.render.rasterize import Fragments, rasterize
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.render.trust import LEAST
from omnisyn_cli.render.witness import AskedPanorama
from omnisyn_cli.runtime.threads import run_bands
from omnisyn_cli.types import Rendering

RADIUS = 1.0
"""Radius of a disc in source pixels: 0.71 closes a surface seen from where it was taken."""

LEAST_RADIUS = 0.71
"""Radius in target pixels that lets no disc fall between pixel centres."""

SAME_SURFACE = 0.95
"""Points whose inverse depth is at least this share of the nearest one's belong to its surface."""


def render_points(
    image: Float[np.ndarray, "height width 4"],
    inverse_depth: Float[np.ndarray, "height width"],
    target_from_source: Pose,
    size: tuple[int, int],
    *,
    mask: Bool[np.ndarray, "height width"] | None = None,
    threads: int | None = None,
) -> tuple[Fragments, Float32[np.ndarray, "rows cols 4"]]:
    """What a target of ``size = (rows, cols)`` sees of the points of a panorama, discs of :data:`RADIUS`.

    Args:
        image: colour and trust of every point.
        inverse_depth: 1/metre, finite and >= 0; 0 is infinitely far.
        target_from_source: rigid transform from the panorama's camera frame to the target's.
        size: of the target, any.
        mask: False where a pixel is no point.
        threads: at most this many; the result does not depend on it.

    Returns:
        Fragments whose ``face`` is the flat index of the source pixel, and its colour and trust, 0 where nothing is.
    """
    angle = math.pi * max(RADIUS / inverse_depth.shape[0], LEAST_RADIUS / size[0])
    points = projected_points(inverse_depth, mask, target_from_source, size, threads)
    fragments = _splat(points, angle, size, threads)
    colour = image.reshape(-1, image.shape[-1])[np.maximum(fragments.face, 0)].astype(np.float32, copy=False)
    colour[~fragments.visibility] = 0.0
    return fragments, colour


class PointRenderer:
    """See :class:`omnisyn_cli.render.renderer.Renderer`: one point for every pixel of the photograph.

    The inverse depth comes to the photograph's resolution through the mesh, so that nothing floats between surfaces.
    """

    def __init__(
        self,
        image: Float[np.ndarray, "height width 3"],
        mask: Bool[np.ndarray, "height width"] | None,
        inverse_depth: Float[np.ndarray, "rows cols"],
        confidence: Float[np.ndarray, "rows cols"] | None,
        size: tuple[int, int],
        cut: Cut | None = None,
        threads: int | None = None,
    ) -> None:
        full = (image.shape[0], image.shape[1])
        trust = np.ones(full) if confidence is None else sample_bilinear(confidence, pixel_directions(*full))
        trust = np.maximum(trust, LEAST)
        self._image = np.concatenate([image, trust[..., None]], axis=-1).astype(np.float32)
        self._inverse_depth = rasterize(build_mesh(inverse_depth, cut), Pose.identity(), full, threads).inverse_depth
        self._mask, self._size, self._threads = mask, size, threads
        self._asked = AskedPanorama(partial(make_texture, image, mask), inverse_depth, Shader(size, threads))

    def __call__(self, target_from_source: Pose) -> Rendering:
        """See :class:`omnisyn_cli.render.renderer.Renderer`."""
        fragments, colour = render_points(
            self._image, self._inverse_depth, target_from_source, self._size, mask=self._mask, threads=self._threads
        )
        witness = self._asked.seen_from(target_from_source)
        return replace(Rendering.of(fragments.inverse_depth, colour, target_from_source), witness=witness)


def projected_points(
    inverse_depth: np.ndarray, mask: np.ndarray | None, pose: Pose, size: tuple[int, int], threads: int | None
) -> np.ndarray:
    """Per point ``(cos polar, sin polar, column, inverse depth)`` in the target."""
    points = np.empty((*inverse_depth.shape, 4))
    mask = np.ones(inverse_depth.shape, bool) if mask is None else mask
    tables = direction_tables(*inverse_depth.shape)
    rotation, translation = np.ascontiguousarray(pose.rotation), np.ascontiguousarray(pose.position)
    scale = np.array(pixel_scale(size))

    def band(begin: int, end: int) -> None:
        project_points(inverse_depth, mask, *tables, rotation, translation, scale, points, begin, end)

    run_bands(band, len(points), threads)
    return points


def _splat(points: np.ndarray, angle: float, size: tuple[int, int], threads: int | None) -> Fragments:
    fragments = Fragments(np.empty(size, np.float32), np.empty(size, np.int32))
    aside = np.empty(size, np.float32)
    sin_p, cos_p, _, _ = direction_tables(*size)

    def band(begin: int, end: int) -> None:
        find_nearest(points, angle, sin_p, cos_p, fragments.inverse_depth, begin, end)
        choose_points(
            points, angle, SAME_SURFACE, sin_p, cos_p, aside, fragments.inverse_depth, fragments.face, begin, end
        )

    run_bands(band, size[0], threads)
    return fragments
