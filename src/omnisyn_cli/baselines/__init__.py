"""What this program is compared with: SynSin, the paper's networks and rasteriser, cross-fades.

The main path (``synthesis``, ``render``, ``fusion``) knows none; :mod:`omnisyn_cli.pipeline` makes what users name.
"""
