"""A painted tour with a crossing: far landmarks, and a disc where each panorama sees its neighbours."""

from pathlib import Path

import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import normalize, pixel_directions
from omnisyn_cli.io import write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.poses.tour_file import TOUR_NAME

SIZE = (512, 1024)

# Position and heading, pitch and roll in degrees of every panorama; the first one stands where three ways meet.
PLACES = {
    "hall": ((0.0, 1.5, 0.0), (0.0, 0.0, 0.0)),
    "a b & <c>": ((0.3, 1.4, -2.0), (70.0, 8.0, -5.0)),
    "stairs": ((1.9, 2.4, 0.4), (200.0, -12.0, 20.0)),
    "garden": ((-2.2, 1.5, 0.6), (-95.0, 3.0, 4.0)),
}
LINKS = (("hall", "a b & <c>"), ("hall", "stairs"), ("hall", "garden"))

# Colour, and yaw and pitch in degrees from north, of what is infinitely far.
LANDMARKS = {
    "red": ((235, 20, 20), (140.0, 10.0)),
    "green": ((20, 220, 20), (-60.0, -20.0)),
    "magenta": ((230, 20, 230), (25.0, 35.0)),
}
NEIGHBOUR = (20, 220, 235)
LANDMARK_RADIUS, NEIGHBOUR_RADIUS = np.radians(4.0), np.radians(2.5)


def direction_of(yaw: float, pitch: float) -> np.ndarray:
    """A unit vector to the right of −z and upwards, in degrees."""
    y, p = np.radians([yaw, pitch])
    return np.array([np.cos(p) * np.sin(y), np.sin(p), -np.cos(p) * np.cos(y)])


def pose_of(name: str) -> Pose:
    position, angles = PLACES[name]
    return Pose(rotation_from_heading(*np.radians(angles)), np.array(position))


def painted(name: str) -> np.ndarray:
    """A panorama: grey stripes of the sky, discs for landmarks and neighbours."""
    pose = pose_of(name)
    world = pixel_directions(*SIZE) @ pose.rotation.T
    image = np.repeat((90 + 40 * np.sign(np.sin(9 * world[..., 1:2]))), 3, axis=-1)
    for colour, place in LANDMARKS.values():
        image[world @ direction_of(*place) > np.cos(LANDMARK_RADIUS)] = colour
    for other in (b if a == name else a for a, b in LINKS if name in (a, b)):
        towards = normalize(pose_of(other).position - pose.position)
        image[world @ towards > np.cos(NEIGHBOUR_RADIUS)] = NEIGHBOUR
    return image.astype(np.uint8)


def write_tour(folder: Path) -> Path:
    """The tour as a user's folder: pictures, poses.json, tour.json."""
    folder.mkdir()
    entries = {}
    for name in PLACES:
        write_image(folder / f"{name}.png", painted(name))
        entries[f"{name}.png"] = PosedPanorama(pose_of(name), title=name.title())
    write_poses(folder / "poses.json", entries, links=[(f"{a}.png", f"{b}.png") for a, b in LINKS])
    write_image(folder / "picture.png", np.full((8, 16, 3), 200, np.uint8))
    (folder / TOUR_NAME).write_text(TOUR, encoding="utf-8")
    return folder


TOUR = """{"version": 1, "title": "A tour <script>alert(1)</script>",
 "start": {"panorama": "hall.png", "yaw": 140, "pitch": 10, "fov": 60},
 "panoramas": {"hall.png": {"caption": "Built in \\"1905\\" & <b>rebuilt</b>",
                            "hotspots": [{"text": "Red <i>thing</i>", "yaw": 140, "pitch": 10,
                                          "link": "https://example.org/a,b(c);d?e=1&f"}]}},
 "hotspots": [{"text": "Clock", "point": [1, 2, -3], "image": "picture.png"}]}
"""
