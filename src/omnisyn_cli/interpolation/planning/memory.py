"""The memory that a job will take, estimated from the sizes of what is held at its three peaks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.fusion.ghost_grid import ghost_sample_step
from omnisyn_cli.interpolation.job import InterpolationJob, TourJob, is_rounded, sample_types
from omnisyn_cli.io import read_header
from omnisyn_cli.io.background import frames_in_queue
from omnisyn_cli.pipeline.config import RunConfig

FRAME_COPY_BYTES, ROUNDED_COPY_BYTES = 18, 10
"""Bytes of each pixel of a frame that are held for a moment on the way from one form to another; if it is made of
samples of 8 bits."""

CONFIDENCE_BYTES = 12
"""Bytes of each pixel of a frame for how far it can be relied on, and on the way of that to where it goes."""

MIP_LEVEL_SHARE = 4 / 3
"""Pixels of a texture with its mip levels, in those of the picture."""


FLOAT_PIXEL_BYTES = 12
"""Bytes of each pixel of a panorama as numbers, which depth is found in."""

UNCOLLECTED_BYTES = 80e6
"""Bytes that finding the depth of one pair leaves lying until that of the next is found."""

LOOK_AHEAD_VERTEX_BYTES = 4 * 8
"""Bytes of each vertex of a surface that are held of the pair after the one at work, and while both are joined."""


def fuses_chain_depth(config: RunConfig, panoramas: int) -> bool:
    """Whether depth of a panorama comes from both its neighbours, for which the next pair is compared as well."""
    return config.estimates_depth and panoramas > 2


@dataclass(frozen=True)
class Footprint:
    """Bytes that something made of surfaces takes.

    Attributes:
        per_pixel: of each picture, until all of them are there.
        per_vertex: of each surface, likewise.
        closing: of each vertex of all surfaces, when all of them are there.
        writing: of each pixel of one picture, while it is written.
        columns: that pictures have at most in it; None is as many as they have.
    """

    per_pixel: float
    per_vertex: float
    closing: float = 0.0
    writing: float = 0.0
    columns: int | None = None


def estimated_surface_memory(
    job: TourJob, config: RunConfig, sources: Sequence[tuple[int, int]], depths: Sequence[tuple[int, int]],
    footprint: Footprint,
) -> int:  # fmt: skip
    """Bytes, estimated: the most of what is held while depth is found and while something is made of a surface.

    Args:
        job: what is asked for.
        config: what surfaces are made with.
        sources: height and width of the panoramas.
        depths: those of the surfaces, see :func:`estimated_memory`.
        footprint: what is made of surfaces.

    Raises ImageError: a panorama is missing or unreadable.
    """
    source = config.depth.strategy
    largest, vertices = (max(height * width for height, width in group) for group in (sources, depths))
    is_8_bit = all(read_header(image).dtype == "uint8" for image in job.images)
    panorama = FLOAT_PIXEL_BYTES + (3 if is_8_bit else FLOAT_PIXEL_BYTES)
    more = (panorama * largest + UNCOLLECTED_BYTES) if len(sources) > 2 else 0.0
    if fuses_chain_depth(config, len(sources)):
        more += panorama * largest + LOOK_AHEAD_VERTEX_BYTES * vertices
    picture = largest if footprint.columns is None else min(largest, footprint.columns**2 // 2)
    kept = len(sources) * (footprint.per_pixel * picture + footprint.per_vertex * vertices)
    drawing_bytes = max(
        source.bytes_of_estimation(depths),
        footprint.writing * largest + config.renderer_strategy.building_bytes * vertices,
        len(sources) * footprint.closing * vertices,
    )
    return int(config.depth.bytes_of_program(depths) + 2 * panorama * largest + more + kept + drawing_bytes)


def estimated_memory(
    job: InterpolationJob,
    config: RunConfig,
    size: tuple[int, int],
    sources: Sequence[tuple[int, int]],
    depths: Sequence[tuple[int, int]],
) -> int:
    """Bytes, estimated: the most of what is held while depth is sharpened, surfaces are made, and frames are.

    Args:
        job: what is asked for.
        config: what frames are made with.
        size: height and width of the frames.
        sources: those of the panoramas.
        depths: those of the surfaces, the first one that of a network's answers; refined ones with more than one come
            to their size by :mod:`omnisyn_cli.stereo.refined_estimator`.

    Raises ImageError: a panorama is missing or unreadable.
    """
    source = config.depth.strategy
    largest, vertices = (max(height * width for height, width in group) for group in (sources, depths))
    is_8_bit = all(read_header(image).dtype == "uint8" for image in job.images)
    is_kept_as_samples = is_8_bit and config.renderer_strategy.shades_on_demand
    kept = (3 if is_8_bit else 12) + MIP_LEVEL_SHARE * 4 * (1 if is_kept_as_samples else 4)
    texturing = 4  # numbers are those of both for depth; of the last one again, when it is shown
    program = config.depth.bytes_of_program(depths)
    frames = _bytes_of_frames(job, config, size) + FLOAT_PIXEL_BYTES * largest
    if not config.draws_surfaces:
        return int(program + 2 * kept * largest + frames)
    depth_bytes = source.bytes_of_estimation(depths)
    if source.refines(depths):
        depth_bytes += 2 * FLOAT_PIXEL_BYTES * largest
    ahead = (
        (FLOAT_PIXEL_BYTES + (3 if is_8_bit else 0)) * largest + LOOK_AHEAD_VERTEX_BYTES * vertices + UNCOLLECTED_BYTES
    )
    texturing_surfaces = (
        2 * config.renderer_strategy.building_bytes * vertices + 2 * (FLOAT_PIXEL_BYTES + texturing) * largest
    )
    frames += 2 * config.renderer_strategy.kept_bytes * vertices
    more = ahead if fuses_chain_depth(config, len(sources)) else 0.0
    return int(program + 2 * kept * largest + more + max(depth_bytes, texturing_surfaces, frames))


def _bytes_of_frames(job: InterpolationJob, config: RunConfig, size: tuple[int, int]) -> float:
    """What making frames takes: two surfaces as seen, marks of pixels, the pyramid of holes, frames under way."""
    pixels = size[0] * size[1]
    waiting = frames_in_queue(size) + 2
    largest_sample = max(np.dtype(kind).itemsize for kind in sample_types(job))
    if not config.draws_surfaces:
        return pixels * (16 + 12 + 3 * largest_sample * waiting + 1.5)
    pyramid, planes = 16 / 3, 1.5
    renderer, fusion = config.renderer_strategy, config.fusion_strategy
    is_held = not renderer.shades_on_demand or (fusion.by_rules and ghost_sample_step(size) == 1)
    is_judged = config.fallback == "crossfade" or config.confidence
    marked = 1 if config.supersamples else 0
    frame = ROUNDED_COPY_BYTES if is_rounded(job) else 12 + FRAME_COPY_BYTES
    whole = (
        2 * (renderer.pixel_bytes + (16 if is_held else 0))
        + 1
        + marked
        + frame
        + (CONFIDENCE_BYTES if is_judged else 0)
    )
    return fusion.network_bytes(pixels) + pixels * (whole + pyramid + 3 * largest_sample * waiting + planes)
