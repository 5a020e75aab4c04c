"""Which surface every pixel lies on: one of the large planes, infinity, or whatever semi-global matching saw there.

Planes carry depth over what has no texture of its own, and their windows lean as the plane does, which is what makes
floors under the camera match at all.

Source: the labelling idea of Sinha et al., Piecewise planar stereo for image-based rendering, 2009.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.geometry.sphere import pixel_directions, pixel_to_angles
from omnisyn_cli.geometry.sweep import inverse_depth_from_parallax, parallax_from_inverse_depth
from omnisyn_cli.stereo.costs import census, sweep_cost, warp_cost
from omnisyn_cli.stereo.planes import find_planes
from omnisyn_cli.stereo.rectify import RectifiedPair
from omnisyn_cli.stereo.semi_global import ENDLESS, Bands, aggregate, choose, counted, lead

BEYOND = 4
"""Rows beyond the other epipole, where nothing can be, that are tried all the same: what has no match takes these, and
not the least wrong one. (With none a shadow on a road without texture fell to pieces.)"""

NEAREST = 20.0
"""Largest inverse depth in 1/baselines: nothing closer than a twentieth of a baseline is believed."""


@dataclass(frozen=True)
class MatchingOptions:
    """What semi-global matching and the plane labelling may believe.

    Attributes:
        size: ``(height, width)`` of the estimates; matching runs at half of it.
        widest_parallax: radians; on a path halfway between the cameras a surface that passes at a perpendicular
            distance of h baselines has a parallax of ``2·atan(1 / 2h)``.
        highest_camera: baselines; no camera hovers higher above the ground, so parallax below the horizon has a
            least value. Shading that moves with the camera otherwise passes for infinitely far ground.
        colour_share: weight of colour differences against the census, in [0, 1].
        doubtful_colour_share: the same where much of a picture was cut off at white.
        truncation: colour difference that counts as a contradiction.
        step, jump: penalties of semi-global matching.
        contrast: grey difference across which a jump costs half.
        margin: how much dearer the best rival of a disparity must be for the disparity to count as seen.
        lead: how much dearer, by its own cost, every other disparity must be for a match to propose planes: tiles of a
            ceiling that repeat agree about a plane that is not there.
        planes: most planes per panorama.
        plane_share: least share of the matched solid angle for a plane.
        label_jump, label_contrast: as ``jump`` and ``contrast``, between surfaces.
        seen_bias, unseen_bias: what semi-global matching costs more than a plane where it is sure and where not.
        remote_bias: what a plane costs more far from every point that it was found by, and infinity far from texture
            that stands still: a ceiling is none because a window shows the sky.
        outside: what a surface costs more where it lies beneath the floor or above a ceiling.
        agreement, near_agreement: rows by which both directions may differ about far and about near things.
    """

    size: tuple[int, int] = (512, 1024)
    widest_parallax: float = math.radians(112.0)
    highest_camera: float = 10.0
    colour_share: float = 0.5
    doubtful_colour_share: float = 0.1
    truncation: float = 0.1
    step: float = 0.1
    jump: float = 3.0
    contrast: float = 0.05
    margin: float = 0.2
    lead: float = 0.05
    planes: int = 24
    plane_share: float = 0.008
    label_jump: float = 3.0
    label_contrast: float = 0.15
    seen_bias: float = 0.15
    unseen_bias: float = 0.5
    remote_bias: float = 0.2
    outside: float = 0.3
    agreement: float = 1.0
    near_agreement: float = 2.0


@dataclass(frozen=True)
class Meridians:
    """The grid of a rectified image and its two units: rows of disparity, and inverse depth in 1/baselines."""

    directions: Float[np.ndarray, "height width 3"]
    polar_angle: Float[np.ndarray, "height 1"]
    up: Float[np.ndarray, " 3"]

    @staticmethod
    def of(pair: RectifiedPair) -> Meridians:
        """The grid of a pair."""
        rows = np.arange(pair.size[0], dtype=np.float64)[:, None]
        _, polar_angle = pixel_to_angles(rows, np.zeros_like(rows), pair.size)
        return Meridians(pixel_directions(*pair.size), polar_angle, pair.up)

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.polar_angle.shape[0])

    @property
    def rise(self) -> Float[np.ndarray, "height width"]:
        """Sine of the elevation above the horizon."""
        return np.asarray(self.directions @ self.up)

    def disparity(self, inverse_depth: np.ndarray) -> Float[np.ndarray, "height width"]:
        """Rows for an inverse depth; −1 where it is negative (behind the camera)."""
        parallax = parallax_from_inverse_depth(self.polar_angle, np.maximum(inverse_depth, 0.0))
        return np.where(inverse_depth < 0, -1.0, parallax * (self.height / math.pi)).astype(np.float32)

    def inverse_depth(self, disparity: np.ndarray) -> Float[np.ndarray, "height width"]:
        """In 1/baselines, in [0, :data:`NEAREST`]."""
        parallax = np.maximum(disparity, 0.0) * (math.pi / self.height)
        return np.asarray(np.minimum(inverse_depth_from_parallax(self.polar_angle, parallax), NEAREST))

    def inverse_depth_per_row(self, disparity: np.ndarray) -> Float[np.ndarray, "height width"]:
        """How much inverse depth one row of disparity is worth."""
        far_angle = np.minimum(self.polar_angle + disparity * (math.pi / self.height), math.pi - 1e-3)
        return np.asarray(np.sin(self.polar_angle) / np.sin(far_angle) ** 2 * (math.pi / self.height))


@dataclass(frozen=True)
class Matches:
    """Disparities of one direction.

    Attributes:
        disparity: ``(height, width)`` rows.
        seen: whether texture, and nothing else, decided.
    """

    disparity: Float[np.ndarray, "height width"]
    seen: Bool[np.ndarray, "height width"]


def match_freely(
    pair: RectifiedPair, grid: Meridians, options: MatchingOptions
) -> tuple[Matches, Bool[np.ndarray, "height width"]]:
    """Semi-global matching over all disparities, without planes; and where nothing else matches nearly as well."""
    lowest = _lowest(grid, options)
    bands = _possible(lowest, options)
    cost = sweep_cost(pair.first, pair.second, pair.second_usable, bands, options.colour_share, options.truncation)
    total = aggregate(cost, bands, pair.first.mean(-1), options.step, options.jump, options.contrast)
    disparity, margin = choose(total, bands, is_all=True)
    at_bound = (lowest > 0) & (disparity <= lowest + 1.5)
    matches = Matches(disparity, (margin > options.margin) & ~at_bound & pair.first_usable)
    return matches, lead(cost, bands, disparity) > options.lead


def _possible(lowest: np.ndarray, options: MatchingOptions) -> Bands:
    """From the least disparity of every pixel to the widest parallax, hardly any of which lead beyond the epipole."""
    height = lowest.shape[0]
    widest = max(1, math.ceil(options.widest_parallax / math.pi * height) - 1)
    highest = np.minimum(widest, np.arange(height - 1 + BEYOND, BEYOND - 1, -1))[:, None]
    begin = np.clip(np.ceil(lowest), 0, highest).astype(np.int32)
    return Bands.between(begin, np.broadcast_to(highest, lowest.shape).astype(np.int32))


def assign_surfaces(
    pair: RectifiedPair,
    grid: Meridians,
    free: Matches,
    is_distinct: Bool[np.ndarray, "height width"],
    options: MatchingOptions,
) -> Matches:
    """The surface that explains each pixel best, given free matches that both directions share.

    A plane counts as seen also where it has no texture; a free match does not. Planes are those of distinct matches.
    """
    planes, support = _planes(grid, replace(free, seen=free.seen & is_distinct), options)
    still, is_open = _standing_still(grid, free)
    if is_open:
        support = np.concatenate([support, _nearness(still)[..., None]], axis=-1)
    surfaces = _surfaces(grid, free, planes, options, is_open=is_open)
    cost = _surface_costs(pair, surfaces, options)
    cost += options.outside * (surfaces < _beyond_level(grid, planes, is_open=is_open)[..., None])
    cost[..., 0] += np.where(free.seen, options.seen_bias, options.unseen_bias)
    cost[..., 1:] += options.remote_bias * (1.0 - support)
    labels = Bands.between(np.zeros(cost.shape[:2], np.int32), cost.shape[2] - 1)
    jump, contrast = options.label_jump, options.label_contrast
    total = aggregate(counted(cost).ravel(), labels, pair.first.mean(-1), jump, jump, contrast).reshape(cost.shape)
    total[surfaces < 0] = ENDLESS
    label = total.argmin(axis=-1)
    disparity = np.take_along_axis(surfaces, label[..., None], axis=-1)[..., 0]
    return Matches(disparity, pair.first_usable & ((label > 0) | free.seen))


def _surfaces(
    grid: Meridians, free: Matches, planes: np.ndarray, options: MatchingOptions, *, is_open: bool
) -> np.ndarray:
    """Disparities ``(height, width, candidates)``: the free matches, the planes, and infinity if the sky is open."""
    lowest = _lowest(grid, options)
    candidates = [free.disparity]
    for normal in planes:
        disparity = grid.disparity(grid.directions @ normal)
        candidates.append(np.where(disparity < lowest, np.float32(-1.0), disparity))
    if is_open:
        candidates.append(np.where(grid.rise > 0, 0.0, -1.0).astype(np.float32))
    return np.stack(candidates, axis=-1)


def _surface_costs(pair: RectifiedPair, surfaces: np.ndarray, options: MatchingOptions) -> np.ndarray:
    signature = census(pair.first.sum(axis=-1) / np.float32(3.0))
    share, truncation = options.colour_share, options.truncation
    costs = [
        warp_cost(pair.first, signature, pair.second, pair.second_usable, np.ascontiguousarray(d), share, truncation)
        for d in np.moveaxis(surfaces, -1, 0)
    ]
    return np.stack(costs, axis=-1)


def _lowest(grid: Meridians, options: MatchingOptions) -> np.ndarray:
    """Disparity of ground that lies ``highest_camera`` below; 0 above a tenth of a radian or so under the horizon."""
    return grid.disparity(np.maximum(-grid.rise - 0.17, 0.0) / options.highest_camera)


def _planes(grid: Meridians, free: Matches, options: MatchingOptions) -> tuple[np.ndarray, np.ndarray]:
    """Normals ``(planes, 3)``, and for each how near its points are to every pixel, ``(height, width, planes)``."""
    inverse_depth = grid.inverse_depth(free.disparity)
    usable = free.seen & (inverse_depth < NEAREST)
    tolerance = grid.inverse_depth_per_row(free.disparity)
    solid_angle = np.broadcast_to(np.sin(grid.polar_angle), usable.shape)
    planes = find_planes(
        grid.directions[usable],
        inverse_depth[usable],
        tolerance[usable],
        solid_angle[usable],
        np.nonzero(usable),
        grid.up,
        count=options.planes,
        share=options.plane_share,
    )
    support = np.empty((*usable.shape, len(planes)), np.float32)
    for k, normal in enumerate(planes):
        support[..., k] = _nearness(usable & (np.abs(grid.directions @ normal - inverse_depth) < tolerance))
    return planes, support


def _nearness(mask: np.ndarray) -> np.ndarray:
    """1 among pixels of a mask, falling to 0 some 10° away."""
    height, width = mask.shape
    blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=height / 24.0)
    density = filter_across_seam(blur, mask.astype(np.float32), max(1, width // 8))
    return np.asarray(np.minimum(density / 0.05, 1.0))


def _standing_still(grid: Meridians, free: Matches) -> tuple[Bool[np.ndarray, "height width"], bool]:
    """Where texture above the horizon, away from the epipoles, stands still; and whether that is enough for a sky."""
    above = (grid.rise > 0) & (np.sin(grid.polar_angle) > 0.35)
    still = free.seen & above & (free.disparity < 1.0)
    return still, bool(still.sum() > 0.02 * above.sum())


def _beyond_level(grid: Meridians, planes: np.ndarray, *, is_open: bool) -> np.ndarray:
    """Disparity below which a pixel is clearly farther than the floor or, unless the sky is open, the ceiling.

    They are the best supported level planes underneath and overhead.
    """
    bound = np.full(grid.directions.shape[:2], -1.0, np.float32)
    for side in (-1.0,) if is_open else (-1.0, 1.0):
        for normal in planes:
            nearness = float(np.linalg.norm(normal))
            if side * (normal @ grid.up) > 0.97 * nearness and nearness > 0.03:
                bound = np.maximum(bound, grid.disparity(0.85 * (grid.directions @ normal)) - 1.0)
                break
    return bound
