"""Poses, surfaces and generated pairs that the tests of frames on a device share; the device is the processor."""

import math
from dataclasses import replace

import numpy as np
import torch

from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.photometry import ExposureCurve, ExposureMatcher
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.render.renderer import MeshRenderer, RendererInputs
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.synthesis.device.pair import GpuFrames, GpuPair
from omnisyn_cli.types import DepthEstimate, View

CPU = torch.device("cpu")

ALIKE = ExposureCurve(np.zeros((3, 6)))
BRIGHTER = ExposureCurve(np.linspace(0.3, 0.8, 18).reshape(3, 6))

LEVEL = 1.001 / 255


def moved(*position: float, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pose:
    """Target from source."""
    return Pose(rotation_from_rotation_vector(np.array(turn)), np.array(position, float))


SLIGHTLY = (0.011, -0.007, 0.005)
"""Turned like this, no ray hits an edge by symmetry: which side it falls on would be a matter of rounding."""

POSES = {
    "identity": moved(0.0, 0.0, 0.0),
    "forward": moved(0.0, 0.0, 1.0, turn=SLIGHTLY),
    "up": moved(0.0, -1.5, 0.0, turn=SLIGHTLY),
    "half round": moved(0.0, 1.0, 0.0, turn=(0.01, math.pi, -0.02)),
    "upside down": moved(0.3, 0.0, 0.2, turn=(math.pi, 0.01, 0.02)),
    "poles on the horizon": moved(0.0, 0.5, 0.5, turn=(math.pi / 2, 0.0, 0.0)),
    "any": moved(0.2, -0.6, 0.3, turn=(0.8, -1.9, 0.5)),
    "outside": moved(9.0, 3.0, -7.0, turn=(0.3, 0.2, 1.0)),
}


def rough(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Inverse depths with large steps everywhere, a third of them at infinity."""
    rng = np.random.default_rng(seed)
    return (rng.uniform(0.05, 0.5, (height, width)) * (rng.random((height, width)) > 1 / 3)).astype(np.float32)


def pair_along(kind: str, way: tuple[float, float, float], size: tuple[int, int]) -> tuple[View, View]:
    """Two views of a generated scene with true depth, the second ``way`` metres from the first and turned."""
    scene = generate_scene(kind, 104)
    start = sample_path(scene, 104, 2, baseline=0.5)[0]
    turned = start.rotation @ rotation_from_rotation_vector(np.array([0.2, 0.5, -0.1]))
    views = []
    for pose in (start, Pose(turned, start.position + np.array(way))):
        image, depth = render_panorama(scene, pose, size, threads=1)
        views.append(View(image, pose, None, DepthEstimate(1 / depth, np.ones_like(depth))))
    return views[0], views[1]


def in_8_bits(view: View) -> View:
    samples = np.rint(view.image * 255).astype(np.uint8)
    return replace(view, image=np.float32(samples / np.float32(255)), image_uint8=samples)


def target_between(first: View, second: View, t: float, turn: tuple[float, float, float] = (0.4, 0.3, 0.2)) -> Pose:
    """World from target: between the views, turned about all axes."""
    position = (1 - t) * first.pose.position + t * second.pose.position
    return Pose(rotation_from_rotation_vector(np.array(turn)), position)


def pair_on(device: str, views: tuple[View, View], size: tuple[int, int], curve: ExposureCurve) -> GpuPair:
    frames = GpuFrames(size, device)
    first, second = (
        frames.surface(view.image if view.image_uint8 is None else view.image_uint8, view.mask, view.known_depth)
        for view in views
    )
    return frames.pair(first, second, curve)


def on_device(
    views: tuple[View, View], target: Pose, t: float, size: tuple[int, int], curve: ExposureCurve = ALIKE
) -> np.ndarray:
    """The frame by what is tested."""
    out = np.empty((*size, 3), np.float32)
    poses = [target.inverse() @ view.pose for view in views]
    pair_on("cpu", views, size, curve).frame(*poses, t, out)
    return out


def on_processor(
    views: tuple[View, View], target: Pose, t: float, size: tuple[int, int], curve: ExposureCurve = ALIKE
) -> np.ndarray:
    """The frame by the numba kernels."""
    shown = []
    for view in views:
        pose, depth = target.inverse() @ view.pose, view.known_depth
        image = view.image if view.image_uint8 is None else view.image_uint8
        render = MeshRenderer(RendererInputs(image, view.mask, depth.inverse_depth, depth.confidence, size, threads=1))
        shown.append(render(pose))
    return GeometricFuser(size, threads=1, edges=False)(*ExposureMatcher(curve)(*shown, t), t)


def share_within_a_level(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels whose channels all differ by at most 1/255."""
    return float((np.abs(np.clip(one, 0, 1) - np.clip(other, 0, 1)).max(axis=-1) <= LEVEL).mean())
