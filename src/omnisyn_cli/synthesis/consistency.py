"""Cross-check of a pair: each panorama as the other one's depth predicts it, without ground truth.

The surface of either view is rendered at the other view's position and half way. A point that both show then has a
colour in both pictures. The colours tell how the pictures were exposed (:mod:`omnisyn_cli.fusion.photometry`) and, once
that is corrected, how good depth and poses are (:mod:`omnisyn_cli.fusion.confidence`). All of it is done at a small
size.
"""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import both, limited_threads
from omnisyn_cli.fusion.confidence import PairConfidence, assess_pair
from omnisyn_cli.fusion.exposure_curve import ExposureCurve, cross_validated_curve, estimate_curve
from omnisyn_cli.fusion.photometry import ExposureMatcher, darken_to_match, rough_exposure_curve
from omnisyn_cli.geometry.pose import Pose, at_same_position, slerp
from omnisyn_cli.geometry.resize import resize_area, resize_mask
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.geometry.tolerances import SAME_POINT_TOLERANCE
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.render.renderer import MeshRenderer, Renderer, RendererInputs
from omnisyn_cli.types import DepthEstimate, Layer, View

# Rows and columns that a pair is checked at; if a panorama is smaller, both are at its size.
CROSS_CHECK_SIZE = (256, 512)
EXPOSURE_DEPTH_SIZE = (128, 256)  # rows and columns of the rough depth that exposures are compared with
# Least weight of a photograph's own pixels: their colour is right, however uncertain their depth.
MIN_PHOTO_WEIGHT = np.float32(0.01)


@dataclass(frozen=True)
class CrossCheck:
    """The result of comparing both views of a pair."""

    curve: ExposureCurve  # how much brighter the second picture is than the first
    confidence: PairConfidence  # the expected quality of frames between them


def equalize_exposure(first: View, second: View, threads: int | None = None) -> tuple[View, View]:
    """Both views with one exposure, so that depth can be found in them; the same objects if they have one already.

    If their brightness differs, rough depth tells which pixels show the same points. It comes from the census alone,
    which does not depend on exposure. The colours of these pixels then tell whether the exposure differed. Rough depth
    may be wrong, so what the pixels around one panorama say has to hold around the other one.
    """
    if rough_exposure_curve(first, second).is_identity or at_same_position(first.pose, second.pose):
        return first, second
    from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions

    options = MatchingOptions(size=EXPOSURE_DEPTH_SIZE, colour_weight=0.0, clipped_colour_weight=0.0)
    views = (first, second)
    crossed, *_ = _render_crosswise(views, MatchingDepthEstimator(options, threads)(first, second), Cut(), threads)
    return darken_to_match(first, second, cross_validated_curve(_common_samples(crossed)), threads)


def cross_check(
    views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate], cut: Cut, threads: int | None = None
) -> CrossCheck:
    """Compare two views with each other through their inverse depths, 1/metre; ``cut`` separates surfaces."""
    crossed, small_views, renderers = _render_crosswise(views, depths, cut, threads)
    # from all pixels of both photographs that the other view shows as well
    curve = estimate_curve(*(np.concatenate(values) for values in zip(*_common_samples(crossed), strict=True)))
    match_exposure = ExposureMatcher(curve)
    matched = match_exposure(*crossed[0], 0.0), match_exposure(*crossed[1][::-1], 1.0)[::-1]
    first, second = (view.pose for view in small_views)
    pose = Pose(slerp(first.rotation, second.rotation, 0.5), 0.5 * (first.position + second.position))
    first_layer, second_layer = (
        _render_copy(renderer, pose.inverse() @ view.pose)
        for view, renderer in zip(small_views, renderers, strict=True)
    )
    half_way = match_exposure(first_layer, second_layer, 0.5)
    return CrossCheck(curve, assess_pair(matched, half_way))


def _render_crosswise(
    views: tuple[View, View], depths: tuple[DepthEstimate, DepthEstimate], cut: Cut, threads: int | None
) -> tuple[list[tuple[Layer, Layer]], tuple[View, View], list[Renderer]]:
    """Each photograph beside the other view's surface rendered at its position; both views, small; their renderers."""
    size = min(CROSS_CHECK_SIZE, views[0].image.shape[:2], views[1].image.shape[:2])

    def prepare(view: View, depth: DepthEstimate) -> tuple[View, DepthEstimate, Renderer]:
        """A view at the size of the check, its depth and its surface."""
        image, mask = resize_area(view.image, size), None if view.mask is None else resize_mask(view.mask, size)
        known = subsample_depth(depth, size)
        # as frames have it: kernels compile once
        shown = image if view.image_uint8 is None else resized_to(view.image_uint8, size, cv2.INTER_AREA)
        inputs = RendererInputs(shown, mask, known.inverse_depth, known.confidence, size, cut, threads)
        return View(image, view.pose, mask), known, MeshRenderer(inputs)

    with limited_threads(threads):
        prepared = both(*(partial(prepare, *each) for each in zip(views, depths, strict=True)))
        (first, depth_of_first, of_first), (second, depth_of_second, of_second) = prepared
        crossed = both(
            lambda: _photo_and_other_surface(first, depth_of_first, of_second, second.pose),
            lambda: _photo_and_other_surface(second, depth_of_second, of_first, first.pose),
        )
    return list(crossed), (first, second), [of_first, of_second]


def subsample_depth(depth: DepthEstimate, size: tuple[int, int]) -> DepthEstimate:
    """Larger depth at a smaller size: of the four pixels around the centre of a new one, the second farthest.

    A mean would lie between two surfaces. Always the same one of the four would move every edge to its side.
    """
    maps = [np.asarray(values, np.float32) for values in (depth.inverse_depth, depth.confidence)]
    if maps[0].shape[0] > size[0]:
        rows, cols = (_indices_around_centres(*counts) for counts in zip(size, maps[0].shape, strict=True))
        four = [np.stack([values[row[:, None], col] for row in rows for col in cols]) for values in maps]
        chosen = np.argsort(four[0], axis=0, kind="stable")[1:2]
        maps = [np.take_along_axis(values, chosen, axis=0)[0] for values in four]
    return DepthEstimate(maps[0], maps[1])


def _indices_around_centres(count: int, source_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of ``source_count`` pixels, those before and after the centres of ``count`` larger ones."""
    centre = (np.arange(count) + 0.5) * (source_count / count) - 0.5
    return np.floor(centre).astype(np.intp), np.ceil(centre).astype(np.intp)


def resized_to(image: np.ndarray, size: tuple[int, int], interpolation: int) -> np.ndarray:
    """An image at another size, with an interpolation of OpenCV; the same object if it has that size."""
    return image if image.shape[:2] == size else np.asarray(cv2.resize(image, size[::-1], interpolation=interpolation))


def _photo_and_other_surface(
    view: View, depth: DepthEstimate, other_renderer: Renderer, other: Pose
) -> tuple[Layer, Layer]:
    """The photograph of a view as a layer, and the other view's surface rendered at the same pose."""
    other_layer = _render_copy(other_renderer, view.pose.inverse() @ other)
    size = view.image.shape[:2]
    inverse_depth = resized_to(depth.inverse_depth, size, cv2.INTER_NEAREST)
    weight = np.maximum(resized_to(depth.confidence, size, cv2.INTER_NEAREST), MIN_PHOTO_WEIGHT)
    if view.mask is not None:
        inverse_depth, weight = np.where(view.mask, inverse_depth, np.float32(-1.0)), weight * view.mask
    colour = np.dstack([view.image, weight]).astype(np.float32)
    photo = Layer.from_arrays(np.ascontiguousarray(inverse_depth), colour, Pose(np.eye(3), np.zeros(3)))
    return photo, other_layer


def _render_copy(renderer: Renderer, target_from_source: Pose) -> Layer:
    """A rendered layer in memory of its own: the renderer's next call reuses its buffers."""
    layer = renderer(target_from_source)
    return Layer.from_arrays(layer.inverse_depth.copy(), layer.colour, target_from_source)


def _common_samples(crossed: list[tuple[Layer, Layer]]) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """At each panorama: what the first and the second view show in common, and the weight of each sample."""
    at_first, (own, other, weight) = (_common_colours(*layers) for layers in crossed)
    return [at_first, (other, own, weight)]


def _common_colours(own: Layer, other: Layer) -> tuple[Float32[np.ndarray, "samples 3"], np.ndarray, np.ndarray]:
    """Colours of the photograph and of the other view where both show the same point, and the weight of each."""
    size = own.inverse_depth.shape
    gap = np.abs(own.inverse_depth - other.inverse_depth)
    nearer = np.maximum(own.inverse_depth, other.inverse_depth)
    weight = solid_angles(*size) * np.minimum(own.colour[..., 3], other.colour[..., 3])
    is_seen = (other.inverse_depth >= 0.0) & (own.inverse_depth >= 0.0) & (weight > 0.0)
    is_same = is_seen & (gap <= SAME_POINT_TOLERANCE * nearer)
    return own.colour[is_same][:, :3], np.clip(other.colour[is_same][:, :3], 0.0, 1.0), weight[is_same]
