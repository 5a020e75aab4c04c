"""What a walk consists of: panoramas, pairs of neighbours with their surfaces, and the program's rules as numbers.

The tour from outside (``web/dollhouse.js``) has coarse surfaces of all panoramas, without what is far, overhead, or
seen better from elsewhere; only those that face the eye are shown, so walls and ceilings are open towards it.
"""

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.fusion.blend_rule import FAR_WEIGHT_OFFSET, HIDDEN_WEIGHT, RAMP_SHARE
from omnisyn_cli.fusion.exposure_curve import ExposureCurve
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.photometry import CLIPPING_SRGB, MAX_CLIPPED_WEIGHT_LOSS
from omnisyn_cli.geometry.pose import Pose, at_same_position, distance_between
from omnisyn_cli.geometry.sampling import sample_nearest, window_max
from omnisyn_cli.geometry.sphere import UP, angles_to_direction, pixel_directions
from omnisyn_cli.geometry.tolerances import OCCLUSION_SCALE, SAME_POINT_TOLERANCE
from omnisyn_cli.interpolation.loading import PairSurfaces, PanoramaSurface
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.viewer.packing import Blocks, confidence_codes, inverse_depth_codes, packed_mask
from omnisyn_cli.io import read_header
from omnisyn_cli.io.images import read_picture
from omnisyn_cli.io.outputs import real_path
from omnisyn_cli.pipeline.config import make_method
from omnisyn_cli.pipeline.fusions import FuserSettings, make_fuser
from omnisyn_cli.poses.tour import FloorPlan, Hotspot, StartView
from omnisyn_cli.render.mesh import MASKED_INVERSE_DEPTH, Mesh
from omnisyn_cli.render.quad_blocks import BOTTOM, QUARTER_DIRECTIONS, QUARTER_INVERSE_DEPTHS, TOP
from omnisyn_cli.render.shade_kernels import MAX_FULL_RESOLUTION_LEVEL, MIP_BIAS
from omnisyn_cli.synthesis.frame import fuse_frame
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT, KnownDepth

UP_AXIS, DEFAULT_EYE_HEIGHT_METRES = 1, 1.5  # of the world; where no ground is known
# Cosine of the angle from straight down up to which ground is looked for, and the confidence that it needs; the next
# pair counts where nothing is known. From a median absolute deviation to a standard deviation.
GROUND_SEARCHES, MAD_SCALE = ((0.8, 0.0), (0.5, 0.5)), 1.4826
FORMAT_VERSION = 1  # of the manifest; a reader refuses others
HOTSPOT_PIXELS, PLAN_PIXELS = 1600, 2048  # longer side of the pictures of hotspots, and of a floor plan
# Value of a sample that changes nothing, and samples for a change by the whole range.
NO_CORRECTION, CORRECTION_SCALE = 128, 127

# Of the picture: more rows gain nothing. Of the change that is kept, as the network answers a little differently for
# every heading: all of it gains less. In samples: a picture that changes less everywhere is left out.
CORRECTION_ROWS, CORRECTION_SHARE, MIN_CORRECTION = 512, 0.7, 4

STORED_LEVELS = np.linspace(0.0, 1.0, 256)

GRID = (80, 160)  # rows and columns of vertices of a panorama: below its ceiling less than 20,000 triangles
MAX_ELEVATION_SINE = math.sin(math.radians(25.0))  # above, there is a ceiling or the sky. Set by hand.
MIN_SHOWN_CONFIDENCE = 0.1  # less is a guess
# How far from its panorama a surface is shown: mean lengths of links, and metres at the least. Set by hand.
REACH_LINKS, MIN_REACH_METRES = 3.0, 8.0
NEARER_SHARE = 0.98  # of the distance, from which on a panorama that sees a place shows it for others

# Numbers of the program's own rules that shaders and scripts take from here. ``NEAR``: metres before the eye.
RULES: Mapping[str, float] = {
    "MIN_VISIBLE_WEIGHT": float(MIN_VISIBLE_WEIGHT),
    "DEPTH_CONFIDENCE_GAIN": DEPTH_CONFIDENCE_GAIN,
    "DISAGREEMENT": OCCLUSION_SCALE,
    "HIDDEN": HIDDEN_WEIGHT,
    "ENDS": RAMP_SHARE,
    "FAR_WEIGHT_OFFSET": FAR_WEIGHT_OFFSET,
    "MIP_BIAS": float(MIP_BIAS),
    "MAX_FULL_RESOLUTION_LEVEL": float(MAX_FULL_RESOLUTION_LEVEL),
    "CLIPPING_SRGB": float(CLIPPING_SRGB),
    "MAX_CLIPPED_WEIGHT_LOSS": MAX_CLIPPED_WEIGHT_LOSS,
    "SAME_POINT_TOLERANCE": SAME_POINT_TOLERANCE,
    "NO_CORRECTION": float(NO_CORRECTION),
    "CORRECTION_SCALE": float(CORRECTION_SCALE),
    "NEAR": 0.02,
    # standard deviation of a disparity in rows of a surface, at confidence 1: twice that holds 92 % of nine panoramas
    # of generated scenes (balanced, 1 m apart)
    "DISPARITY_STD": 2.0,
}


class TourPacker:
    """Packs the pairs of a tour.

    Inside a chain a panorama may have a surface of its own in both its pairs, as its video has. Elsewhere it has one.
    Photographs have at most ``texture`` columns and are JPEG, or PNG if ``is_lossless``. Blocks are written into the
    folder, or held where there is none.
    """

    def __init__(
        self, plan: TourPlan, texture: int = 4096, *, is_lossless: bool = False, folder: Path | None = None
    ) -> None:
        self._plan, self._texture, self._is_lossless, self.blocks = plan, texture, is_lossless, Blocks(folder)
        self._said = {real_path(panorama.image): panorama for panorama in plan.tour.panoramas}
        self._panoramas: dict[int, dict[str, Any]] = {}
        self._surfaces: list[dict[str, Any]] = []
        self._surface_of: dict[int, int] = {}
        self._coarse: dict[int, np.ndarray] = {}  # of panoramas by their index, for the view from outside
        self._links: dict[int, dict[str, Any]] = {}
        # damaged ones are found before any depth is
        self._pictures = {file: self._picture(file, HOTSPOT_PIXELS) for file in plan.tour.hotspot_pictures}
        self._floor = None if plan.tour.plan is None else self._packed_floor(plan.tour.plan)

    def add(self, pair: PairSurfaces) -> None:
        """One more pair; in the end all of them have to be there."""
        for surface in pair.surfaces:
            if surface.index not in self._panoramas:
                self._panoramas[surface.index] = self._panorama(surface)
                self._coarse[surface.index] = coarse_surface(surface)
        is_ambiguous = pair.cross_check.confidence.scored_db < self._plan.config.faded_below
        gains = _gains(pair.cross_check.curve)
        change = None if is_ambiguous else correction_of(self._plan, pair)
        self._links[pair.index] = {
            "panoramas": [surface.index for surface in pair.surfaces],
            "surfaces": [self._surface(surface) for surface in pair.surfaces],
            "isCrossFade": is_ambiguous,
            "correction": None if change is None else self.blocks.add_photograph(change, is_lossless=self._is_lossless),
            "exposure": None if gains is None else self.blocks.add(zlib.compress(np.array(gains, "<f4").tobytes(), 9)),
        }

    def manifest(self) -> dict[str, Any]:
        """Plain values, see ``docs/view.md``; they name blocks by number."""
        tour = self._plan.tour
        tables = np.concatenate([QUARTER_INVERSE_DEPTHS.reshape(16, -1), QUARTER_DIRECTIONS.reshape(1, -1)])
        panoramas, links = ([found[k] for k in sorted(found)] for found in (self._panoramas, self._links))
        return {
            "version": FORMAT_VERSION, "title": tour.title, "isGeographic": tour.is_geographic,
            "start": self._start(tour.start), "panoramas": panoramas, "links": links, "surfaces": self._surfaces,
            "hotspots": self._hotspots(tour.hotspots), "plan": self._floor,
            "isMetric": tour.is_metric, "dollhouse": self._dollhouse(),
            "tables": tables.ravel().tolist(), "files": None,
        }  # fmt: skip

    def _dollhouse(self) -> dict[str, Any]:
        """One map for all panoramas, see ``docs/view.md``."""
        order, links = sorted(self._coarse), [link["panoramas"] for link in self._links.values()]
        poses = [self._plan.entries[index].pose for index in order]
        codes, peak = inverse_depth_codes(stacked_surfaces([self._coarse[index] for index in order], poses, links))
        return {"inverseDepth": self.blocks.add_map(codes), "peak": peak}

    def _panorama(self, surface: PanoramaSurface) -> dict[str, Any]:
        view, width = surface.view, self._texture
        image = self._plan.job.images[surface.index]
        said = self._said[real_path(image)]
        samples = surface.samples(width)
        mask = None
        if view.mask is not None and not view.mask.all():
            mask = self.blocks.add_map(packed_mask(view.mask, width))
        eye_height, floor_error = _eye_height(surface)
        return {
            "name": said.name, "title": said.title, "caption": said.caption,
            "eyeHeight": eye_height, "floorError": floor_error,
            "position": view.pose.position.tolist(), "rotation": view.pose.rotation.ravel().tolist(),
            "photo": self.blocks.add_levels(samples, is_lossless=self._is_lossless), "mask": mask,
            "hotspots": self._hotspots(said.hotspots, surface),
        }  # fmt: skip

    def _hotspots(self, hotspots: Iterable[Hotspot], surface: PanoramaSurface | None = None) -> list[dict[str, Any]]:
        return [
            {
                "text": each.text, "link": each.link, "image": each.image and self._pictures[each.image],
                "place": _place(each, surface),
            }
            for each in hotspots
        ]  # fmt: skip

    def _picture(self, file: Path, longest_side: int) -> dict[str, Any]:
        """Encoded anew: what else a file holds stays where it is."""
        return self.blocks.add_photograph(read_picture(file, longest_side), is_lossless=file.suffix.lower() == ".png")

    def _packed_floor(self, plan: FloorPlan) -> dict[str, Any]:
        """The floor plan, with the places (x, z) of its upper left, upper right and lower left corner."""
        header, picture = read_header(plan.image), self._picture(plan.image, PLAN_PIXELS)
        # the header tells the sides as stored, the picture stands upright
        upright = max if picture["width"] > picture["height"] else min
        original_width = upright(header.width, header.height)
        scale = original_width / picture["width"]
        corners = ((0, 0), (picture["width"], 0), (0, picture["height"]))
        return {**picture, "corners": [plan.position_of(scale * col, scale * row) for col, row in corners]}

    def _start(self, start: StartView) -> dict[str, Any]:
        """With angles in the world, in degrees."""
        names = [self._said[real_path(image)].name for image in self._plan.job.images]
        index = names.index(start.panorama)
        fov = None if start.fov is None else round(np.degrees(start.fov), 3)
        if start.yaw is None:
            return {"panorama": index, "direction": None, "fov": fov}
        own = angles_to_direction(np.array(start.yaw), np.array(np.radians(90.0) - start.pitch))
        return {"panorama": index, "direction": (self._plan.entries[index].pose.rotation @ own).tolist(), "fov": fov}

    def _surface(self, surface: PanoramaSurface) -> int:
        """The number of the surface; at a crossing that of the first link is taken."""
        is_shared = not self._plan.is_chain
        if is_shared and surface.index in self._surface_of:
            return self._surface_of[surface.index]
        packed = self._packed_surface(surface)
        if packed not in self._surfaces:
            self._surfaces.append(packed)
        number = self._surfaces.index(packed)
        if is_shared:
            self._surface_of[surface.index] = number
        return number

    def _packed_surface(self, surface: PanoramaSurface) -> dict[str, Any]:
        mesh = surface.mesh
        codes, peak = inverse_depth_codes(mesh.inverse_depth)
        surface_confidence = confidence_codes(mesh)
        return {
            "rows": mesh.size[0], "cols": mesh.size[1], "peak": peak, "poles": _poles(mesh),
            "isGiven": surface.view.known_depth is not None,
            "inverseDepth": self.blocks.add_map(codes), "quads": self.blocks.add_map(mesh.quads),
            "trust": None if surface_confidence is None else self.blocks.add_map(surface_confidence),
        }  # fmt: skip


def _eye_height(surface: PanoramaSurface) -> tuple[float, float | None]:
    """Metres above the ground below a panorama, and their standard deviation; 1.5 and None where none is known."""
    rho, confidence = surface.mesh.inverse_depth, surface.depth.confidence
    down = -(pixel_directions(*surface.mesh.size) @ surface.view.pose.rotation[UP_AXIS])
    for least_cosine, least_confidence in GROUND_SEARCHES:
        is_known = (down > least_cosine) & (rho > 0.0) & (confidence > least_confidence)
        if is_known.any():
            heights = down[is_known] / rho[is_known]
            middle = float(np.median(heights))
            return middle, MAD_SCALE * float(np.median(np.abs(heights - middle)))
    return DEFAULT_EYE_HEIGHT_METRES, None


def _place(hotspot: Hotspot, surface: PanoramaSurface | None) -> list[float]:
    """Its point in the world and 1; or its direction and 0 where its panorama sees nothing near."""
    if hotspot.point is not None or surface is None:
        return [*map(float, np.asarray(hotspot.point)), 1.0]
    direction, pose = np.asarray(hotspot.direction), surface.view.pose
    rho = float(sample_nearest(np.maximum(surface.mesh.inverse_depth, 0.0), direction[None])[0])
    if rho == 0.0:
        return [*map(float, pose.rotation @ direction), 0.0]
    return [*map(float, pose.transform(direction / rho)), 1.0]


def _poles(mesh: Mesh) -> list[float | None]:
    """Inverse depth at either pole; None where the ring around it is cut."""
    caps = mesh.piece_inverse_depths(mesh.inverse_depth)[-2 * mesh.size[1] :, 0].reshape(2, -1)
    cuts = [(mesh.quads[row] & edge).any() for row, edge in ((0, TOP), (-1, BOTTOM))]
    return [None if is_cut else float(cap[0]) for is_cut, cap in zip(cuts, caps, strict=True)]


def _gains(curve: ExposureCurve) -> list[list[float]] | None:
    """Stops of 256 levels of red, green and blue, of both pictures of a pair; None where both are exposed alike."""
    if curve.is_identity:
        return None
    of_both = [curve.gains_at(STORED_LEVELS, of_second=of_second) for of_second in (False, True)]
    return [np.round(gains.T, 4).ravel().tolist() for gains in of_both]


def correction_of(plan: TourPlan, pair: PairSurfaces) -> UInt8[np.ndarray, "rows cols 3"] | None:
    """What the fusion network changes half way, as a panorama that looks along −z of the world; None where it does not.

    A page blends by rules alone (:mod:`omnisyn_cli.fusion.blend_rule`). A video also suppresses ghosts and lets a
    network correct the frame. The difference of both half way is small and smooth enough to be kept as a picture.
    """
    first, second = (surface.view for surface in pair.surfaces)
    rows = min(CORRECTION_ROWS, *(view.image.shape[0] // 2 * 2 for view in (first, second)))
    size, threads, config = (rows, 2 * rows), plan.job.threads, plan.config
    if config.fusion != "network" or at_same_position(first.pose, second.pose):
        return None
    waypoint = Waypoint(0, 0.5, Pose(np.eye(3), (first.pose.position + second.pose.position) / 2.0))
    views = [replace(surface.view, known_depth=surface.depth) for surface in pair.surfaces]
    plain = replace(config, renderer="mesh", adaptive=False, edges=False, fallback="none")
    fuser = make_fuser("network", FuserSettings(size, threads, config.fusion_rows, edges=False), device=config.device)
    with limited_threads(threads):
        method = make_method(plain, size, threads=threads, estimator=KnownDepth(), fuser=fuser)
        if not isinstance(method, SurfaceMethod):
            return None
        prepared = method.prepare(0, views).prepared
        rules = GeometricFuser(size, threads=threads, edges=False).blend_by_rule
        by_rule, fused = (
            fuse_frame(prepared, waypoint, one, method.options, method.clock, None).frame.image.copy()
            for one in (rules, fuser)
        )
    change = np.rint(CORRECTION_SCALE * CORRECTION_SHARE * np.clip(fused - by_rule, -1.0, 1.0))
    if np.abs(change).max() < MIN_CORRECTION:
        return None
    return np.asarray(NO_CORRECTION + change, np.uint8)


def coarse_surface(surface: PanoramaSurface) -> Float[np.ndarray, "rows cols"]:
    """Inverse depth (1/metre) of a grid of vertices, negative where a panorama has nothing to show."""
    rays = _rays()
    is_hidden = (rays @ surface.view.pose.rotation.T @ UP > MAX_ELEVATION_SINE) | (
        sample_nearest(surface.depth.confidence, rays) < MIN_SHOWN_CONFIDENCE
    )
    return np.where(is_hidden, MASKED_INVERSE_DEPTH, sample_nearest(surface.mesh.inverse_depth, rays))


def stacked_surfaces(
    surfaces: Sequence[Float[np.ndarray, "rows cols"]], poses: Sequence[Pose], links: Sequence[Sequence[int]]
) -> Float[np.ndarray, "all_rows cols"]:
    """The coarse surfaces of all panoramas, one below the other, each place in that which sees it best."""
    mean_link = float(np.mean([distance_between(poses[first], poses[second]) for first, second in links]))
    reach = max(MIN_REACH_METRES, REACH_LINKS * mean_link)
    shown = []
    for index, (rho, pose) in enumerate(zip(surfaces, poses, strict=True)):
        is_near = rho > 1.0 / reach
        depth = 1.0 / rho[is_near]
        points = pose.position + depth[:, None] * (_rays()[is_near] @ pose.rotation.T)
        is_own = np.ones(len(points), bool)
        for other, elsewhere in enumerate(poses):
            if other != index and distance_between(elsewhere, pose) < 2.0 * reach:
                is_own &= ~_sees_better(surfaces[other], elsewhere, points, depth)
        owned = np.zeros(rho.shape, np.float32)
        owned[is_near] = is_own
        is_shown = is_near & (window_max(owned, 1) > 0.0)  # one vertex more, so that nothing is open between both
        shown.append(np.where(is_shown, rho, MASKED_INVERSE_DEPTH))
    return np.concatenate(shown)


def _sees_better(
    rho: Float[np.ndarray, "rows cols"], pose: Pose, points: Float[np.ndarray, "points 3"],
    depth: Float[np.ndarray, " points"],
) -> Bool[np.ndarray, " points"]:  # fmt: skip
    """Whether a panorama is nearer to points than ``depth``, and its own surface there is the same one."""
    seen = (points - pose.position) @ pose.rotation
    distance = np.linalg.norm(seen, axis=1)
    is_same = np.abs(sample_nearest(rho, seen) * distance - 1.0) < 2.0 * SAME_POINT_TOLERANCE
    return np.asarray(is_same & (distance < NEARER_SHARE * depth))


@cache
def _rays() -> Float[np.ndarray, "rows cols 3"]:
    return pixel_directions(*GRID)
