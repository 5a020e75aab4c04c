"""What a walk consists of: panoramas, pairs of neighbours with their surfaces, and the program's rules as numbers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from omnisyn_cli.fusion.blend_rule import FAR_WEIGHT_OFFSET, BlendOptions
from omnisyn_cli.fusion.confidence import MIN_PAIR_SCORE
from omnisyn_cli.fusion.photometry import ExposureCurve
from omnisyn_cli.fusion.photometry.exposure_matcher import CLIPPING_SRGB, MAX_CLIPPED_WEIGHT_LOSS
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.surfaces import PairSurfaces, PanoramaSurface
from omnisyn_cli.interpolation.viewer.packing import (
    Blocks,
    confidence_codes,
    inverse_depth_codes,
    packed_mask,
    packed_photograph,
)
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.quad_blocks import BOTTOM, QUARTER_DIRECTIONS, QUARTER_INVERSE_DEPTHS, TOP
from omnisyn_cli.render.shade_kernels import MAX_FULL_RESOLUTION_LEVEL, MIP_BIAS
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT

UP_AXIS = 1

MIN_GROUND_COSINE = 0.8
"""Cosine of the angle from straight down up to which ground is looked for."""

DEFAULT_EYE_HEIGHT_METRES = 1.5

STORED_LEVELS = np.linspace(0.0, 1.0, 256)

RULES: Mapping[str, float] = {
    "MIN_VISIBLE_WEIGHT": float(MIN_VISIBLE_WEIGHT),
    "DEPTH_CONFIDENCE_GAIN": DEPTH_CONFIDENCE_GAIN,
    "DISAGREEMENT": BlendOptions.disagreement,
    "HIDDEN": BlendOptions.hidden_weight,
    "ENDS": BlendOptions.ramp_share,
    "FAR_WEIGHT_OFFSET": FAR_WEIGHT_OFFSET,
    "MIP_BIAS": float(MIP_BIAS),
    "MAX_FULL_RESOLUTION_LEVEL": float(MAX_FULL_RESOLUTION_LEVEL),
    "CLIPPING_SRGB": float(CLIPPING_SRGB),
    "MAX_CLIPPED_WEIGHT_LOSS": MAX_CLIPPED_WEIGHT_LOSS,
    "NEAR": 0.02,
}
"""Numbers of the program's own rules that shaders and scripts take from here. ``NEAR``: metres before the eye."""


@dataclass(frozen=True)
class ViewOptions:
    """How a walk is packed.

    Attributes:
        texture: columns that photographs have at most.
        is_lossless: whether photographs are kept as PNG, several times as large, instead of JPEG.
    """

    texture: int = 4096
    is_lossless: bool = False


@dataclass(frozen=True)
class Walk:
    """A walk that has been packed.

    Attributes:
        title: of the page.
        manifest: plain values, see ``docs/view.md``; they name blocks by number.
        blocks: bytes.
    """

    title: str
    manifest: dict[str, Any]
    blocks: Blocks


class TourPacker:
    """Packs the pairs of a tour.

    Args:
        plan: of the tour.
        options: how it is packed.
    """

    def __init__(self, plan: TourPlan, options: ViewOptions) -> None:
        self._plan, self._options, self.blocks = plan, options, Blocks()
        self._panoramas: dict[int, dict[str, Any]] = {}
        self._pairs: dict[int, dict[str, Any]] = {}

    def add(self, pair: PairSurfaces) -> None:
        """One more pair; in the end all of them have to be there."""
        for surface in pair.surfaces:
            if surface.index not in self._panoramas:
                self._panoramas[surface.index] = self._panorama(surface)
        is_ambiguous = self._plan.config.fallback == "crossfade" and pair.check.confidence.score < MIN_PAIR_SCORE
        surfaces = [self._surface(surface.mesh) for surface in pair.surfaces]
        self._pairs[pair.index] = {
            "isCrossFade": is_ambiguous, "exposure": _gains(pair.check.curve), "surfaces": surfaces,
        }  # fmt: skip

    def packed(self) -> Walk:
        """All of it."""
        names = [image.stem for image in self._plan.job.images]
        tables = np.concatenate([QUARTER_INVERSE_DEPTHS.reshape(16, -1), QUARTER_DIRECTIONS.reshape(1, -1)])
        panoramas, pairs = ([found[k] for k in sorted(found)] for found in (self._panoramas, self._pairs))
        manifest = {"panoramas": panoramas, "pairs": pairs, "tables": tables.ravel().tolist(), "files": None}
        return Walk(f"{names[0]} – {names[-1]}", manifest, self.blocks)

    def _panorama(self, surface: PanoramaSurface) -> dict[str, Any]:
        view, width = surface.view, self._options.texture
        content, kind = packed_photograph(surface.samples(width), is_lossless=self._options.is_lossless)
        mask = None
        if view.mask is not None and not view.mask.all():
            mask = self.blocks.add_map(packed_mask(view.mask, width))
        return {
            "name": self._plan.job.images[surface.index].name,
            "eyeHeight": _eye_height(surface),
            "position": view.pose.position.tolist(),
            "rotation": view.pose.rotation.ravel().tolist(),
            "photo": {"block": self.blocks.add(content), **kind},
            "mask": mask,
        }

    def _surface(self, mesh: Mesh) -> dict[str, Any]:
        codes, peak = inverse_depth_codes(mesh.inverse_depth)
        surface_confidence = confidence_codes(mesh)
        return {
            "rows": mesh.size[0],
            "cols": mesh.size[1],
            "peak": peak,
            "poles": _poles(mesh),
            "inverseDepth": self.blocks.add_map(codes),
            "quads": self.blocks.add_map(mesh.quads),
            "trust": None if surface_confidence is None else self.blocks.add_map(surface_confidence),
        }


def _eye_height(surface: PanoramaSurface) -> float:
    """Metres above the ground that lies below a panorama; 1.5 where nothing is known of it."""
    rho, confidence = surface.mesh.inverse_depth, surface.depth.confidence
    down = -(pixel_directions(*surface.mesh.size) @ surface.view.pose.rotation[UP_AXIS])
    is_known = (down > MIN_GROUND_COSINE) & (rho > 0.0) & (confidence > 0.0)
    return float(np.median(down[is_known] / rho[is_known])) if is_known.any() else DEFAULT_EYE_HEIGHT_METRES


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
