"""Each panorama as the other one's depth predicts it: what a pair says about itself, without any truth.

The surface of either view is seen from where the other photograph was taken, and from half way. There a place that both
show has a colour in both pictures, which tells how they were exposed (:mod:`omnisyn_cli.fusion.photometry`) and,
after that, how well depth and poses hold (:mod:`omnisyn_cli.fusion.confidence`). All of it is done at a small size.
"""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import both, limited_threads
from omnisyn_cli.fusion.confidence.pair_confidence import PairConfidence, assess_pair
from omnisyn_cli.fusion.photometry import ExposureCurve, ExposureMatcher, equalized, estimate_curve, rough_curve
from omnisyn_cli.geometry.pose import Pose, slerp
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.render.renderer import MeshRenderer, Renderer, RendererInputs
from omnisyn_cli.types import DepthEstimate, Layer, View

__all__ = ["CHECK_SIZE", "SAME_SURFACE_TOLERANCE", "CrossCheck", "equalize_exposure", "subsample_depth", "resized"]

CHECK_SIZE = (256, 512)
"""Rows and columns that a pair is checked at; if a panorama is smaller, both are at its size."""

SAME_SURFACE_TOLERANCE = 0.05
"""Relative difference of inverse depth up to which two pictures show the same place."""

ROUGH_SIZE = (128, 256)
"""Rows and columns of the depth that tells how differently two pictures are exposed."""

LEAST_WEIGHT = np.float32(0.01)
"""Of a photograph's own pixels: they are what they are, however little is known about their distance."""


@dataclass(frozen=True)
class CrossCheck:
    """What a pair says about itself.

    Attributes:
        curve: how much brighter the second picture is than the first.
        confidence: how good the frames between them may be expected to be.
    """

    curve: ExposureCurve
    confidence: PairConfidence


def equalize_exposure(first: View, second: View, threads: int | None = None) -> tuple[View, View]:
    """Both views exposed alike, so that depth can be found in them; the very same views where they are.

    Where their brightness differs, depth at a small size, from nothing but what is brighter than its neighbours, tells
    which pixels show the same places, and those tell whether it was the exposure.
    """
    if rough_curve(first, second).is_identity or np.array_equal(first.pose.position, second.pose.position):
        return first, second
    from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions

    options = MatchingOptions(size=ROUGH_SIZE, colour_share=0.0, doubtful_colour_share=0.0)
    views = (first, second)
    across, *_ = _seen_across(views, MatchingDepthEstimator(options, threads)(first, second), Cut(), threads)
    return equalized(first, second, _curve(across), threads)


def cross_check(
    views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate], cut: Cut, threads: int | None = None
) -> CrossCheck:
    """Compare two views with each other through their depths.

    Args:
        views: the panoramas.
        depths: their inverse depth, in 1/metre.
        cut: where their surfaces are separated.
        threads: at most this many; None is one per core.
    """
    across, small, renderers = _seen_across(views, depths, cut, threads)
    curve = _curve(across)
    expose = ExposureMatcher(curve)
    there, back = expose(*across[0], 0.0), expose(*across[1][::-1], 1.0)
    return CrossCheck(curve, assess_pair([there, back[::-1]], expose(*_half_way(small, renderers), 0.5)))


def _seen_across(
    views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate], cut: Cut, threads: int | None
) -> tuple[list[tuple[Layer, Layer]], tuple[View, View], list[Renderer]]:
    """Each photograph beside the other one's surface as it is seen from there; both views, small; their renderers."""
    size = min(CHECK_SIZE, views[0].image.shape[:2], views[1].image.shape[:2])

    def prepared(view: View, depth: DepthEstimate) -> tuple[View, Renderer]:
        small = _reduced(view, depth, size)
        return small, _renderer(small, cut, threads)

    with limited_threads(threads):
        (one, first), (other, second) = both(*(partial(prepared, *each) for each in zip(views, depths, strict=True)))
        across = both(lambda: _crossed(one, second, other), lambda: _crossed(other, first, one))
    return list(across), (one, other), [first, second]


def _reduced(view: View, depth: DepthEstimate, size: tuple[int, int]) -> View:
    """A view at the size of the check, its depth with it."""
    image = resized(np.asarray(view.image, np.float32), size, cv2.INTER_AREA)
    mask = None if view.mask is None else resized(view.mask.astype(np.float32), size, cv2.INTER_AREA) > 0.99
    return View(image, view.pose, mask, subsample_depth(depth, size))


def subsample_depth(depth: DepthEstimate, size: tuple[int, int]) -> DepthEstimate:
    """Depth that is larger at a smaller size: of the four pixels around the centre of a new one, the second farthest.

    A mean would lie between two surfaces, and always the same one of the four would move every edge to its side.
    """
    maps = [np.asarray(x, np.float32) for x in (depth.inverse_depth, depth.confidence)]
    if maps[0].shape[0] > size[0]:
        rows, cols = (_around_centres(*counts) for counts in zip(size, maps[0].shape, strict=True))
        four = [np.stack([x[row[:, None], col] for row in rows for col in cols]) for x in maps]
        chosen = np.argsort(four[0], axis=0, kind="stable")[1:2]
        maps = [np.take_along_axis(x, chosen, axis=0)[0] for x in four]
    return DepthEstimate(maps[0], maps[1])


def _around_centres(count: int, of: int) -> tuple[np.ndarray, np.ndarray]:
    """Of a row of pixels, those before and after the centres of ``count`` larger ones."""
    centre = (np.arange(count) + 0.5) * (of / count) - 0.5
    return np.floor(centre).astype(np.intp), np.ceil(centre).astype(np.intp)


def resized(image: np.ndarray, size: tuple[int, int], method: int) -> np.ndarray:
    """An image at another size by a method of OpenCV; the very same one where it has that size."""
    return image if image.shape[:2] == size else np.asarray(cv2.resize(image, size[::-1], interpolation=method))


def _renderer(view: View, cut: Cut, threads: int | None) -> Renderer:
    depth, size = view.known_depth, view.image.shape[:2]
    if depth is None:
        raise ValueError("expected a view with its depth, got one without")
    return MeshRenderer(
        RendererInputs(view.image, view.mask, depth.inverse_depth, depth.confidence, size, cut, threads)
    )


def _crossed(here: View, renderer: Renderer, there: View) -> tuple[Layer, Layer]:
    """The photograph taken ``here``, and what the other view's surface looks like from here."""
    target_from_source = here.pose.inverse() @ there.pose
    other = _rendering(renderer, target_from_source)
    depth = here.known_depth
    if depth is None:
        raise ValueError("expected a view with its depth, got one without")
    size = here.image.shape[:2]
    rho = resized(depth.inverse_depth, size, cv2.INTER_NEAREST)
    weight = np.maximum(resized(depth.confidence, size, cv2.INTER_NEAREST), LEAST_WEIGHT)
    if here.mask is not None:
        rho, weight = np.where(here.mask, rho, np.float32(-1.0)), weight * here.mask
    colour = np.dstack([here.image, weight]).astype(np.float32)
    return Layer.from_arrays(np.ascontiguousarray(rho), colour, Pose(np.eye(3), np.zeros(3))), other


def _rendering(renderer: Renderer, target_from_source: Pose) -> Layer:
    """In memory of its own."""
    seen = renderer(target_from_source)
    return Layer.from_arrays(seen.inverse_depth.copy(), seen.colour, target_from_source)


def _half_way(small: tuple[View, View], renderers: list[Renderer]) -> tuple[Layer, Layer]:
    first, second = (view.pose for view in small)
    pose = Pose(slerp(first.rotation, second.rotation, 0.5), 0.5 * (first.position + second.position))
    found = []
    for view, renderer in zip(small, renderers, strict=True):
        target_from_source = pose.inverse() @ view.pose
        found.append(_rendering(renderer, target_from_source))
    return found[0], found[1]


def _curve(across: list[tuple[Layer, Layer]]) -> ExposureCurve:
    """From all pixels of both photographs that the other view shows as well."""
    samples = [_same_places(own, other) for own, other in across]
    (a_own, a_other, a_weight), (b_own, b_other, b_weight) = samples
    return estimate_curve(
        np.concatenate([a_own, b_other]), np.concatenate([a_other, b_own]), np.concatenate([a_weight, b_weight])
    )


def _same_places(own: Layer, other: Layer) -> tuple[Float32[np.ndarray, "samples 3"], np.ndarray, np.ndarray]:
    """Colours of the photograph and of the other view where both show the same place, and how much each counts."""
    size = own.inverse_depth.shape
    gap = np.abs(own.inverse_depth - other.inverse_depth)
    nearer = np.maximum(own.inverse_depth, other.inverse_depth)
    weight = solid_angles(*size) * np.minimum(own.colour[..., 3], other.colour[..., 3])
    same = (gap <= SAME_SURFACE_TOLERANCE * nearer) & (other.inverse_depth >= 0.0) & (own.inverse_depth >= 0.0) & (weight > 0.0)
    return own.colour[same][:, :3], np.clip(other.colour[same][:, :3], 0.0, 1.0), weight[same]
