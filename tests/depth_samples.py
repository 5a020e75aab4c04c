"""A small network of the same build as the paper's."""

from omnisyn_cli.networks.paper import PaperConfig

TINY = PaperConfig("tiny", (64, 128), widths=(4, 6, 8, 8, 8, 8), volume_widths=(4, 6, 8, 8), levels=16)
