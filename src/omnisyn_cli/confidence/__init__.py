"""How far a frame, and a clip, can be relied on, without knowing the truth."""

from omnisyn_cli.confidence.frame import confidence_of_frame, doubtful_regions
from omnisyn_cli.confidence.score import LEAST_SCORE, PairConfidence, assess_pair

__all__ = ["LEAST_SCORE", "PairConfidence", "assess_pair", "confidence_of_frame", "doubtful_regions"]
