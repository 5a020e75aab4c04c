"""Pictures taken with different exposure or white balance, brought to one that changes steadily along the way."""

from omnisyn_cli.fusion.photometry.equalize import equalized, rough_curve
from omnisyn_cli.fusion.photometry.exposure_curve import ExposureCurve, estimate_curve
from omnisyn_cli.fusion.photometry.exposure_matcher import ExposureMatcher

__all__ = ["ExposureCurve", "ExposureMatcher", "equalized", "estimate_curve", "rough_curve"]
