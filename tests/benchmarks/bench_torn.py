"""How torn frames are: ``python tests/benchmarks/bench_torn.py FOLDER ...``.

A frame should consist of things that the photographs show. So its SIFT features, which bear rotation, scale and some
shear, should match features of a photograph within 30 degrees. Printed is the share that does not, of three frames
between the first and the last panorama of a folder with a pose file, for every way of treating pairs of low confidence.
The cross-fade of both photographs says how much of it is mere overlay. Between 72 degrees above and below the horizon.
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

import omnisyn_cli as om
from omnisyn_cli.geometry.sphere import pixel_to_direction
from omnisyn_cli.io import read_panorama
from omnisyn_cli.poses.file import read_poses

# Columns at which features are found; how far away the same may be; greatest distance of square-root descriptors.
WIDTH, MAX_ANGLE, MAX_DISTANCE = 1024, np.radians(30.0), 0.55
# At most so many per picture, and the least contrast of SIFT: low, so that blurred frames have enough.
FEATURES, MIN_CONTRAST = 4000, 0.02


def features(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions and descriptors of a panorama."""
    small = cv2.resize(image, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_AREA)
    wide = np.concatenate([small, small[:, :64]], axis=1)
    points, found = cv2.SIFT_create(FEATURES, contrastThreshold=MIN_CONTRAST).detectAndCompute(
        np.uint8(np.clip(wide, 0.0, 1.0) * 255.0), None
    )
    col, row = np.array([point.pt for point in points]).T
    directions = np.asarray(pixel_to_direction(row, col, (WIDTH // 2, WIDTH)))
    near_horizon = np.abs(directions[:, 1]) < np.sin(np.radians(72.0))
    return directions[near_horizon], np.sqrt(found / found.sum(axis=1, keepdims=True))[near_horizon]


def torn_share(frame: np.ndarray, photographs: list[np.ndarray]) -> float:
    """Share of the features of a frame that neither photograph has nearby."""
    directions, found = features(frame)
    least = np.full(len(found), np.inf)
    for photograph in photographs:
        around, known = features(photograph)
        distance = np.sqrt(np.maximum(2.0 - 2.0 * found @ known.T, 0.0))
        distance[directions @ around.T < np.cos(MAX_ANGLE)] = np.inf
        least = np.minimum(least, distance.min(axis=1))
    return float((least > MAX_DISTANCE).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--poses", default="poses.json", help="name of the pose file")
    arguments = parser.parse_args()
    for folder in arguments.folders:
        names = list(read_poses(folder / arguments.poses).panoramas)
        images = [folder / names[0], folder / names[-1]]
        shares = {}
        with tempfile.TemporaryDirectory() as place:
            for fallback in ("none", "crossfade"):
                frames = Path(place) / fallback
                summary = om.interpolate(
                    images, folder / arguments.poses, frames, frames=5, size="1024x512", fallback=fallback
                )
                shown = [read_panorama(path).image for path in sorted(frames.iterdir())]
                ends = [shown[0], shown[-1]]
                shares[fallback] = np.mean([torn_share(frame, ends) for frame in shown[1:-1]])
            shares["all faded"] = torn_share(0.5 * (ends[0] + ends[1]), ends)
        score = summary.describe()["confidence"]["score"]
        print(f"{folder.name:28} score {score:.2f}  " + "  ".join(f"{name} {v:.3f}" for name, v in shares.items()))


if __name__ == "__main__":
    main()
