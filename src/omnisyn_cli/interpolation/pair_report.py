"""A page that shows why pairs turn out as they do: matches, epipoles, depth and confidence of both panoramas."""

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from jinja2 import Environment, PackageLoader, StrictUndefined

from omnisyn_cli.geometry.pose import at_same_position
from omnisyn_cli.geometry.sphere import direction_to_pixel
from omnisyn_cli.interpolation.checks import check_page
from omnisyn_cli.interpolation.job import TourJob, picture_options
from omnisyn_cli.interpolation.loading import PairSurfaces, PanoramaSurface, tour_surfaces
from omnisyn_cli.interpolation.plan import TourPlan, plan_tour
from omnisyn_cli.interpolation.summary import TourSummary
from omnisyn_cli.io.encode import data_uri, jpeg_bytes
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.poses.estimation import PairDiagnosis, check_poses
from omnisyn_cli.poses.file import PoseFile, distinct_names
from omnisyn_cli.poses.floor import height_in_depth
from omnisyn_cli.poses.registration.diagnosis import camera_height_sentence, diagnosis_sentences
from omnisyn_cli.types import View

PICTURE_COLUMNS = 1024  # width of the pictures in the page: half of a screen
NEAR_PERCENTILE = 98.0  # of inverse depth, which is shown as the nearest


def write_pair_report(job: TourJob) -> TourPlan:
    """Find depth as a video would, with the same errors, and write the page to ``job.output``."""
    check_page(job.output, job.overwrite)
    plan = plan_tour(job)
    poses = PoseFile(job.poses, dict(zip(distinct_names(job.images), plan.entries, strict=True)))
    diagnoses = check_poses(job.images, poses, picture_options(job))
    pairs = [_described(plan, pair, each) for pair, each in zip(tour_surfaces(plan), diagnoses, strict=True)]
    loader = PackageLoader("omnisyn_cli.interpolation", "templates")
    page = Environment(loader=loader, undefined=StrictUndefined, autoescape=True).get_template("pairs.html.j2")
    title = f"{job.images[0].name} to {job.images[-1].name}"
    write_parts(job.output, [page.render(title=title, pairs=pairs, width=PICTURE_COLUMNS).encode()])
    return plan


def _described(plan: TourPlan, pair: PairSurfaces, diagnosis: PairDiagnosis) -> dict[str, Any]:
    """What the page shows of a pair."""
    estimate, matched = diagnosis.diagnosis.estimate, (diagnosis.matches.first, diagnosis.matches.second)
    agrees = np.zeros(len(diagnosis.matches), bool) if estimate is None else estimate.inliers
    kinds = np.select([diagnosis.fits, agrees], ["fits", "contradicts"], "mismatch").tolist()
    first, second = pair.surfaces
    height = height_in_depth((first.view.pose, second.view.pose), (first.depth, second.depth))
    summary = TourSummary(plan, pairs={pair.index: pair.cross_check.confidence})
    return {
        "title": f"{diagnosis.first.name} and {diagnosis.second.name}",
        "lines": [
            *summary.lines(is_report_possible=False),
            *diagnosis_sentences(diagnosis.diagnosis),
            *([] if height is None else [camera_height_sentence(height, summary.found_baseline)]),
        ],
        "views": [
            {
                "name": plan.job.images[surface.index].name,
                "photograph": _jpeg(surface.samples(PICTURE_COLUMNS)),
                "marks": [(*place, kind) for place, kind in zip(_places(directions), kinds, strict=True)],
                "epipoles": _epipoles(surface.view, other.view),
                **_depth(surface),
            }
            for surface, directions, other in zip(pair.surfaces, matched, pair.surfaces[::-1], strict=True)
        ],
    }


def _places(directions: Float[np.ndarray, "n 3"]) -> Iterator[tuple[float, float]]:
    """Where directions are in a picture of the page."""
    row, col = direction_to_pixel(directions, (PICTURE_COLUMNS // 2, PICTURE_COLUMNS))
    for x, y in zip(col, row, strict=True):
        yield round(float(x), 1), round(float(y), 1)


def _epipoles(view: View, other: View) -> Sequence[tuple[float, float]]:
    """Where the other camera is in a view, and the direction away from it; none where both stood at one place."""
    if at_same_position(view.pose, other.pose):
        return ()
    towards = view.pose.rotation.T @ (other.pose.position - view.pose.position)
    return list(_places(np.array([towards, -towards])))


def _depth(surface: PanoramaSurface) -> dict[str, str]:
    """Depth and its confidence as pictures, and in words."""
    inverse_depth, confidence = surface.depth.inverse_depth, surface.depth.confidence
    near = max(float(np.percentile(inverse_depth, NEAR_PERCENTILE)), 1e-9)
    shade = np.sqrt(np.clip(inverse_depth / near, 0.0, 1.0))  # a square root shows far things as well
    colours = cv2.applyColorMap(_reduced(shade), cv2.COLORMAP_TURBO)[..., ::-1]
    middle = float(np.median(inverse_depth))
    half = f"half of it nearer than {1.0 / middle:.3g} m" if middle > 0.0 else "most of it infinitely far"
    return {
        "depth": _jpeg(colours),
        "confidence": _jpeg(_reduced(np.clip(confidence, 0.0, 1.0))),
        "metres": f"from {1.0 / near:.3g} m on, {half}",
        "mean": f"{float(confidence.mean()):.2f}",
    }


def _reduced(values: Float[np.ndarray, "height width"]) -> UInt8[np.ndarray, "rows cols"]:
    """Shares as samples of 8 bits, at the width of the page."""
    size = (PICTURE_COLUMNS, PICTURE_COLUMNS // 2)
    return np.asarray(np.rint(255.0 * cv2.resize(values, size, interpolation=cv2.INTER_AREA)), np.uint8)


def _jpeg(samples: UInt8[np.ndarray, "rows cols *channels"]) -> str:
    return data_uri(jpeg_bytes(samples, 85), "jpeg")
