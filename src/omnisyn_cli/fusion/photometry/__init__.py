"""Pictures taken with different exposure or white balance, brought to one that changes steadily along the way."""

from omnisyn_cli.fusion.photometry.equalize import darken_to_match, rough_exposure_curve
from omnisyn_cli.fusion.photometry.exposure_curve import ExposureCurve, cross_validated_curve, estimate_curve
from omnisyn_cli.fusion.photometry.exposure_matcher import ExposureMatcher

__all__ = [
    "ExposureCurve", "ExposureMatcher", "cross_validated_curve", "darken_to_match", "estimate_curve",
    "rough_exposure_curve",
]  # fmt: skip
