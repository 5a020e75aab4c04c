"""The oracle: every pixel against every triangle in plain loops. Slow, obviously right, for tests."""

import numpy as np

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import Triangles
from omnisyn_cli.render.rasterize import NO_FACE, Fragments


def rasterize_reference(
    triangles: Triangles, target_from_source: Pose, size: tuple[int, int], rays: np.ndarray | None = None
) -> Fragments:
    """:func:`omnisyn_cli.render.rasterize.rasterize` in float64, along any rays, for images of some dozen rows."""
    rays = (pixel_directions(*size) if rays is None else rays).reshape(-1, 3)
    nearest, face = np.full(len(rays), -1.0), np.full(len(rays), NO_FACE, np.int32)
    for number, directions, inverse_depth in zip(
        triangles.face, triangles.direction, triangles.inverse_depth, strict=True
    ):
        v0, v1, v2 = directions @ target_from_source.rotation.T + inverse_depth[:, None] * target_from_source.position
        edges = np.stack([np.cross(v1, v2), np.cross(v2, v0), np.cross(v0, v1)])
        determinant = v0 @ edges[0]
        if determinant <= 0:
            continue
        inside = rays @ edges.T
        seen = inside @ inverse_depth / determinant
        wins = (inside >= 0).all(axis=1) & (seen > nearest)
        nearest[wins], face[wins] = seen[wins], number
    return Fragments(nearest.reshape(size).astype(np.float32), face.reshape(size))
