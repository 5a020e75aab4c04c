"""Networks in ONNX Runtime that map images to images. InputError: a session of another kind, or another answer."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.session import DepthAnswer, run_depth_network, run_network

SIZE_MULTIPLE = 32  # the completion network halves its input five times: heights and widths are multiples of this
Channels = Float32[np.ndarray, "channels height width"]
FUSION_CHANNELS = {"shares": 4, "colour": 3}  # of the answers of networks that fuse, by the name of their output


class CompletionSession:
    """Channels in, inverse depth and confidence out; a :class:`omnisyn_cli.stereo.stereo_features.CompletionModel`."""

    def __init__(self, session: Any) -> None:
        names = [entry.name for entry in session.get_inputs()]
        if names != ["planes"]:
            raise InputError(f"expected a completion model with the input 'planes', got inputs {names}; name another")
        self._session = session

    def __call__(self, channels: Channels) -> DepthAnswer:
        """Inverse depth × baseline, and the probability that it is within 10 %."""
        padded, (height, width) = _padded(channels), channels.shape[1:]
        inverse_depth, confidence = run_depth_network(self._session, {"planes": padded[None]}, padded.shape[1:])
        return inverse_depth[:height, :width], confidence[:height, :width]


class DescriptorSession:
    """A picture in, descriptors out; a :class:`omnisyn_cli.stereo.descriptor_costs.DescriptorModel`."""

    def __init__(self, session: Any) -> None:
        self._session = session

    def __call__(self, image: Channels) -> Float32[np.ndarray, "length rows cols"]:
        """Of colours in [0, 1]; the size is even."""
        height, width = image.shape[1:]
        found = run_network(self._session, {"image": _padded(image)[None]})[0][0]
        return np.asarray(found[:, : height // 2, : width // 2])


class GuidedDepthSession:
    """Two upright panoramas in, depth of the first out; a :class:`omnisyn_cli.stereo.expected_depth.PriorModel`.

    It is opened when first asked.
    """

    def __init__(self, open_session: Callable[[], Any]) -> None:
        self._open_session = open_session

    @cached_property
    def _session(self) -> Any:
        session = self._open_session()
        names = [entry.name for entry in session.get_inputs()]
        if names != ["first", "second", "towards"]:
            raise InputError(
                f"expected a guided depth model with the inputs 'first', 'second' and 'towards', got {names}; name "
                "another"
            )
        return session

    def __call__(self, first: Channels, second: Channels, towards: Float[np.ndarray, " 3"]) -> DepthAnswer:
        """Inverse depth in the unit of ``towards``, and the probability that depth is within 10 %."""
        way = towards.astype(np.float32).reshape(1, 3, 1, 1)
        inputs = {"first": first[None], "second": second[None], "towards": way}
        return run_depth_network(self._session, inputs, first.shape[1:])


class FusionSession:
    """Channels in; out what :data:`FUSION_CHANNELS` names: shares of candidates, or a picture, which is not bounded.

    A :class:`omnisyn_cli.fusion.residual.ResidualFusionNetwork`, or a
    :class:`omnisyn_cli.baselines.direct_fuser.DirectFusionNetwork`.
    """

    def __init__(self, session: Any, output: str) -> None:
        names = [[entry.name for entry in entries] for entries in (session.get_inputs(), session.get_outputs())]
        if names != [["planes"], [output]]:
            raise InputError(
                f"expected a model with the input 'planes' and the outputs {output!r}, got {names[0]} and {names[1]}; "
                "name another"
            )
        self._session, self._out_channels = session, FUSION_CHANNELS[output]

    def __call__(self, channels: Channels) -> Float32[np.ndarray, "out_channels height width"]:
        """The answer for channels of a frame."""
        shape = (1, self._out_channels, *channels.shape[1:])
        return np.asarray(run_network(self._session, {"planes": channels[None]}, (shape,))[0][0])


def _padded(channels: Channels) -> Float32[np.ndarray, "channels rows columns"]:
    """Of a size that networks can halve, carried on over the seam and beyond the poles."""
    height, width = channels.shape[1:]
    below, beyond = -height % SIZE_MULTIPLE, -width % SIZE_MULTIPLE
    padded = np.pad(channels, ((0, 0), (0, below), (0, 0)), mode="edge")
    return np.pad(padded, ((0, 0), (0, 0), (0, beyond)), mode="wrap")
