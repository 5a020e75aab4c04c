"""How a picture was held, learned from generated panoramas: of the six ways to hold one, the right one is known.

Only the weights of the encoder's features are fitted, by a softmax regression over the six ways. Pictures are tilted,
lit otherwise, and some have a disc at the nadir that hides a tripod.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector, rotation_taking
from omnisyn_cli.geometry.sampling import rotated_image
from omnisyn_cli.geometry.sphere import UP, pixel_directions
from omnisyn_cli.networks.attitude import AttitudeConfig, AttitudeNetwork
from omnisyn_cli.networks.efficientnet import from_classifier
from omnisyn_cli.runtime.models import ModelEntry
from omnisyn_cli.training.checkpoint import noise, publish_parts
from omnisyn_cli.training.scene_makers import SceneConfig, take_photograph

# Rotations that turn an upright picture the ways it can be held; the first is upright.
TURNS = tuple(rotation_taking(np.array(up), UP) for up in (UP, -UP, *np.eye(3)[[0, 2]], *-np.eye(3)[[0, 2]]))
HELD_OUT = 5  # Every so many scenes one is for validation
MAX_TILT = math.radians(8.0)
DISC_SHARE, DISC_RADII = 0.5, (0.2, 0.75)  # Of pictures with a disc at the nadir, and its radius in radians
DECAY = 0.03  # Of the weights of features with a standard deviation of 1
RENDER_SCALE = 2  # Of scenes in heights of the network's input


def train_attitude(
    folder: Path, seeds: range, encoder: Mapping[str, Any], *, textures: str | None = None, overwrite: bool = False
) -> ModelEntry:
    """Fit the weights on generated scenes, and add the network to a folder of models as ``attitude``.

    ``encoder`` has the weights of EfficientNet-Lite0. The entry's ``right`` is the share of held-out scenes whose
    attitude is told. Errors: see :func:`omnisyn_cli.training.checkpoint.publish_parts`.
    """
    network = AttitudeNetwork(AttitudeConfig()).eval()
    known = from_classifier(encoder)
    halves = {name: known[name].half().float() for name in network.encoder.state_dict()}
    network.encoder.load_state_dict(halves)
    config = SceneConfig(textures=textures)
    pictures = [picture for seed in seeds if (picture := _picture(seed, config)) is not None]
    features = torch.stack([_features(network, picture) for picture in pictures])
    is_held_out = torch.arange(len(features)) % HELD_OUT == 0
    network.weights.data = fitted_weights(features[~is_held_out])
    right = ((features[is_held_out] @ network.weights).argmax(dim=1) == 0).float().mean()
    network.weights.data = fitted_weights(features)
    size = network.config.size
    made = publish_parts(
        [("attitude", "attitude", network, size, noise(network, size))], folder,
        training=f"{len(pictures)} generated scenes; the encoder ImageNet", licence="Apache-2.0",
        metrics={"right": float(right)}, overwrite=overwrite,
    )  # fmt: skip
    return made[0][0]


def _picture(seed: int, config: SceneConfig) -> Float32[np.ndarray, "height width 3"] | None:
    found = config.scene(seed, 2)
    if found is None:
        return None
    scene, (place, _) = found
    rng, (height, width) = np.random.default_rng([29, seed]), AttitudeConfig.size
    size = RENDER_SCALE * height, RENDER_SCALE * width
    image = take_photograph(scene, place.position, 0.0, 0.0, rng, size, size, supersample=1).image
    image = (image * np.exp(rng.normal(0.0, 0.2) + rng.normal(0.0, 0.05, 3))) ** rng.uniform(0.7, 1.4)
    if rng.random() < DISC_SHARE:
        image[pixel_directions(*size) @ -UP > math.cos(rng.uniform(*DISC_RADII))] = rng.random(3)
    tilt = rotation_from_rotation_vector(rng.uniform(-MAX_TILT, MAX_TILT, 3) * (1.0, 0.0, 1.0))
    return rotated_image(image.clip(0.0, 1.0), np.eye(3), tilt, size).astype(np.float32)


def _features(network: AttitudeNetwork, picture: Float32[np.ndarray, "height width 3"]) -> Tensor:
    """Of the six ways to hold a picture."""
    turned = [rotated_image(picture, turn, np.eye(3), network.config.size) for turn in TURNS]
    with torch.no_grad():
        return network.features(torch.from_numpy(np.stack(turned).transpose(0, 3, 1, 2).astype(np.float32)))


def fitted_weights(features: Tensor) -> Tensor:
    """Weights ``(features, 1)`` of features ``(scenes, ways, features)`` that make the first way the likeliest."""
    deviation = features.flatten(0, 1).std(dim=0) + 1e-3
    scaled, weights = features / deviation, torch.zeros(features.shape[-1], requires_grad=True)
    optimiser = torch.optim.LBFGS([weights], max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value: Tensor = DECAY * weights.square().sum() - torch.log_softmax(scaled @ weights, dim=1)[:, 0].mean()
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimiser.step(loss)  # type: ignore[no-untyped-call]
    return (weights.detach() / deviation)[:, None]
