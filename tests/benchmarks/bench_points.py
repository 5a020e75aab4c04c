"""How sparse points on a road get, by how far the camera has moved: ``python tests/benchmarks/bench_points.py``.

The road is a plane 1.6 m below the camera. Looked at is the road up to 3 m around the camera after it has moved, in a
frame of 1024×512, from points of one panorama of this size, and from those of two, one on either side.
"""

import numpy as np

from omnisyn_cli.baselines.points import PointRenderer
from omnisyn_cli.baselines.soft_points import projected_points
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.renderer import RendererInputs

# Of frames in pixels, of the camera in metres, and of the road around the camera in metres.
SIZE, CAMERA_HEIGHT, REACH = (512, 1024), 1.6, 3.0


def main() -> None:
    """Print the points per pixel and the share of pixels that no point covers."""
    down = -pixel_directions(*SIZE)[..., 1]
    road = np.maximum(down, 0.0) / CAMERA_HEIGHT
    near = down > CAMERA_HEIGHT / np.hypot(CAMERA_HEIGHT, REACH)
    inputs = RendererInputs(np.full((*SIZE, 3), 0.5, np.float32), None, road, None, SIZE)
    renderer, first_row = PointRenderer(inputs), int(np.argmax(near.any(axis=1)))
    print("metres  points per pixel  pixels without a point: one panorama  two")
    for metres in (0.0, 1.0, 2.0, 4.0):
        poses = [Pose(np.eye(3), np.array([0.0, 0.0, side * metres])) for side in (1.0, -1.0)]
        cosine = projected_points(road, down > 0.0, poses[0], SIZE, None)[..., 0]
        density = (cosine < np.cos(np.pi * first_row / SIZE[0])).sum() / near.sum()
        empty = [renderer(pose).inverse_depth[near] < 0.0 for pose in poses]
        print(f"{metres:6.0f}{density:18.2f}{empty[0].mean():39.1%}{(empty[0] & empty[1]).mean():5.1%}")


if __name__ == "__main__":
    main()
