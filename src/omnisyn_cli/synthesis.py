"""The paper on one page: depth → mesh → render both → fuse, for every position between two panoramas.

``DepthEstimator`` finds inverse depth for both views of a pair, each becomes a surface (:mod:`omnisyn_cli.render`),
both are seen from every waypoint and a ``Fuser`` makes one picture of the two (:mod:`omnisyn_cli.fusion`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, UInt8

from omnisyn_cli.confidence import confidence_of_frame
from omnisyn_cli.fusion import GeometricFuser
from omnisyn_cli.fusion.geometric import ROWS
from omnisyn_cli.fusion.kernels import quantize_rows
from omnisyn_cli.geometry.pose import Pose, rotation_vector_from_rotation
from omnisyn_cli.geometry.sphere import pixel_scale
from omnisyn_cli.photometry import ExposureMatcher
from omnisyn_cli.render.shade import Shader
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.rows import row_makers
from omnisyn_cli.segments import Segment, Stopwatch, SynthesisOptions, prepare_segment
from omnisyn_cli.threads import run_bands
from omnisyn_cli.trajectory import Waypoint
from omnisyn_cli.types import (
    UNSEEN,
    DepthEstimator,
    Fuser,
    Rendering,
    RowFuser,
    RowRenderer,
    RowRendering,
    View,
)

if TYPE_CHECKING:
    from omnisyn_cli.gpu.frames import GpuFrames, GpuPair

__all__ = [
    "Frame",
    "MemoryForFrames",
    "photograph_at",
    "synthesize",
    "turned_panorama",
]


MemoryForFrames = Callable[[], UInt8[np.ndarray, "height width 3"]]


ASIDE = 0.25
"""Pixels by which everything may be seen aside of where it was in the frame before for that to be shown again."""

LEAST_SHARE = 1.0 / 512.0
"""A share of the way that changes no colour by more than half of one of 256 levels."""


@dataclass(frozen=True)
class Frame:
    """One picture of the video.

    Attributes:
        image: ``(height, width, 3)`` RGB, >= 0, a buffer that the next frame overwrites; or samples of 8 bits.
        waypoint: where it was taken.
        panorama: index of the panorama that is shown unchanged, if it is shown unchanged and unturned, else None.
        confidence: ``(height, width)`` in [0, 1], if asked for; 1 everywhere in a photograph.
    """

    image: Float32[np.ndarray, "height width 3"] | UInt8[np.ndarray, "height width 3"]
    waypoint: Waypoint
    panorama: int | None
    confidence: Float32[np.ndarray, "height width"] | None = None


def synthesize(
    views: Sequence[View],
    path: Sequence[Waypoint],
    estimator: DepthEstimator,
    options: SynthesisOptions,
    fuser: Fuser | None = None,
    clock: Stopwatch | None = None,
    samples: MemoryForFrames | None = None,
    device: GpuFrames | None = None,
) -> Iterator[Frame | Segment]:
    """All frames of a path, in order; each segment is yielded once before its first frame.

    Args:
        views: the panoramas of the chain, in order.
        path: waypoints with ascending segments, see :func:`omnisyn_cli.trajectory.plan_path`.
        estimator: finds the depth of each pair.
        options: size and method.
        fuser: joins the two renderings; geometric by default.
        clock: collects seconds by stage.
        samples: gives memory for frames that are wanted rounded to 8 bits; where nothing stands against it they are
            rounded as they are made. Photographs shown unchanged are not.
        device: makes the frames between photographs, by the mesh and the geometric fusion, whatever else is asked for;
            for frames without confidence that are not cross-faded.
    """
    clock = clock or Stopwatch()
    fuser = fuser or GeometricFuser(options.size, threads=options.threads)
    segment: Segment | None = None
    last: _Fused | None = None
    current = -1
    for waypoint in path:
        photograph = photograph_at(views, waypoint, options, clock, samples)
        if photograph is not None:
            yield photograph
            continue
        if segment is None or waypoint.segment != current:
            current, segment, last = waypoint.segment, None, None  # memory is free before the next takes its own
            segment = prepare_segment(current, views[current], views[current + 1], estimator, options, clock, device)
            yield segment
        if last is not None and last.looks_the_same_from(waypoint):
            yield last.again(waypoint, samples)
        else:
            last = _fused(segment, waypoint, fuser, options, clock, samples)
            yield last.frame


def photograph_at(
    views: Sequence[View], waypoint: Waypoint, options: SynthesisOptions, clock: Stopwatch,
    samples: MemoryForFrames | None = None,
) -> Frame | None:  # fmt: skip
    """The panorama that was taken at a waypoint, as its frame; None where there is none, or not all of it may be used.

    Arguments are those of :func:`synthesize`.
    """
    panorama = _panorama_at(waypoint)
    if panorama is None:
        return None
    view = views[panorama]
    return _photograph(view, waypoint, panorama, options, clock, samples) if _is_complete(view) else None


def _panorama_at(waypoint: Waypoint) -> int | None:
    """The panorama whose place this is."""
    if waypoint.t not in (0.0, 1.0):
        return None
    return waypoint.segment + int(waypoint.t)


def _is_complete(view: View) -> bool:
    return view.mask is None or bool(view.mask.all())


def _photograph(
    view: View, waypoint: Waypoint, index: int, options: SynthesisOptions, clock: Stopwatch,
    samples: MemoryForFrames | None,
) -> Frame:  # fmt: skip
    """The panorama itself; resampled only where size or orientation differ."""
    confidence = np.ones(options.size, np.float32) if options.confidence else None
    is_turned = not np.array_equal(view.pose.rotation, waypoint.pose.rotation)
    if not is_turned and view.image.shape[:2] == options.size:
        return Frame(view.image, waypoint, index, confidence)
    with clock("render"):
        turn = Pose(waypoint.pose.rotation.T @ view.pose.rotation, np.zeros(3))
        if samples is None:
            image = turned_panorama(view.image, turn, options.size, options.threads)
        else:
            image = samples()
            _turn_rows(view.image if view.samples is None else view.samples, turn, image, options.threads)
    return Frame(image, waypoint, None, confidence)


def _turn_rows(image: np.ndarray, target_from_source: Pose, out: np.ndarray, threads: int | None) -> None:
    """:func:`turned_panorama`, rounded to 8 bits, some rows at a time."""
    shader, texture = Shader(out.shape[:2], threads), make_texture(image)

    def band(begin: int, end: int) -> None:
        for top in range(begin, end, ROWS):
            bottom = min(top + ROWS, end)
            colour = shader.far_rows(texture, target_from_source, top, bottom)
            quantize_rows(colour, np.float32(255.0), out[top:bottom], 0, bottom - top)

    run_bands(band, len(out), threads)


def turned_panorama(
    image: np.ndarray, target_from_source: Pose, size: tuple[int, int], threads: int | None = None
) -> Float32[np.ndarray, "height width 3"]:
    """A panorama seen from its own centre in another orientation and size; no surface is needed for that."""
    colour = Shader(size, threads).infinitely_far(make_texture(image), target_from_source)[..., :3]
    return np.asarray(np.maximum(colour, np.float32(0.0)))


@dataclass(frozen=True)
class _Fused:
    """A frame and what it was made of, in buffers that the next one overwrites.

    Attributes:
        frame: the frame.
        nearest: answers the greatest inverse depth that either view sees, 1/metre.
    """

    frame: Frame
    nearest: Callable[[], float]

    def looks_the_same_from(self, waypoint: Waypoint) -> bool:
        """Whether nothing in the frame would be seen more than a quarter of a pixel aside from there."""
        before = self.frame.waypoint
        if abs(waypoint.t - before.t) > LEAST_SHARE:
            return False
        height, width, _ = self.frame.image.shape
        angle = ASIDE / pixel_scale((height, width))[0]
        turned = np.linalg.norm(rotation_vector_from_rotation(before.pose.rotation.T @ waypoint.pose.rotation))
        moved = np.linalg.norm(waypoint.pose.position - before.pose.position)
        if turned > angle or moved == 0.0:
            return bool(turned <= angle)
        return bool(turned + moved * self.nearest() <= angle)

    def again(self, waypoint: Waypoint, samples: MemoryForFrames | None) -> Frame:
        """The frame at another place; samples, which are kept until they are written, in memory of their own."""
        image = self.frame.image
        if samples is not None and image.dtype == np.uint8:
            image = samples()
            image[:] = self.frame.image
        return replace(self.frame, image=image, waypoint=waypoint)


def _fused(
    segment: Segment, waypoint: Waypoint, fuser: Fuser, options: SynthesisOptions, clock: Stopwatch,
    samples: MemoryForFrames | None,
) -> _Fused:  # fmt: skip
    """The frame of two renderings that were given one exposure."""
    if segment.on_device is not None:
        return _fused_on_device(segment, segment.on_device, waypoint, options, clock, samples)
    expose = ExposureMatcher(segment.check.curve, options.threads)
    is_judged = options.confidence or segment.cross_fade is not None
    makers = row_makers(segment.renderers, fuser, is_rounded=samples is not None, is_judged=is_judged)
    if makers is not None and samples is not None:
        return _fused_by_rows(segment, waypoint, makers, expose, clock, samples)
    with clock("render"):
        first, second = _renderings(segment, waypoint, needs_both=is_judged)
    with clock("fuse"):
        expose(first, second, waypoint.t)
        confidence = confidence_of_frame(first, second, options.threads) if is_judged else None
        image = fuser(first, second, waypoint.t)
        if segment.cross_fade is not None and confidence is not None:
            segment.cross_fade(image, confidence, waypoint.pose, waypoint.t)
    return _Fused(Frame(image, waypoint, None, confidence), _nearest_of(first, second))


def _nearest_of(*renderings: Rendering | RowRendering) -> Callable[[], float]:
    return lambda: max(float(rendering.inverse_depth.max()) for rendering in renderings)


def _fused_on_device(
    segment: Segment, pair: GpuPair, waypoint: Waypoint, options: SynthesisOptions, clock: Stopwatch,
    samples: MemoryForFrames | None,
) -> _Fused:  # fmt: skip
    """The same, all of it on a device."""
    image = np.empty((*options.size, 3), np.float32) if samples is None else samples()
    with clock("render"):
        target_from_first, target_from_second = (waypoint.pose.inverse() @ pose for pose in segment.poses)
        pair.frame(target_from_first, target_from_second, waypoint.t, image)
    return _Fused(Frame(image, waypoint, None), lambda: pair.nearest)


def _fused_by_rows(
    segment: Segment, waypoint: Waypoint, makers: tuple[RowRenderer, RowRenderer, RowFuser], expose: ExposureMatcher,
    clock: Stopwatch, samples: MemoryForFrames,
) -> _Fused:  # fmt: skip
    """The same, coloured, blended and rounded some rows at a time."""
    one, other, fuser = makers
    with clock("render"):
        target_from_first, target_from_second = (waypoint.pose.inverse() @ pose for pose in segment.poses)
        first, second = one.by_rows(target_from_first), other.by_rows(target_from_second)
    with clock("fuse"):
        rounded = samples()
        fuser.samples(*expose.by_rows(first, second, waypoint.t), waypoint.t, rounded)
    return _Fused(Frame(rounded, waypoint, None), _nearest_of(first, second))


def _renderings(segment: Segment, waypoint: Waypoint, *, needs_both: bool) -> tuple[Rendering, Rendering]:
    """Both views as the waypoint sees them; at an end of the way the other one only if its own has holes."""
    near = 0 if waypoint.t < 0.5 else 1
    own = _rendering(segment, waypoint, near)
    is_at_an_end = min(waypoint.t, 1.0 - waypoint.t) <= LEAST_SHARE
    if is_at_an_end and not needs_both and bool((own.colour[..., 3] > UNSEEN).all()):
        pose = waypoint.pose.inverse() @ segment.poses[1 - near]
        other = Rendering(np.full_like(own.inverse_depth, -1.0), np.zeros_like(own.colour), pose)
    else:
        other = _rendering(segment, waypoint, 1 - near)
    return (own, other) if near == 0 else (other, own)


def _rendering(segment: Segment, waypoint: Waypoint, which: int) -> Rendering:
    target_from_source = waypoint.pose.inverse() @ segment.poses[which]
    return Rendering(*segment.renderers[which](target_from_source), target_from_source)
