"""Frames by the kernels of a GPU, in numba's simulator, beside those of the processor; ``test_gpu_frames.py`` runs it.

Prints JSON: by case, the share of the pixels that differ from the processor's by more than 1/255, the share that what
is tested changes, and the largest difference of the confidence maps.
"""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba.cuda.simulator import kernel as simulator

from omnisyn_cli.fusion.exposure_curve import ExposureCurve
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.residual import ResidualFuser
from omnisyn_cli.geometry.perspective import PerspectiveSize
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.synthesis.device.frames import DeviceFrames
from omnisyn_cli.synthesis.frame import Frame
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint, plan_path
from omnisyn_cli.types import DepthEstimate, KnownDepth, View

Pair = tuple[View, View]
SIZE = (32, 64)
BRIGHTER = ExposureCurve(np.linspace(0.3, 0.8, 18).reshape(3, 6))


def view_of(scene: Any, pose: Pose, size: tuple[int, int]) -> View:
    image, depth = render_panorama(scene, pose, size, threads=1)
    return in_8_bits(View(image, pose, None, DepthEstimate(1 / depth, np.ones_like(depth))))


def in_8_bits(view: View) -> View:
    samples = np.rint(view.image * 255).astype(np.uint8)
    return replace(view, image=np.float32(samples / np.float32(255)), image_uint8=samples)


def pair_along(kind: str, way: tuple[float, float, float], size: tuple[int, int]) -> Pair:
    """Two views with true depth, turned to each other."""
    scene = generate_scene(kind, 104)
    start = sample_path(scene, 104, 2, baseline=0.5)[0]
    turned = start.rotation @ rotation_from_rotation_vector(np.array([0.2, 0.5, -0.1]))
    return view_of(scene, start, size), view_of(scene, Pose(turned, start.position + np.array(way)), size)


def cone(view: View, towards: tuple[float, float, float], degrees: float) -> np.ndarray:
    direction = np.array(towards) / np.linalg.norm(towards)
    return pixel_directions(*view.image.shape[:2]) @ direction > math.cos(math.radians(degrees))


def with_ghost(view: View, towards: tuple[float, float, float]) -> View:
    """With something red that the other view does not show."""
    where = cone(view, towards, 25)[..., None]
    return in_8_bits(replace(view, image=np.where(where, np.float32([0.9, 0.05, 0.1]), view.image)))


def shares(channels: np.ndarray) -> np.ndarray:
    """Stands for a fusion network."""
    return np.clip(channels[[0, 7, 4, 2]], 0, 0.4).astype(np.float32)


def between(views: Pair, t: float) -> Waypoint:
    """A place on the way, turned about all axes."""
    position = (1 - t) * views[0].pose.position + t * views[1].pose.position
    pose = Pose(rotation_from_rotation_vector(np.array([0.4, 0.3, 0.2])), position)
    return replace(plan_path([view.pose for view in views], 3)[1], t=t, pose=pose)


def frame_of(
    views: Pair, size: tuple[int, int] = SIZE, t: float = 0.4, fuser: Any = None, curve: ExposureCurve | None = None,
    *, on_gpu: bool = False, floats: bool = False, **options: Any,
) -> Frame:  # fmt: skip
    chosen, fuser = SynthesisOptions(size, threads=1, **options), fuser or GeometricFuser(size, threads=1, edges=False)
    device = DeviceFrames(chosen, fuser) if on_gpu else None
    pair = SurfaceMethod(KnownDepth(), chosen, fuser, device=device).prepare(0, views)
    if curve is not None:
        pair.prepared = replace(pair.prepared, cross_check=replace(pair.prepared.cross_check, curve=curve))
    (frame,) = pair.frames([between(views, t)], None if floats else lambda: np.empty((*size, 3), np.uint8))
    assert device is None or device.failure is None, device.failure
    nearest = max(layer.inverse_depth.max() for layer in pair.renderings(frame.waypoint))
    np.testing.assert_allclose(pair._last.nearest(), nearest, rtol=1e-5)
    return frame


def share_beyond_a_level(one: Frame, other: Frame) -> float:
    scale = 255 if one.image.dtype == np.float32 else 1
    return float((np.abs(scale * one.image.astype(np.float64) - scale * other.image).max(axis=-1) > 1.001).mean())


def main() -> None:
    start = simulator.BlockThread.start  # waited for here: the simulator would ask all the time whether it is done
    simulator.BlockThread.start = lambda thread: (start(thread), thread.join())
    street, room = pair_along("street", (0.1, 0.05, -0.8), (64, 128)), pair_along("room", (0.0, 0.9, 0.05), SIZE)
    haunted = (with_ghost(street[0], (0.5, 0.1, 1.0)), with_ghost(street[1], (-1.0, 0.1, -0.3)))
    masked = tuple(replace(view, mask=~cone(view, (0.1, -1.0, 0.2), 30)) for view in street)
    shown = tuple(replace(view, shows_masked=True) for view in masked)
    turned = (street[0], replace(street[1], pose=Pose(street[1].pose.rotation, street[0].pose.position)))
    exact = tuple(replace(view, image_uint8=None) for view in room)
    large, keeps_ghosts = (64, 128), GeometricFuser((64, 128), threads=1, edges=False)
    keeps_ghosts.ghosts.detect = lambda *layers: None
    network = ResidualFuser(large, shares, 96, threads=1, edges=False)
    # the views, what is given, and what of that is left out, or given otherwise, to show what it changes
    cases = {
        "plain": (street, {}, {"t": 0.5}), "room": (room, {"size": (50, 100)}, {"size": (50, 100), "t": 0.5}),
        "exposure": (street, {"curve": BRIGHTER}, {}),
        "ghosts": (haunted, {"size": large}, {"size": large, "fuser": keeps_ghosts}),
        "holes": (masked, {"t": 0.01}, {"t": 0.5}), "faded masks": (shown, {"t": 0.01}, {"t": 0.5}),
        "edges": (room, {"fuser": GeometricFuser(SIZE, threads=1)}, {}), "adaptive": (street, {"adaptive": True}, {}),
        "confidence": (haunted, {"confidence": True}, {"t": 0.5}), "cross-fade": (haunted, {"faded_below": 99.0}, {}),
        "flat": (street, {"size": PerspectiveSize(36, 64, math.radians(90))}, {"size": PerspectiveSize(36, 64, 1.5)}),
        "network": (haunted, {"size": large, "fuser": network, "curve": BRIGHTER}, {"size": large, "curve": BRIGHTER}),
        "one place": (turned, {"t": 0.3}, {"t": 0.5}),
        "numbers": (exact, {"floats": True}, {"floats": True, "t": 0.5}),
    }  # fmt: skip
    found = {}
    for name, (views, given, without) in cases.items():
        device, processor = frame_of(views, on_gpu=True, **given), frame_of(views, **given)
        found[name] = {
            "beyond": share_beyond_a_level(device, processor),
            "changed": share_beyond_a_level(processor, frame_of(views, **without)),
        }
        if device.confidence is not None:
            found[name]["confidence"] = float(np.abs(device.confidence - processor.confidence).max())
    print(json.dumps(found))


if __name__ == "__main__":
    main()
