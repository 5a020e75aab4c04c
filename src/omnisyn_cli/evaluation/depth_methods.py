"""Where the depth comes from that the paper's table compares: networks alone, matching, and the presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from omnisyn_cli.errors import InputError
from omnisyn_cli.estimators import make_estimator
from omnisyn_cli.presets import PRESETS, SYNSIN_MODELS
from omnisyn_cli.runtime.models import find_model, sha256_of
from omnisyn_cli.types import DepthEstimator

__all__ = ["METHODS", "DepthMethod", "find_depth_methods"]


@dataclass(frozen=True)
class DepthMethod:
    """Where depth comes from.

    Attributes:
        name: as it is chosen and listed.
        source: a depth source of :mod:`omnisyn_cli.estimators`.
        rows: that matching works towards.
        model: of the manifest, or a file; None where no network takes part.
    """

    name: str
    source: str
    rows: int = 512
    model: str | None = None

    def make(self, device: str, threads: int | None) -> DepthEstimator:
        """Set it to work; InputError where its network is missing."""
        return make_estimator(self.source, rows=self.rows, model=self.model, device=device, threads=threads)

    def ingredients(self) -> list[str]:
        """What its results depend on besides its name; InputError where its network is missing."""
        weights = sha256_of(find_model(self.model)) if self.model else ""
        return [self.source, str(self.rows), weights]


NETWORK = "network:"
"""Before a model's name in the manifest or its ONNX file: that stereo network alone."""

METHODS: Mapping[str, DepthMethod] = MappingProxyType(
    {
        method.name: method
        for method in (
            DepthMethod("synsin", "monocular", model=SYNSIN_MODELS[0]),
            DepthMethod("matching", "matching"),
            *(
                DepthMethod(f"omnisyn-{preset.name}", preset.depth, preset.depth_rows, preset.model)
                for preset in PRESETS.values()
            ),
        )
    }
)
"""The rows of the table: SynSin's monocular network, matching alone, and the presets; ``paper`` is a network alone."""


def find_depth_methods(text: str) -> list[DepthMethod]:
    """``all``, or names separated by commas, each once; ``network:FILE.onnx`` is a stereo network in a file.

    Raises:
        InputError: a name that there is no method of, or no name.
    """
    if text == "all":
        return list(METHODS.values())
    names = dict.fromkeys(name.strip() for name in text.split(",") if name.strip())
    return [_method(name) for name in names] if names else [_method(text)]


def _method(name: str) -> DepthMethod:
    if name.startswith(NETWORK):
        return DepthMethod(name, "network", model=name.removeprefix(NETWORK))
    if name not in METHODS:
        raise InputError(f"expected one of {', '.join((*METHODS, NETWORK + 'FILE.onnx'))} as method, got {name!r}")
    return METHODS[name]
