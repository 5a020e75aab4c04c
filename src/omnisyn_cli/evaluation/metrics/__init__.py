"""How good pictures, depth and video are; ``temporal`` and ``lpips`` are modules of their own."""

from omnisyn_cli.evaluation.metrics.confidence import confidence_metrics, left_right_metrics, merged_reliability
from omnisyn_cli.evaluation.metrics.depth_errors import depth_metrics, scored_pixels
from omnisyn_cli.evaluation.metrics.flying import flying_share
from omnisyn_cli.evaluation.metrics.image import end_psnr, lrce, psnr, ssim, ws_psnr, ws_ssim
from omnisyn_cli.evaluation.metrics.kinds import end_masks, kind_figures
from omnisyn_cli.evaluation.metrics.photographs import photograph_scores
from omnisyn_cli.evaluation.metrics.shards import PhotographEdges, shard_share

__all__ = [
    "PhotographEdges",
    "confidence_metrics",
    "depth_metrics",
    "end_masks",
    "end_psnr",
    "flying_share",
    "kind_figures",
    "left_right_metrics",
    "lrce",
    "merged_reliability",
    "photograph_scores",
    "psnr",
    "scored_pixels",
    "shard_share",
    "ssim",
    "ws_psnr",
    "ws_ssim",
]  # fmt: skip
