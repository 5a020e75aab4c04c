"""How SynSin is taught and judged: pictures made of points, compared with the truth; depth in metres beside it.

The depth network is told the true inverse depth as well as what is wrong with the picture: from pictures alone it would
find a depth that suits them, in no unit that could be compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import Module

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.metrics import ws_psnr
from omnisyn_cli.networks.synsin import SynSinConfig, SynSinNetwork, inverse_depth_of
from omnisyn_cli.render.soft_points_torch import splat_torch
from omnisyn_cli.training.adversarial import adversarial_loss, adversarial_weight, feature_loss, opposing_loss
from omnisyn_cli.training.data import list_pool, load_scene
from omnisyn_cli.training.lessons import Lesson, draw_lessons, make_lesson
from omnisyn_cli.training.losses import depth_scores, polar_weights, root_loss
from omnisyn_cli.training.pictures import depth_pictures

__all__ = [
    "Made",
    "Stage",
    "blend_points",
    "contest_losses",
    "make_pictures",
    "own_loss",
    "show_synsin",
    "validate_synsin",
]

DEPTH_WEIGHT = 0.5
"""Of the absolute error of roots beside that of colours."""


class Stage(Protocol):
    """What is looked at of :class:`omnisyn_cli.training.tasks.TrainConfig`."""

    @property
    def batch(self) -> int:
        """Lessons of a step."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of all pictures."""
        ...

    @property
    def validation_pool(self) -> str:
        """Folder of held-out scenes."""
        ...

    @property
    def validation_pairs(self) -> int:
        """How many of them are looked at."""
        ...


@dataclass(frozen=True)
class Made:
    """What the networks make of lessons.

    Attributes:
        pictures: one for each lesson.
        roots: of the inverse depth of all panoramas of all lessons, in their order.
    """

    pictures: Float[Tensor, "lessons 3 height width"]
    roots: Float[Tensor, "views 1 height width"]


def make_pictures(network: SynSinNetwork, lessons: Sequence[Lesson]) -> Made:
    """Encode all panoramas, blend the points of each lesson, decode all of them at once."""
    device, config = next(network.parameters()).device, network.config
    images = torch.cat([lesson.images for lesson in lessons]).to(device)
    roots, features = network.depth(images).float(), network.encoder(images).float()
    inverse_depth = inverse_depth_of(roots, config)[:, 0]
    blended, begin = [], 0
    for lesson in lessons:
        views = slice(begin, begin + len(lesson.images))
        blended.append(_blended(config, features[views], inverse_depth[views], lesson.target_from_sources))
        begin = views.stop
    return Made(network.decoder(torch.stack(blended)).float(), roots)


@torch.no_grad()
def blend_points(network: SynSinNetwork, lesson: Lesson) -> Float[Tensor, "channels height width"]:
    """What the decoder is shown of a lesson: blended features, and their opacity."""
    inverse_depth = inverse_depth_of(network.depth(lesson.images), network.config)[:, 0]
    return _blended(network.config, network.encoder(lesson.images), inverse_depth, lesson.target_from_sources)


def _blended(config: SynSinConfig, features: Tensor, inverse_depth: Tensor, poses: Sequence[Pose]) -> Tensor:
    size = (features.shape[-2], features.shape[-1])
    return splat_torch(list(features), list(inverse_depth), poses, size, radius=config.radius, most=config.points)


def own_loss(made: Made, lessons: Sequence[Lesson]) -> Tensor:
    """Absolute error of colours, and that of roots of inverse depth; both weighted by solid angle."""
    truth, roots = _truths(made, lessons)
    colours = ((made.pictures - truth).abs() * polar_weights(truth)).mean()
    return colours + DEPTH_WEIGHT * root_loss(made.roots, roots)


def _truths(made: Made, lessons: Sequence[Lesson]) -> tuple[Tensor, Tensor]:
    truth, roots = torch.stack([lesson.truth for lesson in lessons]), torch.cat([lesson.roots for lesson in lessons])
    return truth.to(made.pictures.device), roots.to(made.pictures.device)


def contest_losses(
    network: SynSinNetwork, opponent: Module, pool: list[Path], rng: np.random.Generator, config: Stage, step: int
) -> tuple[Tensor, Tensor]:
    """The loss of the networks and that of their opponent, on lessons drawn from a pool."""
    lessons = draw_lessons(pool, rng, config.batch, config.size)
    made = make_pictures(network, lessons)
    truth, _ = _truths(made, lessons)
    loss, weight = own_loss(made, lessons), adversarial_weight(step)
    true = opponent(truth)
    opposing = opposing_loss(opponent(made.pictures.detach()), true)
    if weight > 0.0:
        seen = opponent(made.pictures)
        loss = loss + weight * (adversarial_loss(seen) + feature_loss(seen, true))
    return loss, opposing


@dataclass(frozen=True)
class _InMetres:
    """A :class:`omnisyn_cli.training.losses.Prediction` of one baseline length; sure of everything."""

    estimate: Tensor

    def inverse_depth(self) -> Tensor:
        """1/metre."""
        return self.estimate

    def confidence(self) -> Tensor:
        """One everywhere."""
        return torch.ones_like(self.estimate)


@torch.no_grad()
def validate_synsin(network: SynSinNetwork, config: Stage) -> dict[str, float]:
    """Mean figures over held-out scenes: WS-PSNR from the first panorama and from both, depth of both."""
    rows = []
    for index in range(min(config.validation_pairs, len(list_pool(Path(config.validation_pool))))):
        lessons = _validation_lessons(config, index)
        made = make_pictures(network, lessons)
        one, two = (_score(picture, lesson) for picture, lesson in zip(made.pictures, lessons, strict=True))
        truth = _truths(made, lessons)[1][1:]
        estimate = _InMetres(inverse_depth_of(made.roots[1:], network.config))
        depths = depth_scores(estimate, truth, torch.ones(len(truth), device=truth.device))
        rows.append((one, two, depths.imae, depths.delta_25))
    means = np.nanmean(rows, axis=0).tolist()
    return dict(zip(("ws_psnr_one_view", "ws_psnr_two_views", "imae", "delta_25"), means, strict=True))


def _validation_lessons(config: Stage, index: int) -> tuple[Lesson, Lesson]:
    """The middle of a scene from its first view, and from its first and last; the last of two from the first, twice."""
    pool = list_pool(Path(config.validation_pool))
    scene = load_scene(pool[index % len(pool)])
    middle, last = len(scene.along) // 2, len(scene.along) - 1
    both = (0, last) if last > middle else (0,)
    return make_lesson(scene, middle, (0,), config.size), make_lesson(scene, middle, both, config.size)


def _score(picture: Tensor, lesson: Lesson) -> float:
    made, truth = (x.permute(1, 2, 0).cpu().numpy() for x in (picture.clamp(0.0, 1.0), lesson.truth))
    return float(ws_psnr(made, truth))


@torch.no_grad()
def show_synsin(network: SynSinNetwork, config: Stage) -> dict[str, np.ndarray]:
    """The first held-out lesson: the truth, the pictures from one panorama and from both, the depth of the first."""
    lessons = _validation_lessons(config, 0)
    made = make_pictures(network, lessons)
    picture = {
        name: image.clamp(0.0, 1.0).permute(1, 2, 0).cpu().numpy()
        for name, image in (("one view", made.pictures[0]), ("two views", made.pictures[1]), ("aim", lessons[0].truth))
    }
    first = lessons[0].images[0].permute(1, 2, 0).numpy()
    root = inverse_depth_of(made.roots[0, 0], network.config).sqrt().cpu().numpy()
    depth = depth_pictures(first, root, lessons[0].roots[0, 0].numpy())
    return {"input": depth["input"], "aim": picture["aim"], "one view": picture["one view"],
            "two views": picture["two views"], "depth": depth["prediction"], "true depth": depth["truth"]}  # fmt: skip
