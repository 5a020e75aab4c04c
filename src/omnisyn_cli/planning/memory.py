"""The memory that a job will take, estimated from the sizes of what is held at its three peaks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from omnisyn_cli.io import read_header
from omnisyn_cli.io.background import frames_in_queue
from omnisyn_cli.planning.job import InterpolationJob, is_rounded, sample_types
from omnisyn_cli.presets import OMNISYN
from omnisyn_cli.rows import are_frames_by_rows

__all__ = ["estimated_memory"]

PROGRAM = {"file": 275e6, "matching": 345e6, "refined": 345e6, "network": 345e6, "monocular": 370e6}
"""Bytes of the interpreter, its libraries and kernels, by where depth is from; for monocular SynSin's networks too."""

BYTES_PER_PIXEL_OF_NETWORK = {"refined": 1100, "network": 3200}
"""What networks of depth take and keep for each pixel of their answers; of the paper's, which is the larger one."""

FINDING = 80e6
"""Bytes that are given back when depth has been found."""

PAINTING, PAINTED_ROWS = 230, 1024
"""Bytes that a network which paints takes for each pixel of its picture, and the rows of its largest one."""

CORRECTING = 90e6
"""Bytes that a network which corrects the blend takes, which looks at one size, whatever that of the frames."""

BYTES_PER_VERTEX = {"mesh": 57, "points": 24, "two-pass": 660}
"""While surfaces are made: mesh with buffers; splats; explicit triangles."""

BYTES_PER_KEPT_VERTEX = {**BYTES_PER_VERTEX, "two-pass": 150}
"""While frames are made."""

SPLATTING = 36
"""Bytes of each pixel of a frame in which points are collected."""

PASSING, PASSING_BY_ROWS = 18, 10
"""Bytes of each pixel of a frame that are held for a moment on the way from one form to another."""

BYTES_PER_SHARPENED_PIXEL = 400
"""Of an estimate while it is sharpened: the costs of some thirty disparities twice, and maps of both panoramas."""

MIP_LEVELS = 4 / 3
"""Pixels of a texture with its mip levels, in those of the picture."""


def estimated_memory(
    job: InterpolationJob,
    size: tuple[int, int],
    sources: Sequence[tuple[int, int]],
    depths: Sequence[tuple[int, int]],
    depth: str,
    renderer: str,
    fusion: str,
    *,
    is_sharpened: bool,
) -> int:
    """Bytes, estimated: the most of what is held while depth is sharpened, surfaces are made, and frames are.

    Args:
        job: what is asked for.
        size: height and width of the frames.
        sources: those of the panoramas.
        depths: those of the surfaces, the first one that of a network's answers.
        depth: where they come from.
        renderer: how they are drawn.
        fusion: how renderings are fused.
        is_sharpened: whether estimates come to their size by :mod:`omnisyn_cli.stereo.sharpening`.

    Raises:
        ImageError: a panorama is missing or unreadable.
    """
    largest, vertices = (max(height * width for height, width in group) for group in (sources, depths))
    has_samples = all(read_header(image).dtype == "uint8" for image in job.images)
    is_kept_as_samples = has_samples and renderer == "mesh"
    kept = (3 if has_samples else 12) + MIP_LEVELS * 4 * (1 if is_kept_as_samples else 4)
    numbers, texturing = 12, 4  # of both for depth; of the last one again, when it is shown
    program = PROGRAM[depth] + BYTES_PER_PIXEL_OF_NETWORK.get(depth, 0) * depths[0][0] * depths[0][1]
    frames = _bytes_of_frames(job, size, renderer, fusion) + numbers * largest
    if job.method != OMNISYN:
        return int(program + 2 * kept * largest + frames)
    finding = 0 if depth == "file" else FINDING
    if is_sharpened:
        finding += 2 * numbers * largest + BYTES_PER_SHARPENED_PIXEL * vertices
    texturing_surfaces = 2 * BYTES_PER_VERTEX[renderer] * vertices + 2 * (numbers + texturing) * largest
    frames += 2 * BYTES_PER_KEPT_VERTEX[renderer] * vertices
    return int(program + 2 * kept * largest + max(finding, texturing_surfaces, frames))


def _bytes_of_frames(job: InterpolationJob, size: tuple[int, int], renderer: str, fusion: str) -> float:
    """What making frames takes: two renderings, the pyramid that fills holes, frames on their way to the encoder."""
    pixels = size[0] * size[1]
    waiting = frames_in_queue(size) + 2
    largest_sample = max(np.dtype(kind).itemsize for kind in sample_types(job))
    if job.method != OMNISYN:
        return pixels * (16 + 12 + 3 * largest_sample * waiting + 1.5)
    is_by_rows = are_frames_by_rows(
        renderer, fusion, size,
        is_rounded=is_rounded(job), is_judged=job.fallback == "crossfade" or job.save_confidence is not None,
    )  # fmt: skip
    pyramid, planes = 16 / 3, 1.5
    if is_by_rows:
        return pixels * (2 * 4 + 1 + PASSING_BY_ROWS + pyramid + 3 * waiting + planes)
    painted = PAINTING * min(pixels, 2 * PAINTED_ROWS**2) if fusion == "painting" else 0
    corrected = CORRECTING if fusion == "network" else 0
    collected = SPLATTING if renderer == "points" else 0
    seen = 4 if renderer == "mesh" else 8  # the others know which point or face it is, too
    whole = 2 * (seen + 16) + 16 + PASSING + collected
    return painted + corrected + pixels * (whole + pyramid + 3 * largest_sample * waiting + planes)
