"""What the fusion network changes half way between two panoramas, as a picture that a page adds to its own.

A page blends by rules alone (:mod:`omnisyn_cli.fusion.blend_rule`). A video also suppresses ghosts and lets a network
correct the frame. The difference of both half way is small and smooth enough to be kept as a picture.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import UInt8

from omnisyn_cli.compute.threads import limited_threads
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.surfaces import PairSurfaces
from omnisyn_cli.pipeline.factory import make_method
from omnisyn_cli.pipeline.fusions import FuserSettings, make_fuser
from omnisyn_cli.synthesis.frame import fuse_frame
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import KnownDepth

CORRECTION_ROWS = 512
"""Of the picture; more gain nothing."""

NO_CORRECTION, CORRECTION_SCALE = 128, 127
"""Value of a sample that changes nothing, and samples for a change by the whole range."""

CORRECTION_SHARE = 0.7
"""Of the change that is kept. The network answers a little differently for every heading; all of it gains less."""

MIN_CORRECTION = 4
"""Samples; a picture that changes less nowhere is left out."""


def correction_of(plan: TourPlan, pair: PairSurfaces) -> UInt8[np.ndarray, "rows cols 3"] | None:
    """What is added half way, as a panorama whose centre looks along −z of the world; None where nothing is.

    Args:
        plan: of the tour; its config says whether a network fuses.
        pair: two neighbours and their surfaces.
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
