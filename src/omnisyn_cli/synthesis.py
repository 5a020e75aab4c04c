"""The paper on one page: depth → mesh → render both → fuse, for every position between two panoramas.

``DepthEstimator`` finds inverse depth for both views of a pair, each becomes a surface (:mod:`omnisyn_cli.render`),
both are seen from every waypoint and a ``Fuser`` makes one picture of the two (:mod:`omnisyn_cli.fusion`).
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.confidence import LEAST_SCORE, confidence_of_frame
from omnisyn_cli.crosscheck import CrossCheck, cross_check
from omnisyn_cli.fallback import CrossFade
from omnisyn_cli.fusion import GeometricFuser
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.photometry import ExposureMatcher, equalized
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.render.renderer import Renderer, make_renderer
from omnisyn_cli.render.shade import Shader, make_texture
from omnisyn_cli.trajectory import STILL, Waypoint
from omnisyn_cli.types import DepthEstimate, DepthEstimator, Fuser, Rendering, View

__all__ = ["Frame", "Segment", "Stopwatch", "SynthesisOptions", "prepare_segment", "synthesize", "turned_panorama"]


@dataclass(frozen=True)
class SynthesisOptions:
    """How frames are made.

    Attributes:
        size: height and width of the frames.
        renderer: ``mesh``, ``points`` or ``two-pass``.
        cut: where meshes are cut.
        threads: at most this many; None is one per core.
        cross_fade: show the photographs, cross-faded, in the doubtful regions of pairs that score low.
        confidence: give every frame a map of its confidence.
    """

    size: tuple[int, int]
    renderer: str = "mesh"
    cut: Cut = field(default_factory=Cut)
    threads: int | None = None
    cross_fade: bool = False
    confidence: bool = False


class Stopwatch:
    """Seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time what happens inside."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - begin


@dataclass(frozen=True)
class Segment:
    """Two neighbouring views with their depth, ready to be rendered.

    Attributes:
        index: of the first view.
        views: both.
        depths: of both.
        renderers: of both.
        check: how differently they are exposed, and how far what is made of them can be relied on.
        cross_fade: what doubtful regions are filled with; None where nothing is to be replaced.
    """

    index: int
    views: tuple[View, View]
    depths: tuple[DepthEstimate, DepthEstimate]
    renderers: tuple[Renderer, Renderer]
    check: CrossCheck
    cross_fade: CrossFade | None = None


@dataclass(frozen=True)
class Frame:
    """One picture of the video.

    Attributes:
        image: ``(height, width, 3)`` RGB, >= 0; a buffer that the next frame overwrites.
        waypoint: where it was taken.
        panorama: index of the panorama that is shown unchanged, if it is shown unchanged and unturned, else None.
        confidence: ``(height, width)`` in [0, 1], if asked for; 1 everywhere in a photograph.
    """

    image: Float32[np.ndarray, "height width 3"]
    waypoint: Waypoint
    panorama: int | None
    confidence: Float32[np.ndarray, "height width"] | None = None


def prepare_segment(
    index: int, first: View, second: View, estimator: DepthEstimator, options: SynthesisOptions, clock: Stopwatch
) -> Segment:
    """Depth and surfaces of a pair; where both stand at the same place depth has no effect and is not looked for.

    Depth is found in pictures of one exposure; the surfaces keep the photographs' own.
    """
    with clock("depth"):
        is_moving = np.linalg.norm(second.pose.position - first.pose.position) > STILL
        depths = (
            estimator(*equalized(first, second, options.threads))
            if is_moving
            else _depths_in_place(first, second, options)
        )
    with clock("check"):
        check = cross_check((first, second), depths, options.cut, options.threads)
    with clock("mesh"):
        renderers = [
            make_renderer(
                options.renderer, _usable_image(view, options.threads), view.mask,
                depth.inverse_depth, depth.confidence, options.size, options.cut, options.threads,
            )
            for view, depth in zip((first, second), depths, strict=True)
        ]  # fmt: skip
    is_doubtful = options.cross_fade and check.confidence.score < LEAST_SCORE
    cross_fade = CrossFade((first, second), options.size, options.threads) if is_doubtful else None
    return Segment(index, (first, second), depths, (renderers[0], renderers[1]), check, cross_fade)


def _usable_image(view: View, threads: int | None) -> np.ndarray:
    """The picture with masked pixels painted over from around them, because interpolation reads beyond a mask."""
    if view.mask is None or view.mask.all():
        return view.image
    image = np.array(view.image, np.float32)
    HoleFiller(view.mask.shape, threads)(image, view.mask.astype(np.float32))
    return image


def _depths_in_place(first: View, second: View, options: SynthesisOptions) -> tuple[DepthEstimate, DepthEstimate]:
    """What is known of both, else spheres of infinite radius; the exact mesh makes those of a few large quads."""
    if first.known_depth is not None and second.known_depth is not None:
        return first.known_depth, second.known_depth
    height, width = (16, 32) if options.renderer == "mesh" else first.image.shape[:2]
    far = DepthEstimate(np.zeros((height, width), np.float32), np.ones((height, width), np.float32))
    return far, far


def synthesize(
    views: Sequence[View],
    path: Sequence[Waypoint],
    estimator: DepthEstimator,
    options: SynthesisOptions,
    fuser: Fuser | None = None,
    clock: Stopwatch | None = None,
) -> Iterator[Frame | Segment]:
    """All frames of a path, in order; each segment is yielded once before its first frame.

    Args:
        views: the panoramas of the chain, in order.
        path: waypoints with ascending segments, see :func:`omnisyn_cli.trajectory.plan_path`.
        estimator: finds the depth of each pair.
        options: size and method.
        fuser: joins the two renderings; geometric by default.
        clock: collects seconds by stage.
    """
    clock = clock or Stopwatch()
    fuser = fuser or GeometricFuser(options.size, threads=options.threads)
    segment: Segment | None = None
    current = -1
    for waypoint in path:
        panorama = _panorama_at(views, waypoint)
        if panorama is not None and _is_complete(views[panorama]):
            yield _photograph(views[panorama], waypoint, panorama, options, clock)
            continue
        if segment is None or waypoint.segment != current:
            current, segment = waypoint.segment, None  # the former one's memory is free before the next takes its own
            segment = prepare_segment(current, views[current], views[current + 1], estimator, options, clock)
            yield segment
        yield _fused(segment, waypoint, fuser, options, clock)


def _panorama_at(views: Sequence[View], waypoint: Waypoint) -> int | None:
    """The panorama whose place this is."""
    if waypoint.t not in (0.0, 1.0):
        return None
    return waypoint.segment + int(waypoint.t)


def _is_complete(view: View) -> bool:
    return view.mask is None or bool(view.mask.all())


def _photograph(view: View, waypoint: Waypoint, index: int, options: SynthesisOptions, clock: Stopwatch) -> Frame:
    """The panorama itself; resampled only where size or orientation differ."""
    confidence = np.ones(options.size, np.float32) if options.confidence else None
    is_turned = not np.array_equal(view.pose.rotation, waypoint.pose.rotation)
    if not is_turned and view.image.shape[:2] == options.size:
        return Frame(view.image, waypoint, index, confidence)
    with clock("render"):
        turn = Pose(waypoint.pose.rotation.T @ view.pose.rotation, np.zeros(3))
        image = turned_panorama(view.image, turn, options.size, options.threads)
    return Frame(image, waypoint, None, confidence)


def turned_panorama(
    image: np.ndarray, target_from_source: Pose, size: tuple[int, int], threads: int | None = None
) -> Float32[np.ndarray, "height width 3"]:
    """A panorama seen from its own centre in another orientation and size; no surface is needed for that."""
    colour = Shader(size, threads).infinitely_far(make_texture(image), target_from_source)[..., :3]
    return np.asarray(np.maximum(colour, np.float32(0.0)))


def _fused(segment: Segment, waypoint: Waypoint, fuser: Fuser, options: SynthesisOptions, clock: Stopwatch) -> Frame:
    """The frame of two renderings that were given one exposure."""
    world_to_target = waypoint.pose.inverse()
    renderings = []
    with clock("render"):
        for view, renderer in zip(segment.views, segment.renderers, strict=True):
            target_from_source = world_to_target @ view.pose
            renderings.append(Rendering(*renderer(target_from_source), target_from_source))
    with clock("fuse"):
        first, second = renderings
        ExposureMatcher(segment.check.curve, options.threads)(first, second, waypoint.t)
        is_judged = options.confidence or segment.cross_fade is not None
        confidence = confidence_of_frame(first, second, options.threads) if is_judged else None
        image = fuser(first, second, waypoint.t)
        if segment.cross_fade is not None and confidence is not None:
            segment.cross_fade(image, confidence, waypoint.pose, waypoint.t)
    return Frame(image, waypoint, None, confidence)
