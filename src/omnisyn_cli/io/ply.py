"""Clouds of points as PLY files, binary and little endian.

Source: Turk, The PLY Polygon File Format, 1994.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from omnisyn_cli.io.outputs import write_parts

TYPES = {"<f4": "float", "|u1": "uchar"}
"""PLY's names of numpy's types."""


def write_ply(path: Path, vertices: np.ndarray, comments: Sequence[str] = ()) -> None:
    """Write records (fields ``<f4`` and ``u1``) as the vertices of a PLY file; an existing file is replaced.

    WriteError: the disk is full, or the folder went away.
    """
    names = vertices.dtype.names or ()
    properties = [f"property {TYPES[vertices.dtype[name].str]} {name}" for name in names]
    head = [
        "ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments),
        f"element vertex {len(vertices)}", *properties, "end_header", "",
    ]  # fmt: skip
    write_parts(path, ("\n".join(head).encode("ascii"), vertices.tobytes()))
