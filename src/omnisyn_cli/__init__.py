"""OmniSyn: the 360° video between two panoramas (Li et al., IEEE VR 2022), as a library and the command ``omnisyn``.

The names below are those of :mod:`omnisyn_cli.interpolation.api` and :mod:`omnisyn_cli.evaluation.public_api`. They are
imported when they are used, so that importing the package takes no time.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omnisyn_cli.evaluation.public_api import evaluate, score
    from omnisyn_cli.interpolation.api import (
        PRESETS,
        DepthEstimate,
        DepthEstimator,
        DepthSource,
        Fuser,
        Layer,
        Pose,
        RunConfig,
        View,
        estimate_depth,
        interpolate,
        make_frames,
        read_views,
        write_video,
    )

__version__ = "0.1.0"

for _name in ("ORT_DISABLE_TELEMETRY", "ORT_TELEMETRY_DISABLED"):  # either, by release
    os.environ.setdefault(_name, "1")
"""Releases of ONNX Runtime from 1.29 on tell their maker about every session, unless this is set before they load."""

__all__ = [
    "PRESETS", "DepthEstimate", "DepthEstimator", "DepthSource", "Fuser", "Layer", "Pose", "RunConfig", "View",
    "estimate_depth", "evaluate", "interpolate", "make_frames", "read_views", "score", "write_video",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = "evaluation.public_api" if name in ("evaluate", "score") else "interpolation.api"
    return getattr(import_module(f"omnisyn_cli.{home}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
