"""The refinement network in ONNX Runtime, at any size."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.session import run_depth_network

__all__ = ["MULTIPLE", "SessionRefinement"]

MULTIPLE = 32
"""The network halves its input five times: heights and widths are multiples of this."""


class SessionRefinement:
    """Evidence in, inverse depth and confidence out; see :class:`omnisyn_cli.stereo.refined.Refinement`.

    Args:
        session: of a refinement model, from :func:`omnisyn_cli.runtime.session.open_session`.

    Raises:
        InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        names = [entry.name for entry in session.get_inputs()]
        if names != ["planes"]:
            raise InputError(f"expected a refinement model with the input 'planes', got inputs {names}; name another")
        self._session = session

    def __call__(
        self, planes: Float32[np.ndarray, "planes height width"]
    ) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
        """Inverse depth × baseline, and the probability that it is within 10 %; InputError if the model is broken."""
        height, width = planes.shape[1:]
        below, beyond = -height % MULTIPLE, -width % MULTIPLE
        padded = np.pad(planes, ((0, 0), (0, below), (0, 0)), mode="edge")
        padded = np.pad(padded, ((0, 0), (0, 0), (0, beyond)), mode="wrap")
        inverse_depth, confidence = run_depth_network(self._session, {"planes": padded[None]}, padded.shape[1:])
        return inverse_depth[:height, :width], confidence[:height, :width]
