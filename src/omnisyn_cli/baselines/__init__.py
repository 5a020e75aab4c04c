"""What this program is compared with: SynSin, the paper's networks and rasteriser, cross-fades.

The main path (:mod:`omnisyn_cli.synthesis`, ``render``, ``fusion``) knows none of them; :mod:`omnisyn_cli.pipeline`
makes those that a user names.
"""
