"""How SynSin is taught and judged: pictures made of points, compared with the truth; depth in metres beside it.

It learns from samples of walks, looking anywhere. The depth network learns from the true inverse depth as well: from
the error of pictures alone it would find a depth that suits them, in an unknown unit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.baselines import soft_points
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sampling import rotated_directions, rotated_image, sample_nearest
from omnisyn_cli.geometry.sphere import normalize, pixel_directions
from omnisyn_cli.networks.interface import DepthPrediction
from omnisyn_cli.networks.synsin import SynSinConfig, SynSinNetwork, inverse_depth_of
from omnisyn_cli.training.data import Walk, draw_walk, load_walk
from omnisyn_cli.training.losses import depth_scores, polar_weights, sqrt_inv_depth_loss
from omnisyn_cli.training.pictures import as_array, depth_pictures


@dataclass(frozen=True)
class ViewSample:
    """One picture and what it is made of; all panoramas are upright and held alike."""

    images: Float[Tensor, "views 3 height width"]  # of the panoramas, RGB in [0, 1]
    sqrt_inv_depths: Float[Tensor, "views 1 height width"]  # of their true inverse depths, m^-½; NaN: not known
    target_from_sources: tuple[Pose, ...]  # where the panoramas are, seen from the target
    truth: Float[Tensor, "3 height width"]  # what is to be seen


def draw_views(pool: list[Path], rng: np.random.Generator, count: int, size: tuple[int, int]) -> list[ViewSample]:
    """Samples of random scenes with one panorama and with two, in turn; turned, mirrored and tinted at random."""
    drawn = []
    for index in range(count):
        walk = draw_walk(pool, rng)
        target, sources = _chosen(len(walk.positions), 1 + index % 2, rng)
        sample = view_sample(walk, target, sources, size, heading=rng.uniform(-np.pi, np.pi))
        drawn.append(_varied(sample, rng))
    return drawn


def _chosen(views: int, wanted: int, rng: np.random.Generator) -> tuple[int, tuple[int, ...]]:
    """A target between two panoramas, or beside one; scenes of two views have nothing between."""
    if wanted == 2 and views > 2:
        first, target, second = (int(k) for k in np.sort(rng.choice(views, 3, replace=False)))
        return target, (first, second)
    near = int(rng.integers(views - 1))
    return (near, (near + 1,)) if rng.random() < 0.5 else (near + 1, (near,))


def view_sample(
    walk: Walk, target: int, sources: tuple[int, ...], size: tuple[int, int], *, heading: float = 0.0
) -> ViewSample:
    """A sample of a walk: views made of others, by their indices; all are turned by a heading, radians."""
    own, held = np.eye(3), rotation_from_heading(heading)

    def colours(view: int) -> np.ndarray:
        shown = rotated_image(walk.images[view].astype(np.float32) / np.float32(255.0), own, held, size)
        return np.ascontiguousarray(shown.transpose(2, 0, 1), np.float32)

    directions = rotated_directions(size, own, held)
    sqrt_inv_depths = [np.sqrt(sample_nearest(walk.inverse_depth[view], directions))[None] for view in sources]
    positions = walk.positions.astype(np.float64)
    moved = [held.T @ (positions[view] - positions[target]) for view in sources]
    return ViewSample(
        images=torch.from_numpy(np.stack([colours(view) for view in sources])),
        sqrt_inv_depths=torch.from_numpy(np.stack(sqrt_inv_depths).astype(np.float32)),
        target_from_sources=tuple(Pose(np.eye(3), offset) for offset in moved),
        truth=torch.from_numpy(colours(target)),
    )


def _varied(sample: ViewSample, rng: np.random.Generator) -> ViewSample:
    """All pictures lit and tinted alike, and mirrored or not."""
    tint = torch.from_numpy((rng.uniform(0.7, 1.1) * rng.uniform(0.93, 1.07, (3, 1, 1))).astype(np.float32))
    gamma = float(rng.uniform(0.8, 1.25))
    images, truth = ((tint * x.clamp(min=1e-4) ** gamma).clamp(max=1.0) for x in (sample.images, sample.truth))
    sqrt_inv_depths, poses = sample.sqrt_inv_depths, sample.target_from_sources
    if rng.random() < 0.5:
        images, sqrt_inv_depths, truth = images.flip(-1), sqrt_inv_depths.flip(-1), truth.flip(-1)
        mirror = np.array([-1.0, 1.0, 1.0])
        poses = tuple(Pose(pose.rotation, mirror * pose.position) for pose in poses)
    return ViewSample(images, sqrt_inv_depths, poses, truth)


DEPTH_WEIGHT = 0.5  # Weight of the absolute error of √(inverse depth) beside that of colours


@dataclass(frozen=True)
class SynSinPrediction(DepthPrediction):
    """What the networks make of samples; their depth is in metres, as of baselines of one metre, and sure."""

    pictures: Float[Tensor, "samples 3 height width"]  # one for each sample
    sqrt_inv_depths: Float[Tensor, "views 1 height width"]  # of the inverse depth of all panoramas of all samples
    config: SynSinConfig  # of the networks

    def inverse_depth(self) -> Float[Tensor, "views 1 height width"]:
        """1/metre."""
        return inverse_depth_of(self.sqrt_inv_depths, self.config)

    def confidence(self) -> Float[Tensor, "views 1 height width"]:
        """One everywhere."""
        return torch.ones_like(self.sqrt_inv_depths)


def render_pictures(network: SynSinNetwork, samples: Sequence[ViewSample]) -> SynSinPrediction:
    """Encode all panoramas, blend the points of each sample, decode all of them at once."""
    images = torch.cat([sample.images for sample in samples])
    sqrt_inv_depths, features = network.depth(images).float(), network.encoder(images).float()
    inverse_depth = inverse_depth_of(sqrt_inv_depths, network.config)[:, 0]
    blended, begin = [], 0
    for sample in samples:
        views = slice(begin, begin + len(sample.images))
        blended.append(_blend(network.config, features[views], inverse_depth[views], sample.target_from_sources))
        begin = views.stop
    return SynSinPrediction(network.decoder(torch.stack(blended)).float(), sqrt_inv_depths, network.config)


@torch.no_grad()
def blend_points(network: SynSinNetwork, sample: ViewSample) -> Float[Tensor, "channels height width"]:
    """What the decoder is shown of a sample: blended features, and their opacity."""
    inverse_depth = inverse_depth_of(network.depth(sample.images), network.config)[:, 0]
    return _blend(network.config, network.encoder(sample.images), inverse_depth, sample.target_from_sources)


def _blend(config: SynSinConfig, features: Tensor, inverse_depth: Tensor, poses: Sequence[Pose]) -> Tensor:
    size = (features.shape[-2], features.shape[-1])
    return splat_torch(list(features), list(inverse_depth), poses, size, radius=config.radius, most=config.points)


def reconstruction_loss(made: SynSinPrediction, samples: Sequence[ViewSample]) -> Tensor:
    """Absolute error of colours, and that of √(inverse depth); both weighted by solid angle."""
    truth = torch.stack([sample.truth for sample in samples])
    colours = ((made.pictures - truth).abs() * polar_weights(truth)).mean()
    return colours + DEPTH_WEIGHT * sqrt_inv_depth_loss(
        made.sqrt_inv_depths, torch.cat([sample.sqrt_inv_depths for sample in samples])
    )


def load_views(path: Path, size: tuple[int, int]) -> list[ViewSample]:
    """The middle of a scene from its first view, and from its first and last; the last of two from the first, twice."""
    walk = load_walk(path)
    middle, last = len(walk.positions) // 2, len(walk.positions) - 1
    both = (0, last) if last > middle else (0,)
    return [view_sample(walk, middle, sources, size) for sources in ((0,), both)]


def synsin_scores(made: SynSinPrediction, samples: Sequence[ViewSample]) -> dict[str, float]:
    """WS-PSNR from the first panorama and from both, depth of both, of :func:`load_views`."""
    one, two = (
        float(ws_psnr(as_array(picture.clamp(0.0, 1.0)), as_array(sample.truth)))
        for picture, sample in zip(made.pictures, samples, strict=True)
    )
    both = SynSinPrediction(made.pictures[1:], made.sqrt_inv_depths[1:], made.config)
    truth = samples[1].sqrt_inv_depths
    depths = depth_scores(both, truth, torch.ones(len(truth), device=truth.device))
    return {"ws_psnr_one_view": one, "ws_psnr_two_views": two, "imae": depths["imae"], "delta_25": depths["delta_25"]}


def synsin_pictures(made: SynSinPrediction, samples: Sequence[ViewSample]) -> dict[str, np.ndarray]:
    """The truth, the pictures from one panorama and from both, the depth of the first, of :func:`load_views`."""
    one, two = (as_array(picture.clamp(0.0, 1.0)) for picture in made.pictures)
    first = samples[0]
    depth = depth_pictures(first.images[0], made.inverse_depth()[0, 0].sqrt(), first.sqrt_inv_depths[0, 0])
    shown = {"input": depth["input"], "aim": as_array(first.truth), "one view": one, "two views": two}
    return shown | {"depth": depth["prediction"], "true depth": depth["truth"]}


def splat_torch(
    features: Sequence[Float[Tensor, "channels height width"]],
    inverse_depths: Sequence[Float[Tensor, "height width"]], target_from_sources: Sequence[Pose],
    size: tuple[int, int], *, radius: float = soft_points.POINT_RADIUS_ROWS, most: int = soft_points.POINTS_PER_PIXEL,
) -> Float[Tensor, "channels+1 rows cols"]:  # fmt: skip
    """:func:`omnisyn_cli.baselines.soft_points.splat` with gradients, channels first, on the source's device.

    Which points a pixel sees, and in which order, is found without gradients; their distances, opacities and blend
    follow again, in the source's precision, from the formulas there. A disc's opacity is 0 at its rim, so nothing jumps
    where a point enters or leaves a pixel; where two points change places in depth it does: that step has no gradient.
    """
    depths = [inverse_depth.detach().cpu().numpy() for inverse_depth in inverse_depths]
    lists = soft_points.list_visible(depths, target_from_sources, size, radius=radius, most=most)
    found = torch.from_numpy(lists.found).to(inverse_depths[0].device).view(-1, most)
    centres = torch.cat(list(map(_directions, inverse_depths, target_from_sources)))
    shares, opacity = _shares(centres, found, size, radius)
    values = torch.cat([each.flatten(1) for each in features], dim=1).T.to(centres.dtype)
    blended = functional.embedding_bag(found.clamp(min=0), values, mode="sum", per_sample_weights=shares)
    return torch.cat([blended, opacity[:, None]], dim=1).T.reshape(-1, *size)


def _directions(inverse_depth: Float[Tensor, "height width"], target_from_source: Pose) -> Float[Tensor, "points 3"]:
    """Where the target sees every pixel."""
    rotation, translation = (
        torch.from_numpy(array).to(inverse_depth)
        for array in (target_from_source.rotation, target_from_source.position)
    )
    own = torch.from_numpy(pixel_directions(*inverse_depth.shape)).to(inverse_depth)
    moved: Tensor = normalize(own @ rotation.T + inverse_depth[..., None] * translation)
    return moved.view(-1, 3)


def _shares(
    centres: Float[Tensor, "points 3"], found: Int[Tensor, "pixels most"], size: tuple[int, int], radius: float
) -> tuple[Float[Tensor, "pixels most"], Float[Tensor, " pixels"]]:
    """What part of its pixel every listed point is, and the sum."""
    rays = torch.from_numpy(pixel_directions(*size)).to(centres).view(-1, 1, 3)
    apart = functional.embedding(found.clamp(min=0), centres) - rays
    largest = 2.0 * math.sin(0.5 * soft_points.disc_angle(radius, size[0]))
    square = apart.square().sum(dim=-1) / largest**2
    alpha = (1.0 - square.clamp(soft_points.MIN_DIVISOR_OPACITY, 1.0).sqrt()) * (found >= 0)
    left = (1.0 - alpha).cumprod(dim=1)
    before = torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], dim=1)
    return alpha * before, 1.0 - left[:, -1]
