"""Priors of a given error, made from the truth: what a depth network that reaches it would be worth here."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import OmnisynError
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.stereo.expected_depth import NETWORK_SIZE
from omnisyn_cli.stereo.monocular_answer import MonocularAnswer
from omnisyn_cli.types import View

NAME = re.compile(r"simulated\((0?\.\d+)\)")  # of such a prior, with the error
# Full widths at half maximum of the two random fields that the error is the sum of, in equal parts.
ERROR_WIDTHS_DEG = (60.0, 15.0)


@dataclass(frozen=True)
class SimulatedModel:
    """A monocular network that answers the true depth, distorted; it knows the panoramas by their places."""

    views: Sequence[View]  # with the true depth
    error: float  # standard deviation of the logarithm of depth

    def __call__(self, view: View) -> MonocularAnswer:
        """Inverse depth of one of the views; OmnisynError: its true depth is not known."""
        distances = [np.linalg.norm(each.pose.position - view.pose.position) for each in self.views]
        index = int(np.argmin(distances))
        known = self.views[index].known_depth
        if known is None or distances[index] > 0.0:
            raise OmnisynError("expected the true depth of a panorama, which a simulated prior is made from, got none")
        inverse_depth = resize_area(known.inverse_depth, NETWORK_SIZE) * np.exp(self.error * smooth_noise(index))
        return MonocularAnswer(inverse_depth[None], view.pose.rotation[None], ("inverse-depth",))


def smooth_noise(seed: int) -> Float32[np.ndarray, "height width"]:
    """Normal noise of deviation 1, half of it over 60° and half over 15°."""
    generator, height = np.random.default_rng(seed), NETWORK_SIZE[0]
    total = np.zeros(NETWORK_SIZE, np.float32)
    for width in ERROR_WIDTHS_DEG:
        sigma = width / 180.0 * height / 2.355
        blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=sigma, borderType=cv2.BORDER_REFLECT)
        noise = filter_across_seam(blur, generator.normal(size=NETWORK_SIZE).astype(np.float32), NETWORK_SIZE[1] // 2)
        total += noise / (noise.std() * np.sqrt(len(ERROR_WIDTHS_DEG)))
    return total
