"""How good pictures, depth and video are."""

from omnisyn_cli.evaluation.metrics.image import ws_psnr

__all__ = ["ws_psnr"]
