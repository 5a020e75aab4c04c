"""Confidence of frames and of pairs, without ground truth."""

from omnisyn_cli.fusion.confidence.frame_confidence import confidence_step, low_confidence_regions
from omnisyn_cli.fusion.confidence.pair_confidence import MIN_PAIR_SCORE, PairConfidence, assess_pair, compare_windows

__all__ = [
    "MIN_PAIR_SCORE", "PairConfidence", "assess_pair", "compare_windows", "confidence_step", "low_confidence_regions",
]  # fmt: skip
