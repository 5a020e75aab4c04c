"""The paper on one page: depth → mesh → render both → fuse, for every position between two panoramas.

``DepthEstimator`` finds inverse depth for both views of a pair, each becomes a surface (:mod:`omnisyn_cli.render`),
both are seen from every waypoint and a ``Fuser`` makes one picture of the two (:mod:`omnisyn_cli.fusion`).
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_kernels import quantize_rows
from omnisyn_cli.fusion.geometric import TILE_ROWS
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.synthesis.frame import Frame, FrameAllocator
from omnisyn_cli.synthesis.methods import Method, Pair, frames_of
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import View

__all__ = ["Frame", "FrameAllocator", "synthesize", "turned_panorama"]


def synthesize(
    views: Sequence[View], path: Sequence[Waypoint], method: Method, out: FrameAllocator | None = None,
    on_pair: Callable[[int, Pair], None] | None = None, *, photographs: bool = True,
) -> Iterator[Frame]:  # fmt: skip
    """All frames of a path, in order: the photographs themselves where they were taken, between them the method's.

    The path has waypoints with ascending segments, see :func:`omnisyn_cli.synthesis.trajectory.plan_path`. ``out``
    gives memory for frames that are wanted rounded to 8 bits; where nothing stands against it they are rounded as they
    are made. Photographs shown unchanged are not. Without ``photographs`` frames are made there as well. ``on_pair`` is
    called with the index of its first view and each pair, before the first frame between the two.
    """
    pair: Pair | None = None
    current = -1

    def pair_of(segment: int) -> Pair:
        nonlocal pair, current
        if pair is None or segment != current:
            current, pair = segment, None  # memory is free before the next takes its own
            pair = method.prepare(current, views)
            if on_pair is not None:
                on_pair(current, pair)
        return pair

    for (segment, is_end), waypoints in groupby(path, lambda waypoint: (waypoint.segment, waypoint.t in (0.0, 1.0))):
        if not (is_end and photographs):
            yield from frames_of(pair_of(segment), waypoints, out)
            continue
        for waypoint in waypoints:
            # not in a variable, which would keep the last photograph in memory
            yield _photograph_at(views, waypoint, method, out) or pair_of(segment).frame(waypoint, out)


def _photograph_at(
    views: Sequence[View], waypoint: Waypoint, method: Method, out: FrameAllocator | None
) -> Frame | None:
    """The panorama that was taken at a waypoint; None where there is none, or not all of it may be shown."""
    if waypoint.t not in (0.0, 1.0):
        return None
    index, options = waypoint.segment + int(waypoint.t), method.options
    view = views[index]
    if view.mask is not None and not view.shows_masked and not view.mask.all():
        return None
    confidence = np.ones(options.size, np.float32) if options.confidence else None
    is_turned = not np.array_equal(view.pose.rotation, waypoint.pose.rotation)
    if not is_turned and view.image.shape[:2] == options.size:
        return Frame(view.image, waypoint, index, confidence)
    with method.clock("render"):
        turn = Pose(waypoint.pose.rotation.T @ view.pose.rotation, np.zeros(3))
        if out is None:
            image = turned_panorama(view.image, turn, options.size, options.threads)
        else:
            image = out()
            samples = view.image if view.image_uint8 is None else view.image_uint8
            _turn_rows(samples, turn, Shader(options.size, options.threads), image)
    return Frame(image, waypoint, None, confidence)


def _turn_rows(image: np.ndarray, target_from_source: Pose, shader: Shader, out: np.ndarray) -> None:
    """:func:`turned_panorama`, rounded to 8 bits, some rows at a time."""
    texture = make_texture(image)

    def band(begin: int, end: int) -> None:
        for top in range(begin, end, TILE_ROWS):
            bottom = min(top + TILE_ROWS, end)
            colour = shader.rows_at_infinity(texture, target_from_source, top, bottom)
            quantize_rows(colour, np.float32(255.0), out[top:bottom], 0, bottom - top)

    run_ranges(band, len(out), shader.threads)


def turned_panorama(
    image: np.ndarray, target_from_source: Pose, size: tuple[int, int], threads: int | None = None
) -> Float32[np.ndarray, "height width 3"]:
    """A panorama seen from its own centre in another orientation and size; no surface is needed for that."""
    colour = Shader(size, threads).shade_at_infinity(make_texture(image), target_from_source)[..., :3]
    return np.asarray(np.maximum(colour, np.float32(0.0)))
