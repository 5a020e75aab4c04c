"""How many wide pairs get their poses from the pictures: ``python tests/benchmarks/bench_poses.py FOLDER TEXTURES``.

Pairs of all kinds of scenes are made in FOLDER once, with the photographs in TEXTURES: up to 1.5 times as far
apart as the nearest wall, looking anywhere, tilted by up to 20°, differently exposed. The even ones were used for
tuning, the odd ones judge. Prints errors and time of every pair, and a table of both halves with the share of errors
within twice the stated deviation.
"""

import math
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io import read_photographs
from omnisyn_cli.poses.estimation import estimate_poses
from omnisyn_cli.poses.file import PosedPanorama, read_poses, write_poses
from omnisyn_cli.poses.registration.least_squares import direction_error, relative_pose, rotation_error
from omnisyn_cli.scenes import GENERATORS, Photos, generate_scene, pack_photos, render_panorama, sample_path
from omnisyn_cli.scenes.panorama import trace_rays

FIRST_SEED, PAIRS, SIZE = 7_000_000, 36, (1024, 2048)
BASELINES_PER_WALL = (0.3, 1.5)
MAX_TILT = math.radians(20.0)
FOUND, WRONG = (1.0, 3.0), 5.0  # degrees: of rotation and direction of a pair that counts, and of either of a wrong one


def drawn_poses(kind: str, seed: int, photos: Photos) -> tuple[object, list[Pose]]:
    scene, rng = generate_scene(kind, seed, photos), np.random.default_rng([7, seed])
    while True:
        length = math.exp(rng.uniform(math.log(0.5), math.log(8.0)))
        try:
            path = sample_path(scene, int(rng.integers(1 << 30)), 2, baseline=length, vertical=0.0)
        except ValueError:
            continue
        horizon = pixel_directions(16, 64)[7]
        near = min(float(trace_rays(scene, pose.position, horizon)[0].min()) for pose in path)
        if BASELINES_PER_WALL[0] < length / near < BASELINES_PER_WALL[1]:
            break
    poses = []
    for pose in path:
        bearing, tilt, heading = rng.uniform(-math.pi, math.pi), rng.uniform(0.0, MAX_TILT), rng.uniform(-3.1, 3.1)
        axis = np.array([math.cos(bearing), 0.0, math.sin(bearing)])
        poses.append(Pose(rotation_from_rotation_vector(tilt * axis) @ rotation_from_heading(heading), pose.position))
    return scene, poses


def make_pair(folder: Path, kind: str, seed: int, photos: Photos) -> None:
    """Two pictures, as a camera stores them, and their poses."""
    scene, poses = drawn_poses(kind, seed, photos)
    rng = np.random.default_rng([8, seed])
    folder.mkdir(parents=True)
    for name, pose in zip("ab", poses, strict=True):
        image = render_panorama(scene, pose, SIZE, supersample=2)[0]
        exposed = image.clip(0.0, 1.0) ** rng.uniform(0.8, 1.25) * 2.0 ** rng.uniform(-0.5, 0.4) + rng.normal(
            0.0, 0.008, image.shape
        )
        samples = np.rint(exposed.clip(0.0, 1.0) * 255.0).astype(np.uint8)
        cv2.imwrite(str(folder / f"{name}.jpg"), samples[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
    write_poses(folder / "poses.json", {f"{n}.jpg": PosedPanorama(p) for n, p in zip("ab", poses, strict=True)})


def judged(folder: Path) -> tuple[float, ...] | None:
    """Degrees of rotation and direction by which a pair is off, seconds, and both errors over those stated, or None."""
    begin = time.perf_counter()
    images = [folder / "a.jpg", folder / "b.jpg"]
    try:
        found = estimate_poses(images, (1.0,)).panoramas
    except Exception as error:  # noqa: BLE001 - whatever goes wrong is a pair without poses
        print(f"{folder.name:16} refused after {time.perf_counter() - begin:5.1f} s: {str(error)[-160:]}", flush=True)
        return None
    seconds = time.perf_counter() - begin
    truth = read_poses(folder / "poses.json").panoramas
    pair, true_pair = (relative_pose(*(poses[image.name].pose for image in images)) for poses in (found, truth))
    off = np.degrees([rotation_error(pair, true_pair), direction_error(pair, true_pair)])
    print(f"{folder.name:16} rotation {off[0]:7.2f}°  direction {off[1]:7.2f}°  {seconds:5.1f} s", flush=True)
    stated = found["b.jpg"].uncertainty
    ratios = (np.radians(off[0]) / stated.rotation, np.tan(np.radians(off[1])) / stated.position) if stated else ()
    return float(off[0]), float(off[1]), seconds, *ratios


def main() -> None:
    folder, photos = Path(sys.argv[1]), None
    names = []
    for k in range(PAIRS):
        kind = list(GENERATORS)[k // 2 % len(GENERATORS)]
        names.append(folder / f"{k:03d}_{kind}")
        if not names[-1].is_dir():
            photos = photos or pack_photos(read_photographs(Path(sys.argv[2])))
            make_pair(names[-1], kind, FIRST_SEED + k, photos)
    results = [judged(name) for name in names]
    for half, label in ((0, "tuned on"), (1, "judged by")):
        rows = results[half::2]
        accepted = [row for row in rows if row is not None]
        good = sum(row[0] < FOUND[0] and row[1] < FOUND[1] for row in accepted)
        wrong = sum(max(row[:2]) > WRONG for row in accepted)
        seconds = np.mean([row[2] for row in accepted]) if accepted else math.nan
        honest = np.mean([np.less(row[3:], 2.0) for row in accepted], axis=0)
        print(f"{label}: {good} of {len(rows)} found, {wrong} wrong, {len(accepted)} accepted, {seconds:.1f} s each")
        print(f"within twice the stated deviation: rotation {honest[0]:.2f}, direction {honest[1]:.2f}")


if __name__ == "__main__":
    main()
