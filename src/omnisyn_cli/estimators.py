"""Where depth comes from, by name: what the commands offer as ``--depth``.

``file``: what came with the panoramas. ``matching``: classical stereo. ``refined``: matching made better by a network.
``network``: a stereo network alone. ``monocular``: a network that looks at each panorama by itself.
"""

from __future__ import annotations

from omnisyn_cli.stereo.sizes import coarse_rows
from omnisyn_cli.types import DepthEstimator, KnownDepth

__all__ = ["DEPTH_SOURCES", "make_estimator"]

DEPTH_SOURCES = ("file", "matching", "refined", "network", "monocular")


def make_estimator(
    source: str, *, rows: int = 512, model: str | None = None, device: str = "auto", threads: int | None = None
) -> DepthEstimator:
    """An estimator that serves any number of pairs.

    Args:
        source: one of :data:`DEPTH_SOURCES`.
        rows: that depth is looked for at; refined estimates have half of them, those of matching alone as many, but
            not more than it is good at, see :mod:`omnisyn_cli.stereo.sizes`.
        model: name in the manifest or path of an ONNX file, for ``refined``, ``network`` and ``monocular``.
        device: where the network runs: ``auto``, ``cpu`` or ``cuda``.
        threads: at most this many; None is one per core.

    Raises:
        ValueError: an unknown source, or no model where one is needed.
        InputError: the model cannot be found or loaded, or not on that device.
    """
    if source not in DEPTH_SOURCES:
        raise ValueError(f"expected a depth source of {', '.join(DEPTH_SOURCES)}, got {source!r}")
    if source == "file":
        return KnownDepth()
    if source == "network":
        from omnisyn_cli.runtime.depth import LearnedDepthEstimator

        learned: DepthEstimator = LearnedDepthEstimator(_session(model, device, threads))
        return learned
    if source == "monocular":
        from omnisyn_cli.runtime.synsin import MonocularDepthEstimator

        alone: DepthEstimator = MonocularDepthEstimator(_session(model, device, threads))
        return alone
    from omnisyn_cli.stereo.matching import MatchingDepthEstimator, MatchingOptions

    coarse = coarse_rows(rows)
    matching = MatchingDepthEstimator(MatchingOptions(size=(coarse, 2 * coarse)), threads)
    if source == "matching":
        return matching
    from omnisyn_cli.runtime.refinement import SessionRefinement
    from omnisyn_cli.stereo.refined import RefinedDepthEstimator

    refinement = SessionRefinement(_session(model, device, threads))
    return RefinedDepthEstimator(matching, refinement, rows)


def _session(model: str | None, device: str, threads: int | None) -> object:
    from omnisyn_cli.runtime.models import find_model
    from omnisyn_cli.runtime.session import open_session

    if model is None:
        raise ValueError("expected the name or path of a model, got none")
    return open_session(find_model(model), device=device, threads=threads)
