"""How good pictures, depth and video are; ``temporal`` and ``lpips`` are modules of their own."""

from omnisyn_cli.metrics.depth import DepthMetrics, depth_metrics, scored_pixels
from omnisyn_cli.metrics.image import lrce, psnr, row_weights, ssim, ws_psnr, ws_ssim

__all__ = [
    "DepthMetrics",
    "depth_metrics",
    "lrce",
    "psnr",
    "row_weights",
    "scored_pixels",
    "ssim",
    "ws_psnr",
    "ws_ssim",
]
