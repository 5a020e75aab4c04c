"""What two cameras inside a ball see of it."""

import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions

SIZE = (64, 128)
CENTRE, RADIUS = np.array([0.3, -0.2, 0.4]), 3.0
FIRST = Pose(rotation_from_rotation_vector(np.array([0.2, 1.0, -0.1])), np.array([0.1, 0.2, -0.3]))
SECOND = Pose(rotation_from_rotation_vector(np.array([-0.3, -2.0, 0.4])), np.array([0.9, 0.4, 0.7]))


def ball(pose, size=SIZE):
    """Inverse depth and colours, in a camera's own frame."""
    directions = pixel_directions(*size) @ pose.rotation.T
    offset = pose.position - CENTRE
    slope = directions @ offset
    depth = -slope + np.sqrt(slope**2 - offset @ offset + RADIUS**2)
    return 1.0 / depth, 0.5 + 0.5 * (offset + depth[..., None] * directions) / RADIUS
