"""A small network of the same build as the real ones."""

from omnisyn_cli.networks.depth_config import DepthConfig

TINY = DepthConfig(
    name="tiny",
    size=(64, 128),
    widths=(8, 12, 16, 16),
    coarse_stride=8,
    levels=16,
    greatest_root=2.0,
    match_channels=8,
    match_groups=2,
    hidden=16,
    volume_filters=0,
    refined_widths=(12, 8),
    reach=2,
)
