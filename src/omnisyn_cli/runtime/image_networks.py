"""Networks in ONNX Runtime that are shown planes of evidence, at any size that they can halve often enough."""

from typing import Any

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.session import run_depth_network, run_network

__all__ = ["CompletionSession", "DirectFusionSession", "ResidualFusionSession"]

SIZE_MULTIPLE = 32
"""The completion network halves its input five times, the other one four: heights and widths are multiples of this."""


class CompletionSession:
    """Planes in, inverse depth and confidence out; see :class:`omnisyn_cli.stereo.stereo_features.CompletionModel`.

    Args:
        session: of a completion model, from :func:`omnisyn_cli.runtime.session.open_session`.

    Raises:
        InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        names = [entry.name for entry in session.get_inputs()]
        if names != ["planes"]:
            raise InputError(f"expected a completion model with the input 'planes', got inputs {names}; name another")
        self._session = session

    def __call__(
        self, planes: Float32[np.ndarray, "planes height width"]
    ) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
        """Inverse depth × baseline, and the probability that it is within 10 %; InputError if the model is broken."""
        padded, (height, width) = _padded(planes), planes.shape[1:]
        inverse_depth, confidence = run_depth_network(self._session, {"planes": padded[None]}, padded.shape[1:])
        return inverse_depth[:height, :width], confidence[:height, :width]


class ResidualFusionSession:
    """Planes in, corrections out; see :class:`omnisyn_cli.fusion.residual.ResidualFusionNetwork`.

    Args:
        session: of a fusion model, likewise.

    Raises:
        InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        self._session = _checked(session, ["shares"])

    def __call__(self, planes: Float32[np.ndarray, "planes height width"]) -> Float32[np.ndarray, "4 height width"]:
        """Shares of candidates; InputError if the model is broken."""
        (shares,) = run_network(self._session, {"planes": planes[None]}, ((1, 4, *planes.shape[1:]),))
        answer: Float32[np.ndarray, "4 height width"] = shares[0]
        return answer


class DirectFusionSession:
    """Planes in, a picture out; see :class:`omnisyn_cli.baselines.direct_fuser.DirectFusionNetwork`.

    Args:
        session: of a fusion model that paints, likewise.

    Raises:
        InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        self._session = _checked(session, ["colour"])

    def __call__(self, planes: Float32[np.ndarray, "8 height width"]) -> Float32[np.ndarray, "3 height width"]:
        """The picture, not bounded; InputError if the model is broken."""
        (colour,) = run_network(self._session, {"planes": planes[None]}, ((1, 3, *planes.shape[1:]),))
        picture: Float32[np.ndarray, "3 height width"] = colour[0]
        return picture


def _padded(planes: Float32[np.ndarray, "planes height width"]) -> Float32[np.ndarray, "planes rows columns"]:
    """Of a size that networks can halve, carried on over the seam and beyond the poles."""
    height, width = planes.shape[1:]
    below, beyond = -height % SIZE_MULTIPLE, -width % SIZE_MULTIPLE
    padded = np.pad(planes, ((0, 0), (0, below), (0, 0)), mode="edge")
    return np.pad(padded, ((0, 0), (0, 0), (0, beyond)), mode="wrap")


def _checked(session: Any, outputs: list[str]) -> Any:
    """The session, of planes and these outputs."""
    names = [[entry.name for entry in entries] for entries in (session.get_inputs(), session.get_outputs())]
    if names != [["planes"], outputs]:
        raise InputError(
            f"expected a model with the input 'planes' and the outputs {' and '.join(map(repr, outputs))}, "
            f"got {names[0]} and {names[1]}; name another"
        )
    return session
