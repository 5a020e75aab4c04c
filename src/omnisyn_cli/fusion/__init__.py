"""One picture out of two renderings (paper, section 3.5)."""

from omnisyn_cli.fusion.geometric import GeometricFuser

__all__ = ["GeometricFuser"]
