"""Depth of a pair without a network: semi-global matching, planes, and filling.

The steps, each in a module of its own: turn the pair until epipolar lines are meridians (:mod:`.rectify`), match both
ways (:mod:`.semi_global`), let large planes explain what they can (:mod:`.surfaces`), keep what both directions agree
on, find the sky, fill the rest and move edges to where the image has them (:mod:`.filling`).
"""

import math
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.threads import both, limited_threads, run_bands
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.geometry.sweep import exchanged_in_epipole_frame, motion_in_baselines
from omnisyn_cli.stereo.stereo_features import Evidence
from omnisyn_cli.stereo.filling import fill, remove_speckles, upsample
from omnisyn_cli.stereo.rectify import RectifiedPair, rectify, resize_area, usable_pixels
from omnisyn_cli.stereo.surface_labels import Matches, MatchingOptions, Meridians, assign_surfaces, match_freely
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["HINT", "MatchingDepthEstimator", "MatchingOptions"]

HINT = 0.002
"""Weight of a disparity that only one direction believes, against 1 for what both agree on."""

NEAR = 0.08
"""Share of a disparity by which both directions may differ, between what they may for far and for near things."""

STEEP = 2.0
"""Disparities of two neighbouring rows that differ by more than this belong to two surfaces.

If more were allowed, noise would confirm itself: the shadow of a lamp on a road without texture fell to pieces.
"""

SPECKLE = 20
"""Pixels at half size: smaller islands are mistakes more often than things."""


@dataclass(frozen=True)
class MatchingDepthEstimator:
    """Inverse depth of both panoramas of a pair by classical stereo; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Estimates have ``options.size`` whatever the size of the images. The sky is 0. Near the two epipoles, where nothing
    can be measured, and wherever only one view sees, values are carried on from the surroundings with a confidence
    near 0. Panoramas from one position have no parallax: everything is then 0 with confidence 0.

    Attributes:
        options: what may be believed.
        threads: at most this many; None = a core each. The result does not depend on it.
    """

    options: MatchingOptions = field(default_factory=MatchingOptions)
    threads: int | None = None

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        for view in (first, second):
            view.check_shape()
        if np.array_equal(first.pose.position, second.pose.position):
            return self._nothing(), self._nothing()
        baseline = float(np.linalg.norm(second.pose.position - first.pose.position))
        there, back = self.evidence(first, second)
        with limited_threads(self.threads):
            return both(lambda: self._finish(first, there, baseline), lambda: self._finish(second, back, baseline))

    def evidence(self, first: View, second: View) -> tuple[Evidence, Evidence]:
        """What is known about both before edges are moved to where the image has them, at half of ``options.size``.

        The panoramas must not stand at one position.
        """
        height, width = self.options.size
        with limited_threads(self.threads):
            pair = rectify(first, second, (height // 2, width // 2))
            there, back = _match(pair, self.options_for(first, second))
            return both(
                lambda: _evidence(first, second, pair, there), lambda: _evidence(second, first, pair.reversed(), back)
            )

    def options_for(self, first: View, second: View) -> MatchingOptions:
        """What may be believed of a pair: colours count less where one of the pictures has lost some."""
        if not (first.is_cut_off or second.is_cut_off):
            return self.options
        return replace(self.options, colour_share=self.options.doubtful_colour_share)

    def _finish(self, view: View, evidence: Evidence, baseline: float) -> DepthEstimate:
        """At full size, with the edges of the image, in 1/metre."""
        guide = resize_area(view.image, self.options.size)
        whole = upsample(np.where(evidence.sky, 0.0, evidence.filled), evidence.image, guide)
        confidence = resize_area(evidence.sure.astype(np.float32), self.options.size)
        return DepthEstimate(whole / np.float32(baseline), confidence, evidence.sure)

    def _nothing(self) -> DepthEstimate:
        return DepthEstimate(np.zeros(self.options.size, np.float32), np.zeros(self.options.size, np.float32))


def _match(pair: RectifiedPair, options: MatchingOptions) -> tuple[Matches, Matches]:
    """Both directions; ``seen`` is what they agree on."""
    pairs = (pair, pair.reversed())
    grids = [Meridians.of(p) for p in pairs]
    found = [match_freely(p, g, options) for p, g in zip(pairs, grids, strict=True)]  # costs take much memory
    (one, _), (other, _) = found
    free = agreeing((one, other), options.agreement, options.near_agreement)
    surfaces = both(
        *(
            partial(assign_surfaces, p, g, f, is_distinct, options)
            for p, g, f, (_, is_distinct) in zip(pairs, grids, free, found, strict=True)
        )
    )
    return agreeing(surfaces, options.agreement, options.near_agreement)


def _evidence(view: View, other: View, pair: RectifiedPair, matches: Matches) -> Evidence:
    """From disparity in the frame of the pair to inverse depth in the frame of the camera, filled."""
    image, usable = resize_area(view.image, pair.size), usable_pixels(view, pair.size)
    inverse_depth, agreed, sky = _in_camera(view, pair, matches)
    weight = np.where(sky, 0.0, np.where(agreed, 1.0, HINT * usable))
    return Evidence(
        image=image,
        matched=inverse_depth,
        agreed=agreed,
        sky=sky,
        filled=np.where(sky, 0.0, fill(inverse_depth, weight, image, usable)),
        usable=usable,
        second_from_first=motion_in_baselines(view.pose, other.pose),
        up=np.asarray(view.pose.rotation[1]),
    )


def _in_camera(view: View, pair: RectifiedPair, matches: Matches) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse depth in 1/baselines, where both directions agree about it, and the sky, in the frame of the camera."""
    size, pose, grid = pair.size, view.pose, Meridians.of(pair)
    at = pair.from_camera(pose, size)
    inverse_depth = at.nearest(grid.inverse_depth(matches.disparity))
    agreed = at.nearest(matches.seen & is_measurable(grid, matches.disparity))
    agreed = remove_speckles(inverse_depth, agreed & usable_pixels(view, size), SPECKLE, 0.1)
    rise = pixel_directions(*size) @ pose.rotation[1]
    sky = find_sky(inverse_depth, agreed & at.nearest(_is_sideways(grid)), rise, solid_angles(*size))
    return inverse_depth, agreed, sky


def agreeing(found: tuple[Matches, Matches], far: float, near: float | None = None) -> tuple[Matches, Matches]:
    """Left-right check of both directions: keep as seen what the other one saw at the same depth.

    Args:
        found: disparities of both.
        far: rows by which they may differ.
        near: rows by which they may differ where they are large; None makes no difference.
    """
    there, back = (
        replace(a, seen=a.seen & _confirmed(a.disparity, exchanged_in_epipole_frame(b.disparity), far, near or far))
        for a, b in (found, found[::-1])
    )
    return there, back


def _confirmed(disparity: np.ndarray, other: np.ndarray, far: float, near: float) -> Bool[np.ndarray, "height width"]:
    """Whether the other direction found the same where this one points to.

    That is between two of its rows. What is near is foreshortened in one of the pictures, where its disparity changes a
    lot from row to row: it is read between them, unless they differ by so much that an edge lies between them.
    """
    out = np.empty(disparity.shape, np.bool_)
    run_bands(partial(_confirm, disparity, other, far, near, NEAR, STEEP, out), len(out))
    return out


@fast_kernel()
def _confirm(disparity, other, far, near, slack, steep, out, begin, end):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for row in range(begin, end):
        for col in range(width):
            value = disparity[row, col]
            target = row + value
            above = min(max(math.floor(target), 0), height - 2)
            share = min(max(target - above, 0.0), 1.0)
            upper, lower = other[above, col], other[above + 1, col]
            found = upper if share < 0.5 else lower
            if abs(lower - upper) <= steep:
                found = upper + share * (lower - upper)
            out[row, col] = target <= height - 1 and abs(found - value) <= min(max(slack * value, far), near)


def is_measurable(grid: Meridians, disparity: np.ndarray) -> Bool[np.ndarray, "height width"]:
    """Not within 4° of an epipole, and no claim of infinity within 20°, where near things hardly move either."""
    away = np.sin(grid.polar_angle) > math.sin(math.radians(4.0))
    return np.asarray(away & ((disparity >= 1.0) | _is_sideways(grid)))


def _is_sideways(grid: Meridians) -> Bool[np.ndarray, "height width"]:
    """Farther than 20° from both epipoles: having no parallax here means being far."""
    sideways = np.sin(grid.polar_angle) > math.sin(math.radians(20.0))
    return np.asarray(np.broadcast_to(sideways, grid.directions.shape[:2]))


NO_PARALLAX = 0.02
"""Inverse depth in 1/baselines that a working resolution of a few hundred rows cannot tell from 0."""

EVIDENCE = 0.05
"""Share of the region where texture must have decided for no parallax."""

LEAST = 0.01
"""Share of the sphere: a smaller region is no sky."""

SPOT = 0.003
"""Share of the sphere: openings in the sky smaller than this are closed."""


def find_sky(
    inverse_depth: Float[np.ndarray, "height width"],
    seen: Bool[np.ndarray, "height width"],
    rise: Float[np.ndarray, "height width"],
    solid_angle: Float[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Where the panorama shows the sky: infinitely far, recognised by what both views say about it, not by its colour.

    A bright wall, an overexposed ceiling or a lamp is as smooth as a cloudless sky. What sets the sky apart is that it
    reaches the zenith, and that wherever it does show something (clouds, a gradient, the rims of what stands before it)
    that something has no parallax.

    Args:
        inverse_depth: in 1/baselines.
        seen: where texture decided about it.
        rise: sine of the elevation above the horizon.
        solid_angle: of every pixel.
    """
    far = (inverse_depth < NO_PARALLAX) & (rise > 0.0)
    region: np.ndarray = _touching_zenith(far, rise)
    size, evidence = (solid_angle * region).sum(), (solid_angle * (region & seen)).sum()
    if size < LEAST * solid_angle.sum() or evidence < EVIDENCE * size:
        return np.zeros_like(far)
    return np.asarray(region | _spots(~region & (rise > 0.0), solid_angle))


def _touching_zenith(mask: np.ndarray, rise: np.ndarray) -> np.ndarray:
    labels = connected_regions(mask, is_diagonal=False)
    inside = np.unique(labels[(rise > 0.9) & mask])
    return np.asarray(np.isin(labels, inside[inside > 0]))


def _spots(mask: np.ndarray, solid_angle: np.ndarray) -> np.ndarray:
    """Small components of a mask."""
    labels = connected_regions(mask, is_diagonal=False)
    size = np.bincount(labels.ravel(), solid_angle.ravel())
    small = size < SPOT * solid_angle.sum()
    small[0] = False
    return np.asarray(small[labels])
