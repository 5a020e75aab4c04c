"""One unit of work: what a method makes of a pair, compared with everything that is known about it.

The temporal measures need a clip: :data:`CLIP_FRAMES` frames around the middle of the way on the straight line between
both panoramas, :data:`CLIP_STEP` of the way apart (two seconds of video at 30 frames a second), at most
:data:`CLIP_HEIGHT` rows high. They follow the method's own geometry, so methods without geometry have none: a point of
one frame is found in another by its inverse depth (1/m; 0 is infinitely far, negative or NaN unknown) and both poses,
world-from-camera. Nothing is estimated from the pictures. Means are weighted by solid angle.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.evaluation.metrics import image as metrics
from omnisyn_cli.evaluation.metrics.artefacts import PhotographEdges, flying_share, shard_share
from omnisyn_cli.evaluation.metrics.depth import confidence_metrics, depth_metrics, left_right_metrics, scored_pixels
from omnisyn_cli.evaluation.metrics.image import Masks, Picture, photograph_scores
from omnisyn_cli.evaluation.results import DepthRecord, FrameRecord
from omnisyn_cli.evaluation.views import LoadedPair, TrueFrame, at_size
from omnisyn_cli.fusion.pixel_classes import classify_pixels, silhouette_mask
from omnisyn_cli.geometry.pose import Pose, at_same_position, interpolate_pose
from omnisyn_cli.geometry.sampling import sample_bicubic, sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import mean_over_sphere, pixel_directions, row_weights
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.geometry.tolerances import SAME_POINT_TOLERANCE
from omnisyn_cli.synthesis.methods import Pair
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, View

# Set by hand: an odd number, so that one lies in the middle; so few rows keep it cheaper than the true frames.
CLIP_FRAMES, CLIP_STEP, CLIP_HEIGHT = 9, 1 / 60, 256
END_SHARE = 1e-6  # share of the way from a panorama at which a frame is rendered rather than the photograph shown

# Makes a pair ready for frames of a size, such as :class:`omnisyn_cli.evaluation.methods.MethodAtWork`.
PairMaker = Callable[[tuple[int, int], Stopwatch], Pair]


@dataclass(frozen=True)
class Measurement:
    """What was made and measured."""

    images: tuple[Picture, ...]  # a picture for every target of the pair
    frames: tuple[FrameRecord, ...]  # what is known of every picture
    depths: tuple[DepthRecord, ...]  # of both views; empty for methods without
    found: tuple[DepthEstimate, DepthEstimate] | None  # the depth that the method found, or None
    temporal: dict[str, float]  # see :class:`omnisyn_cli.evaluation.results.UnitRecord`
    seconds: dict[str, float]  # for the targets, by stage, with their ``total``; clips and ends are not counted


def measure(method: PairMaker, pair: LoadedPair, names: tuple[str, str], threads: int | None = None) -> Measurement:
    """Make and measure a pair's targets, a clip and both ends; ``names`` of panoramas."""
    clock = Stopwatch()
    made = method(pair.size, clock)
    images = tuple(_clip_to_unit(made.frame(target.waypoint).image) for target in pair.targets)
    seconds = dict(clock.seconds)
    kinds = (_kinds_at(made, target.waypoint, pair.size) for target in pair.targets)
    frames = tuple(_frame_records(images, kinds, pair))
    has_parallax = not at_same_position(*(view.pose for view in pair.views))
    clip = _clip_measures(method, made, pair) if has_parallax else {}
    found = made.depths if has_parallax else None
    depths = () if found is None else tuple(map(depth_record, found, pair.views, names))
    total = {**seconds, "total": math.fsum(seconds.values())}
    return Measurement(images, frames, depths, found, {**clip, **_end_errors(made, pair, threads)}, total)


def _kinds_at(made: Pair, waypoint: Waypoint, size: tuple[int, int]) -> Masks:
    """Where pixels of each kind are in a frame; without geometry only the ends."""
    shown = made.renderings(waypoint)
    if shown is None:
        return metrics.end_masks(size)
    return {**classify_pixels(*shown)._asdict(), "silhouette": silhouette_mask(*shown), **metrics.end_masks(size)}


def _frame_records(images: Sequence[Picture], kinds: Iterable[Masks], pair: LoadedPair) -> Iterator[FrameRecord]:
    """Of every picture: its shards; against true frames also its own scores, how it changed, how much of it flies."""
    photographs = PhotographEdges(pair.views, pair.size)
    is_depth_known = all(view.known_depth is not None for view in pair.views)
    changes = [] if pair.are_photographs or not pair.truths else change_psnr(images, [t.image for t in pair.truths])
    for number, (target, image, masks) in enumerate(zip(pair.targets, images, kinds, strict=True)):
        scores = {"shards": shard_share(image, target.waypoint.pose, photographs)}
        by_kind: dict[str, dict[str, float]] = {}
        if isinstance(target, TrueFrame) and target.usable is not None:
            scores = photograph_scores(image, target.image, target.usable) | scores
        elif isinstance(target, TrueFrame):
            scores = frame_scores(image, target.image) | scores
            by_kind = metrics.kind_figures(image, target.image, masks)
            if number > 0:
                scores["change_psnr"] = changes[number - 1]
            if is_depth_known:
                scores["flying"] = flying_share(image, target.image, target.waypoint.pose, pair.views)
        yield FrameRecord(target.name, target.waypoint.t, target.distance, scores, by_kind=by_kind)


def _clip_to_unit(image: Picture) -> Picture:
    """As a video holds it: black and white are the ends, whatever interpolation makes of edges."""
    return np.asarray(np.clip(image, 0.0, 1.0))


def frame_scores(image: Picture, truth: Picture) -> dict[str, float]:
    """All measures of :class:`omnisyn_cli.evaluation.results.FrameRecord`; no structural ones below 11 rows."""
    scores = {
        "ws_psnr": metrics.ws_psnr(image, truth),
        "psnr": metrics.psnr(image, truth),
        "lrce": metrics.lrce(image, truth),
        "psnr_top": metrics.end_psnr(image, truth, is_bottom=False),
        "psnr_bottom": metrics.end_psnr(image, truth, is_bottom=True),
    }
    if len(truth) >= metrics.SSIM_WINDOW:
        scores.update(ws_ssim=metrics.ws_ssim(image, truth), ssim=metrics.ssim(image, truth))
    return scores


def depth_record(found: DepthEstimate, view: View, name: str) -> DepthRecord:
    """Errors of the depth of a view where the truth is known, at the resolution of the truth."""
    if view.known_depth is None:
        return DepthRecord(name)
    known = view.known_depth
    truth = np.where(known.confidence > 0, known.inverse_depth, np.nan).astype(np.float64)
    if not scored_pixels(truth).any():
        return DepthRecord(name)
    estimate, confidence = (
        _resized(each.astype(np.float64), truth.shape) for each in (found.inverse_depth, found.confidence)
    )
    plain, weighted = (depth_metrics(estimate, truth, weighted=weighted) for weighted in (False, True))
    doubt, reliability = confidence_metrics(estimate, confidence, truth)
    if found.stereo_valid is not None:
        stereo_valid = sample_nearest(found.stereo_valid.astype(np.float32), pixel_directions(*truth.shape))
        doubt |= left_right_metrics(estimate, truth, stereo_valid > 0)
    return DepthRecord(name, plain, weighted, doubt=doubt, reliability=reliability)


def _resized(values: Float[np.ndarray, "rows cols"], size: tuple[int, ...]) -> Float[np.ndarray, "height width"]:
    if values.shape == size:
        return values
    return np.asarray(sample_bilinear(values, pixel_directions(*size)))


def _clip_measures(method: PairMaker, made: Pair, pair: LoadedPair) -> dict[str, float]:
    """Both measures along the geometry of the clip; none where neighbouring frames show nothing in common."""
    times = 0.5 + CLIP_STEP * (np.arange(CLIP_FRAMES) - CLIP_FRAMES // 2)
    first, second = (view.pose for view in pair.views)
    path = [Waypoint(0, float(t), interpolate_pose(first, second, float(t))) for t in times]
    if made.inverse_depth(path[0]) is None:
        return {}
    height = min(CLIP_HEIGHT, pair.size[0])
    clip = method((height, 2 * height), Stopwatch())
    frames = [_clip_to_unit(clip.frame(waypoint).image) for waypoint in path]
    inverse_depths = [seen for waypoint in path if (seen := clip.inverse_depth(waypoint)) is not None]
    poses = [waypoint.pose for waypoint in path]
    try:
        return {
            "warping_error": warping_error(frames, inverse_depths, poses),
            "flicker": flicker(frames, inverse_depths, poses),
        }
    except ValueError:
        return {}


def _end_errors(made: Pair, pair: LoadedPair, threads: int | None) -> dict[str, float]:
    """How far both ends are from the photographs that are shown there: what would pop."""
    errors = []
    for t, view in zip((END_SHARE, 1 - END_SHARE), pair.views, strict=True):
        shown = _clip_to_unit(made.frame(Waypoint(0, t, view.pose)).image)
        truth = at_size(view.image, pair.size, threads)
        errors.append(math.sqrt(mean_over_sphere((shown.astype(np.float64) - _clip_to_unit(truth)) ** 2)))
    return {"end_first": errors[0], "end_second": errors[1]}


# Inverse depth, 1/m, below which values always agree: beyond a kilometre parallax is invisible.
FAR_INVERSE_DEPTH = 1e-3

Frames = Sequence[Float[np.ndarray, "height width 3"]]
InverseDepths = Sequence[Float[np.ndarray, "height width"]]


def change_psnr(frames: Frames, truths: Frames) -> list[float]:
    """WS-PSNR of ``(made_k − made_{k−1}) − (true_k − true_{k−1})``, dB: what is wrong alike in both is no error."""
    return [
        metrics.ws_psnr(after - before, true_after - true_before)
        for (before, after), (true_before, true_after) in zip(pairwise(frames), pairwise(truths), strict=True)
    ]


def warping_error(frames: Frames, inverse_depths: InverseDepths, poses: Sequence[Pose]) -> float:
    """Mean absolute difference between a frame and the next one warped into it, where both see the same point.

    The mean over pairs of neighbours (two frames at least), each over what both see; ValueError: nothing. Reflections
    and blur by interpolation count as errors. Source: Lai et al., Learning blind video temporal consistency, 2018, with
    geometry for optical flow and absolute differences.
    """
    errors = []
    for here in range(len(frames) - 1):
        warped, visible = _warp(here, here + 1, frames, inverse_depths, poses)
        errors.append(_mean(np.abs(warped - frames[here]), visible))
    return float(np.mean(errors))


def flicker(frames: Frames, inverse_depths: InverseDepths, poses: Sequence[Pose]) -> float:
    """Mean absolute second difference in time, ``|before − 2·now + after|``, of every point that three frames see.

    A steady change is no flicker; a point lit for one frame by e counts 2·e. At least three frames; errors as above.
    """
    errors = []
    for now in range(1, len(frames) - 1):
        before, visible_before = _warp(now, now - 1, frames, inverse_depths, poses)
        after, visible_after = _warp(now, now + 1, frames, inverse_depths, poses)
        errors.append(_mean(np.abs(before - 2.0 * frames[now] + after), visible_before & visible_after))
    return float(np.mean(errors))


def _warp(
    here: int, there: int, frames: Frames, inverse_depths: InverseDepths, poses: Sequence[Pose]
) -> tuple[Float[np.ndarray, "height width 3"], Bool[np.ndarray, "height width"]]:
    """Colours in frame ``there`` of the points that the pixels of frame ``here`` show, and which of them it sees."""
    rho = inverse_depths[here].astype(np.float64)
    known = rho >= 0
    there_from_here = poses[there].inverse() @ poses[here]
    rays = sweep_directions(pixel_directions(*rho.shape), np.where(known, rho, 0.0), there_from_here)
    length = np.linalg.norm(rays, axis=-1)
    reached = known & (length > 0)
    expected = rho / np.where(reached, length, 1.0)
    seen = sample_nearest(inverse_depths[there], rays)
    agreeing = np.abs(expected - seen) <= np.maximum(SAME_POINT_TOLERANCE * expected, FAR_INVERSE_DEPTH)
    return sample_bicubic(frames[there].astype(np.float64), rays), reached & (seen >= 0) & agreeing


def _mean(error: Float[np.ndarray, "height width 3"], visible: Bool[np.ndarray, "height width"]) -> float:
    weights = row_weights(len(error))[:, None] * visible
    if not weights.any():
        raise ValueError("expected neighbouring frames with something in common, got none; take smaller steps")
    return float(np.average(error.mean(axis=-1), weights=weights))
