"""Fusion networks in ONNX Runtime, at any size that they can halve often enough."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.session import run_network

__all__ = ["SessionFusion", "SessionPainter"]


class SessionFusion:
    """Planes in, corrections out; see :class:`omnisyn_cli.fusion.network.FusionCorrection`.

    Args:
        session: of a fusion model, from :func:`omnisyn_cli.runtime.session.open_session`.

    Raises:
        InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        _check_names(session, ["shift", "colour"])
        self._session = session

    def __call__(
        self, planes: Float32[np.ndarray, "planes height width"]
    ) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "3 height width"]]:
        """The shift of the log-ratio of the weights, and what to add to holes; InputError if the model is broken."""
        height, width = planes.shape[1:]
        shift, colour = run_network(
            self._session, {"planes": planes[None]}, ((1, 1, height, width), (1, 3, height, width))
        )
        return shift[0, 0], colour[0]


class SessionPainter:
    """Planes in, a picture out; see :class:`omnisyn_cli.fusion.painting.Painter`.

    Args:
        session: of a fusion model that paints, from :func:`omnisyn_cli.runtime.session.open_session`.

    Raises:
        InputError: the model is of another kind.
    """

    def __init__(self, session: Any) -> None:
        _check_names(session, ["colour"])
        self._session = session

    def __call__(self, planes: Float32[np.ndarray, "8 height width"]) -> Float32[np.ndarray, "3 height width"]:
        """The picture, not bounded; InputError if the model is broken."""
        (colour,) = run_network(self._session, {"planes": planes[None]}, ((1, 3, *planes.shape[1:]),))
        picture: Float32[np.ndarray, "3 height width"] = colour[0]
        return picture


def _check_names(session: Any, outputs: list[str]) -> None:
    names = [[entry.name for entry in entries] for entries in (session.get_inputs(), session.get_outputs())]
    if names != [["planes"], outputs]:
        raise InputError(
            f"expected a fusion model with the input 'planes' and the outputs {' and '.join(map(repr, outputs))}, "
            f"got {names[0]} and {names[1]}; name another"
        )
