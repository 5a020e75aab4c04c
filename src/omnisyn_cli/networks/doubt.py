"""How far a finished estimate of depth may be trusted: a network that looks at it and at both pictures.

Matching knows where it was unsure, and completion how likely its answers are, but neither sees the map that came out of
both, nor what the other panorama shows for it. This network does (:func:`omnisyn_cli.stereo.doubt.doubt_planes`), and
says for every pixel how likely its depth is within a tenth of the truth. Other bounds are taught as well.

Source: confidence learned from the disparity map and the pictures together: Tosi, Poggi, Benincasa and Mattoccia,
Beyond local reasoning for stereo confidence estimation with deep learning, 2018.
"""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from omnisyn_cli.networks.interface import Ports
from omnisyn_cli.networks.layers import begin_small
from omnisyn_cli.networks.unet import CorrectingConfig, CorrectingUNet

__all__ = ["ANSWERED", "CONFIDENCE_PLANE", "DOUBT_VARIANTS", "FACTORS", "ROOT_PLANE", "DoubtConfig", "DoubtNetwork"]

ROOT_PLANE, CONFIDENCE_PLANE = 3, 6
"""Of the input: the root of the map, and how far it was trusted so far."""

FACTORS = (1.02, 1.05, 1.10, 1.25)
"""Of a depth and the truth, the larger over the smaller one: bounds that the network is taught the probabilities of."""

ANSWERED = FACTORS.index(1.10)
"""The bound that its file answers with."""


@dataclass(frozen=True)
class DoubtConfig(CorrectingConfig):
    """What makes one doubting network differ from another."""


DOUBT_VARIANTS = {"balanced": DoubtConfig("balanced", planes=27, widths=(32, 48, 64, 96), fine=24)}
"""The networks by name."""


class DoubtNetwork(CorrectingUNet):
    """Planes in, a probability for each of :data:`FACTORS`; any size that is a multiple of ``config.size_multiple``."""

    def __init__(self, config: DoubtConfig) -> None:
        super().__init__(config, answers=len(FACTORS))
        begin_small(self.answer)

    @property
    def ports(self) -> Ports:
        """Planes of any size."""
        return Ports({"planes": self.config.planes}, outputs=("confidence",))

    def forward(self, planes: Float[Tensor, "batch planes height width"]) -> Float[Tensor, "batch 4 height width"]:
        """Logits of the probabilities; see :meth:`answers`."""
        return self.answers(planes)

    def outputs(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """The probability that depth is within a tenth, ``(batch, 1, height, width)``."""
        return (self(*inputs)[:, ANSWERED : ANSWERED + 1].sigmoid(),)
